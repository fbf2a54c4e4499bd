"""Operators who take over, and what a replay buffer makes of the steps that they took."""

from rrl.interventions.operator import ScriptedOperator
from rrl.interventions.relabelling import relabel_interventions
from rrl.interventions.sampler import InterventionSampler

__all__ = ["InterventionSampler", "ScriptedOperator", "relabel_interventions"]
