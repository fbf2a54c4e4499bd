"""Hyperparameters that all algorithms have."""

from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from rrl.algorithms.networks import NetworkFactory, mlp
from rrl.algorithms.optimizers import Adam, OptimizerFactory
from rrl.encoders import automatic
from rrl.encoders.interface import EncoderFactory


class AgentSettings(BaseModel):
    """Hyperparameters that all algorithms have.

    Attributes:
        encoder: Makes the module from inputs to features; one that learns nothing is run once a
            batch, one that learns is taught by the critics (:class:`.readings.Readings`).
        network: Makes the networks of actor and critics.
        optimizer: Makes the optimizers.
        last_layer_bound: The actor's output layer is drawn from ``U(-bound, bound)``; 0 makes an
            untrained residual exactly zero.
        actor_lr: Learning rate of the actor.
        critic_lr: Learning rate of the critics.
        gamma: Discount; None: derived from the episode's length.
        tau: Share by which the targets follow in an update.
        policy_delay: Critic updates per update of policy and targets.
        critic_burn_in: Updates at the start in which the critics learn and the policy waits; a
            trainer takes them all before its first round of updates.
        loss_function: The critics' loss.
        value_bounds: Keep targets within what the rewards seen so far can add up to
            (:class:`.value_bounds.BoundedTD0Estimator`), with SAC's entropies.
        reward_scale: Factor on the stored reward before the critics see it, not 0; None: derived
            from the first transitions, so that rewards of any size are learned from alike.
        residual_penalty: Weight of the action's square in the policy's loss, at first. With a
            derived ``reward_scale`` values lie a few units apart; a residual must then gain that
            much to be worth its size.
        penalty_updates: Updates after which that weight is halved; after ``n`` times as many it is
            divided by ``n + 1``. The critics know little at first, and more and more later. None:
            derived from the episode's length.
        compiled: Compile the whole update into one graph.
        products: Type in which a compiled update multiplies wide matrices; parameters, sums and
            moments are float32 always. ``bfloat16`` is faster on processors with AVX512-BF16 or
            AMX; on others a warning is given and float32 is used.
    """

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, arbitrary_types_allowed=True
    )

    encoder: EncoderFactory = automatic
    network: NetworkFactory = mlp
    optimizer: OptimizerFactory = Adam
    last_layer_bound: float = Field(0.0, ge=0)
    actor_lr: float = Field(1e-3, gt=0)
    critic_lr: float = Field(1e-3, gt=0)
    gamma: float | None = Field(0.99, ge=0, lt=1)
    tau: float = Field(0.005, gt=0, le=1)
    policy_delay: int = Field(1, ge=1)
    critic_burn_in: int = Field(0, ge=0)
    loss_function: Literal["l2", "l1", "smooth_l1"] = "l2"
    value_bounds: bool = False
    reward_scale: float | None = 1.0
    residual_penalty: float = Field(0.0, ge=0)
    penalty_updates: int | None = Field(1000, gt=0)
    compiled: bool = False
    products: Literal["float32", "bfloat16"] = "float32"

    @field_validator("reward_scale")
    @classmethod
    def _is_not_zero(cls, value: float | None) -> float | None:
        if value == 0:
            raise ValueError("reward_scale: expected a factor other than 0, got 0")
        return value

    @model_validator(mode="after")
    def _has_a_graph_for_bfloat16(self) -> Self:
        if self.products == "bfloat16" and not self.compiled:
            raise ValueError("products: bfloat16 is for compiled updates; set compiled=true too")
        return self
