"""The layout of a configuration, and what is wrong with one in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from rrl.controllers import ZeroController

from ..environment import Batching
from ..metric import Metric
from ..settings import Positive, TrainerSettings
from ..storage.run_files import PLAIN_NAME

__all__ = ["PlainName", "Schema", "Target", "explain"]

PlainName = Annotated[str, Field(pattern=f"^{PLAIN_NAME}$")]
"""A directory or file of that name stays where it is put."""
Target = dict[str, Any]
Targets = dict[str, Target | None] | None
Scale = Annotated[float, Field(ge=0)] | list[Annotated[float, Field(ge=0)]]
Entries = Annotated[dict[str, dict[str, Any] | None], Field(min_length=1)]
Side = Annotated[int, Field(gt=0, le=4096)]


class Section(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class _Render(Section):
    enabled: bool
    scenario: str | None
    episode: int | str
    width: Side
    height: Side
    format: Annotated[str, Field(pattern="^(mp4|gif)$")]
    fps: Annotated[float, Field(gt=0)]


class _Env(Section):
    name: str
    base: Target
    batching: Batching
    max_episode_steps: Positive
    inputs: Entries
    critic_inputs: Entries | None = None
    scenarios: Annotated[dict[PlainName, dict[str, Any] | None], Field(min_length=1)]
    residual_scale: Scale | None = None
    action_history: Positive = 1
    symmetries: dict[str, dict[str, list[int]]] | None = None
    metrics: dict[PlainName, Metric | None] | None = None
    judged: bool = False
    control_period: Annotated[float, Field(gt=0)] | None = None
    units: dict[str, str] | None = None
    sensing: Targets = None
    renderer: Target | None = None
    packages: list[str] | None = None


class _Algorithm(Section):
    agent: Target
    exploration: Target
    use_symmetries: bool = False


class _InitFrom(Section):
    run: str | None


class _Operator(Section):
    intervention: Target | None


class Schema(Section):
    """The configuration's layout; what a ``_target_`` takes is checked with the target itself."""

    name: PlainName
    arm: str
    residual_scale: Scale
    launcher: Literal["local", "ray"] = "local"
    workers: Positive | None = None
    trainer: TrainerSettings
    render: _Render
    env: _Env
    controller: Target
    disturbance: Targets = None
    safety: Targets = None
    operator: _Operator | None = None
    algorithm: _Algorithm
    init_from: _InitFrom | None = None
    logger: Targets = None

    @model_validator(mode="after")
    def _check(self) -> Schema:
        self.trainer.check_operator(bool(self.operator and self.operator.intervention))
        _check_arm(self.arm, str(self.controller.get("_target_")), self.trainer.total_steps)
        return self


def _check_arm(arm: str, controller: str, total_steps: int) -> None:
    """Refuse what contradicts the name under which a run is reported."""
    if arm == "controller" and total_steps:
        raise ValueError(
            "trainer.total_steps: expected 0 with arm=controller, which trains nothing, got "
            f"{total_steps}; to train above the controller, choose arm=residual"
        )
    if arm == "rl" and controller.rpartition(".")[2] != ZeroController.__name__:
        raise ValueError(
            "controller: expected controller=zero with arm=rl, which learns without one, got "
            f"{controller}; to train above it, choose arm=residual"
        )


def explain(error: ValidationError, prefix: str = "") -> list[str]:
    """Return Pydantic's findings, one line each."""
    return [_line(e, prefix) for e in error.errors()]


def _line(error: Mapping[str, Any], prefix: str) -> str:
    where = ".".join(map(str, ([prefix] if prefix else []) + list(error["loc"])))
    message = error["msg"].removeprefix("Value error, ")
    if error["type"] == "value_error":
        return f"{where}: {message}" if where else message
    if error["type"] == "extra_forbidden":
        return f"{where}: unknown key, got {error['input']!r}"
    if error["type"] == "missing":
        return f"{where}: expected a value, got none"
    return f"{where}: {message[0].lower()}{message[1:]}, got {error['input']!r}"
