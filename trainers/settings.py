"""The trainer's settings, checked before anything expensive starts."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, model_validator

Positive = Annotated[int, Field(gt=0)]
NonNegative = Annotated[int, Field(ge=0)]
Seed = Annotated[int, Field(ge=0, lt=2**31)]
Capacity = Annotated[int, Field(gt=0, le=2**24)]
"""The replay sampler draws indices that float32 holds exactly."""


class _Settings(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class EvaluationSettings(_Settings):
    """How often and on what the policies are evaluated.

    Attributes:
        every: environment steps (of one seed) between evaluations; 0 evaluates only at the end.
        episodes: frozen episodes of an evaluation during training.
        final_episodes: frozen episodes of each scenario at the end.
        seed: names the frozen set; the same for all seeds, arms and runs.
        slots: how many episodes run side by side.

    """

    every: NonNegative = 500
    episodes: Positive = 50
    final_episodes: Positive = 100
    seed: Seed = 10_000
    slots: Positive = 100


class CheckpointSettings(_Settings):
    """How often the run is saved.

    Attributes:
        every: environment steps (of one seed) between checkpoints; 0 saves only at the end.
        keep: how many checkpoints stay.

    """

    every: NonNegative = 1000
    keep: Positive = 2


class TrainerSettings(_Settings):
    """The settings of one training run.

    Attributes:
        seed: first seed; the run trains ``seed .. seed + num_seeds - 1``.
        num_seeds: independent learners trained side by side in one stack.
        envs_per_seed: environments that each learner collects from.
        total_steps: environment steps per seed.
        warmup_steps: environment steps per seed before the first update.
        warmup_exploration: whether exploration noise acts during the warm-up; without it the buffer starts with the
            controller's own episodes.
        steps_per_collection: environment steps per environment between two rounds of updates.
        updates_per_step: gradient updates per environment step of one seed.
        n_step: rewards summed before the critics bootstrap; a sum ends with its episode and with its collection.
        residual_ramp_steps: environment steps per seed over which the exploring policy's share of its action grows from
            0 to 1, so that the controller leads at the start; 0: it is 1 from the start.
        batch_size: transitions per update and seed.
        buffer_capacity: transitions kept per seed.
        overlap: collect the next round in a second process while this round's updates run; round ``k`` then acts with
            the policy of round ``k - 1``'s start.
        profile: time the parts of a collection too, and print at the end where a step's time went.
        threads: torch threads; None: one where a second process collects, else two if this process may use as many.
        flush_denormals: treat denormal numbers as zero; Adam's moments decay into them and slow the products down.
        matmul_precision: ``highest`` for float32 products, ``medium`` for bfloat16 products under float32.
        evaluation: see :class:`EvaluationSettings`.
        checkpoint: see :class:`CheckpointSettings`.

    """

    seed: Seed = 0
    num_seeds: Positive = 1
    envs_per_seed: Positive = 1
    total_steps: NonNegative = 10_000
    warmup_steps: NonNegative = 1000
    warmup_exploration: bool = True
    steps_per_collection: Positive = 50
    updates_per_step: Annotated[float, Field(gt=0)] = 1.0
    n_step: Positive = 1
    residual_ramp_steps: NonNegative = 0
    batch_size: Positive = 128
    buffer_capacity: Capacity = 1_000_000
    overlap: bool = False
    profile: bool = False
    threads: Positive | None = None
    flush_denormals: bool = True
    matmul_precision: Annotated[str, Field(pattern="^(highest|high|medium)$")] = "highest"
    evaluation: EvaluationSettings = EvaluationSettings()
    checkpoint: CheckpointSettings = CheckpointSettings()

    @property
    def seeds(self) -> list[int]:
        """The seeds trained side by side."""
        return list(range(self.seed, self.seed + self.num_seeds))

    @property
    def steps_per_round(self) -> int:
        """Environment steps of one seed between two rounds of updates."""
        return self.steps_per_collection * self.envs_per_seed

    @property
    def transitions_per_round(self) -> int:
        """Transitions of all seeds that one collection stores."""
        return self.steps_per_round * self.num_seeds

    @property
    def updates_per_round(self) -> int:
        """Updates after each collection."""
        return round(self.steps_per_round * self.updates_per_step)

    def residual_share(self, env_steps: int) -> float:
        """Share of the policy's action that acts after ``env_steps`` steps of one seed."""
        return min(1.0, env_steps / self.residual_ramp_steps) if self.residual_ramp_steps else 1.0

    @model_validator(mode="after")
    def _check(self) -> TrainerSettings:
        if self.total_steps and self.warmup_steps >= self.total_steps:
            raise ValueError(
                f"warmup_steps ({self.warmup_steps}) leaves nothing of total_steps ({self.total_steps}) to learn "
                "from: lower warmup_steps or raise total_steps"
            )
        if self.total_steps % self.steps_per_round:
            raise ValueError(
                f"total_steps ({self.total_steps}) must be a multiple of steps_per_collection x envs_per_seed "
                f"({self.steps_per_round})"
            )
        if abs(self.steps_per_round * self.updates_per_step - self.updates_per_round) > 1e-9:
            raise ValueError(
                f"updates_per_step ({self.updates_per_step}) x steps of a collection ({self.steps_per_round}) must be "
                "a whole number of updates"
            )
        if self.n_step > self.steps_per_collection:
            raise ValueError(
                f"n_step ({self.n_step}) must not exceed steps_per_collection ({self.steps_per_collection}): returns "
                "are summed within one collection"
            )
        if self.buffer_capacity < self.batch_size:
            raise ValueError(
                f"buffer_capacity ({self.buffer_capacity}) must hold at least one batch ({self.batch_size})"
            )
        if self.buffer_capacity < self.steps_per_round:
            raise ValueError(
                f"buffer_capacity ({self.buffer_capacity}) must hold at least one collection, steps_per_collection x "
                f"envs_per_seed ({self.steps_per_round})"
            )
        for name in ("evaluation", "checkpoint"):
            every = getattr(self, name).every
            if every % self.steps_per_round:
                raise ValueError(
                    f"{name}.every ({every}) must be a multiple of steps_per_collection x envs_per_seed "
                    f"({self.steps_per_round})"
                )
        return self
