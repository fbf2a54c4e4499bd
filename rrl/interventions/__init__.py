"""Operators who take over, and what a replay buffer makes of the steps that they took."""

from rrl.interventions.operator import ScriptedOperator
from rrl.interventions.replay import InterventionSampler, relabel_interventions

__all__ = ["InterventionSampler", "ScriptedOperator", "relabel_interventions"]
