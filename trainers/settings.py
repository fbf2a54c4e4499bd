"""Every number of a run, checked before anything expensive starts; the defaults are in the YAML."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import ConfigDict, Field, PlainValidator, model_validator

from rrl.algorithms.calibration import warmup_length

from .checked import Checked
from .defaults import default_config
from .seeds import MAX_SEED

__all__ = [
    "AcceptanceSettings",
    "CheckpointSettings",
    "ConstraintSettings",
    "EvaluationSettings",
    "NonNegative",
    "Positive",
    "RealTimeSettings",
    "TrainerSettings",
]

Positive = Annotated[int, Field(gt=0)]
NonNegative = Annotated[int, Field(ge=0)]
Seed = Annotated[int, Field(ge=0, lt=MAX_SEED)]
Episodes = Annotated[int, Field(gt=0, le=MAX_SEED)]  # of more, the seeds of two streams may meet


def _episode_or_steps(value: Any) -> Any:
    if value != "episode" and (type(value) is not int or value < 1):
        raise ValueError(f"expected episode or a whole number above 0, got {value!r}")
    return value


IN_YAML: Any = Field(default=None)
"""Stands for the default in ``configs/``, which is filled in before anything is checked."""


class _Settings(Checked):
    model_config = ConfigDict(frozen=True)
    section: ClassVar[str | None] = None
    """Below ``trainer`` in the YAML, where the defaults are."""

    @model_validator(mode="before")
    @classmethod
    def _fill_in(cls, values: Any) -> Any:
        trainer = default_config()["trainer"]
        defaults = trainer if cls.section is None else trainer[cls.section]
        return {**defaults, **values} if isinstance(values, Mapping) else values


class EvaluationSettings(_Settings):
    """How often and on what the policy is evaluated.

    Attributes:
        every: Environment steps between evaluations; 0 evaluates only at the end.
        episodes: Frozen episodes of an evaluation during training.
        final_episodes: Frozen episodes of each scenario at the end; other ones.
        seed: Names both sets; the same for all seeds, arms and runs.
        slots: How many episodes run side by side, at most.
    """

    section = "evaluation"
    every: NonNegative = IN_YAML
    episodes: Episodes = IN_YAML
    final_episodes: Episodes = IN_YAML
    seed: Seed = IN_YAML
    slots: Positive = IN_YAML


class AcceptanceSettings(_Settings):
    """The test that a policy has to pass before the run hands it over.

    Attributes:
        enabled: Whether there is a test; without it the run hands over its latest policy.
        margin: How much worse than the controller a policy may be, in success rate; where no
            success is reported, in shares of the range of the controller's returns.
        alpha: Probability, at most, that a run ever hands over a policy that is worse than that.
        episodes: Pairs of episodes, of policy and controller, that a candidate is tested on, at
            most.
    """

    section = "acceptance"
    enabled: bool = IN_YAML
    margin: Annotated[float, Field(gt=0, lt=1)] = IN_YAML
    alpha: Annotated[float, Field(gt=0, lt=1)] = IN_YAML
    episodes: Episodes = IN_YAML


class ConstraintSettings(_Settings):
    """How the learner keeps to the budgets of quantities.

    Attributes:
        rate: By how much a multiplier grows for an episode that needs twice its budget, and falls
            for one that needs nothing.
        initial: The multiplier at the start.
    """

    section = "constraints"
    rate: Annotated[float, Field(gt=0)] = IN_YAML
    initial: Annotated[float, Field(ge=0)] = IN_YAML


class CheckpointSettings(_Settings):
    """How often the run is saved.

    Attributes:
        every: Environment steps between checkpoints; 0 saves only at the end.
        keep: How many checkpoints stay.
    """

    section = "checkpoint"
    every: NonNegative = IN_YAML
    keep: Positive = IN_YAML


class RealTimeSettings(_Settings):
    """How the environment is stepped in wall-clock time, with ``collection: realtime``.

    Attributes:
        period: Seconds from one action to the next; None: what the environment says.
        budget: Share of the period in which the policy has to answer; a step without an answer by
            then is late.
        late: What a late step does: ``controller`` acts alone; ``hold`` the last command, as near
            as the residual's authority allows; ``stop`` the robot, which ends the episode.
        weights: When the acting process takes over new weights: at the end of every ``episode``, or
            every so many steps.
        retry: Seconds between attempts to reset a robot that was stopped by a fault.
        priority: Real-time priority of the acting process, 1 to 99; 0: none.
    """

    section = "realtime"
    period: Annotated[float, Field(gt=0)] | None = IN_YAML
    budget: Annotated[float, Field(gt=0, le=1)] = IN_YAML
    late: Literal["controller", "hold", "stop"] = IN_YAML
    weights: Annotated[Literal["episode"] | int, PlainValidator(_episode_or_steps)] = IN_YAML
    retry: Annotated[float, Field(gt=0)] = IN_YAML
    priority: Annotated[int, Field(ge=0, le=99)] = IN_YAML


class TrainerSettings(_Settings):
    """The settings of one training run; what is left out is as in ``configs/train.yaml``.

    Attributes:
        seed: Of everything random in the run.
        num_seeds: How many runs ``rrl train`` starts, with seeds ``seed`` to
            ``seed + num_seeds - 1``; a :class:`Trainer` takes 1.
        num_envs: Environments that the learner collects from.
        device: Where networks and replay buffer lie, such as ``cpu`` or ``cuda``.
        total_steps: Environment steps of the run.
        warmup_steps: Environment steps before the first update; None: five episodes or 300 steps,
            whichever is longer, but no more than a tenth of the run.
        controller_steps: Environment steps at the start that are the controller's own, without
            exploration; None: half of the warm-up.
        steps_per_collection: Steps of each environment between two rounds of updates.
        updates_per_step: Gradient updates per environment step.
        n_step: Rewards summed before the critics bootstrap; a sum ends with its episode and with
            its collection.
        batch_size: Transitions per update.
        buffer_capacity: Transitions kept for replay.
        intervention_share: Part of every batch, at least, that comes from steps that an operator
            has taken over, as soon as there are any.
        keys: Whether a person may pause, judge and stop by keys, where standard input is a
            terminal.
        collection: ``turn`` with the updates; ``overlap``: a second process collects the next round
            of a simulation meanwhile, and round ``k`` acts with the policy of round ``k - 1``'s
            start; ``realtime``: a process of its own steps the environment at its control period.
        realtime: See :class:`RealTimeSettings`.
        profile: Time the parts of a collection too, and print at the end where a step's time went.
        threads: Torch threads. Products of small networks gain little from a second one, and wait
            long for it where another process is busy.
        flush_denormals: Treat denormal numbers as zero; Adam's moments decay into them and slow the
            products down.
        matmul_precision: See :func:`torch.set_float32_matmul_precision`. On a processor it costs
            more in small products than it saves; see ``products`` of the algorithm.
        evaluation: See :class:`EvaluationSettings`.
        acceptance: See :class:`AcceptanceSettings`.
        constraints: See :class:`ConstraintSettings`; None: budgets are reported, not kept.
        checkpoint: See :class:`CheckpointSettings`.
    """

    seed: Seed = IN_YAML
    num_seeds: Positive = IN_YAML
    num_envs: Positive = IN_YAML
    device: str = IN_YAML
    total_steps: NonNegative = IN_YAML
    warmup_steps: NonNegative | None = IN_YAML
    controller_steps: NonNegative | None = IN_YAML
    steps_per_collection: Positive = IN_YAML
    updates_per_step: Annotated[float, Field(gt=0)] = IN_YAML
    n_step: Positive = IN_YAML
    batch_size: Positive = IN_YAML
    buffer_capacity: Positive = IN_YAML
    intervention_share: Annotated[float, Field(ge=0, le=1)] = IN_YAML
    keys: bool = IN_YAML
    collection: Literal["turn", "overlap", "realtime"] = IN_YAML
    realtime: RealTimeSettings = IN_YAML
    profile: bool = IN_YAML
    threads: Positive = IN_YAML
    flush_denormals: bool = IN_YAML
    matmul_precision: Literal["highest", "high", "medium"] = IN_YAML
    evaluation: EvaluationSettings = IN_YAML
    acceptance: AcceptanceSettings = IN_YAML
    constraints: ConstraintSettings | None = IN_YAML
    checkpoint: CheckpointSettings = IN_YAML

    @property
    def steps_per_round(self) -> int:
        """Environment steps between two rounds of updates."""
        return self.steps_per_collection * self.num_envs

    @property
    def kept_transitions(self) -> int:
        """Transitions that the buffer needs room for: no more than the run makes."""
        return max(1, min(self.buffer_capacity, self.total_steps))

    @property
    def updates_per_round(self) -> int:
        """Updates after each collection."""
        return round(self.steps_per_round * self.updates_per_step)

    def check_operator(self, present: bool) -> None:
        """Refuse a share of every batch from steps that nobody takes over.

        Args:
            present: Whether there is an operator.

        Raises:
            ValueError: If there is none, and a share.
        """
        if self.intervention_share and not present:
            raise ValueError(
                "intervention_share: expected 0 without an operator, got "
                f"{self.intervention_share}; choose one, such as operator=press-and-drag"
            )

    @property
    def lengths(self) -> dict[str, int | None]:
        """What :meth:`derived` derives, by name."""
        return {"warmup_steps": self.warmup_steps, "controller_steps": self.controller_steps}

    def derived(
        self, episode_steps: int, before: Mapping[str, int] | None = None
    ) -> TrainerSettings:
        """Return the settings with the lengths that are to be derived.

        Args:
            episode_steps: Steps of an episode.
            before: :attr:`lengths` as the run has derived them when it began; they stay, however
                long it becomes.
        """
        if before is not None:
            given = {name: steps for name, steps in self.lengths.items() if steps is not None}
            return self.model_copy(update={**before, **given})
        warmup, alone = self.warmup_steps, self.controller_steps
        if warmup is None:
            warmup = warmup_length(episode_steps, self.total_steps, self.steps_per_round)
        if alone is None:
            alone = warmup // 2 // self.steps_per_round * self.steps_per_round
        return self.model_copy(update={"warmup_steps": warmup, "controller_steps": alone})

    def _check(self) -> None:
        per_round = f"steps_per_collection x num_envs ({self.steps_per_round})"
        for name, length in self.lengths.items():
            if self.total_steps and length is not None and length >= self.total_steps:
                nothing = "learned" if name == "warmup_steps" else "explored"
                raise ValueError(
                    f"{name}: expected less than total_steps ({self.total_steps}), or nothing is "
                    f"{nothing}, got {length}"
                )
        if abs(self.steps_per_round * self.updates_per_step - self.updates_per_round) > 1e-9:
            raise ValueError(
                f"updates_per_step: expected a whole number of updates for {per_round}, "
                f"got {self.updates_per_step}"
            )
        if self.n_step > self.steps_per_collection:
            raise ValueError(
                f"n_step: expected at most steps_per_collection ({self.steps_per_collection}), "
                f"because returns are summed within a collection, got {self.n_step}"
            )
        least = max(self.batch_size, self.steps_per_round)
        if self.buffer_capacity < least:
            raise ValueError(
                f"buffer_capacity: expected at least {least}, to hold a batch ({self.batch_size}) "
                f"and {per_round}, got {self.buffer_capacity}"
            )
        if self.collection == "realtime" and (self.num_envs > 1 or self.profile):
            raise ValueError(
                "collection: realtime steps one environment and measures its own timing: expected "
                f"num_envs 1 and profile false, got {self.num_envs} and {self.profile}"
            )
        due = {"evaluation.every": self.evaluation.every, "checkpoint.every": self.checkpoint.every}
        for name, steps in {"total_steps": self.total_steps, **due}.items():
            if steps % self.steps_per_round:
                raise ValueError(f"{name}: expected a multiple of {per_round}, got {steps}")
