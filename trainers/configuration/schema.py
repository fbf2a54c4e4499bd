"""The layout of a configuration, and what is wrong with one in words."""

from __future__ import annotations

from math import inf
from typing import Annotated, Any, Literal

from pydantic import Field, PlainValidator, ValidationError

from rrl.controllers import ZeroController

from ..checked import Checked, in_words
from ..environment import Batching
from ..metric import Metric
from ..settings import Positive, TrainerSettings
from ..storage.run_files import PLAIN_NAME

PlainName = Annotated[str, Field(pattern=f"^{PLAIN_NAME}$")]
"""A directory or file of that name stays where it is put."""
Target = dict[str, Any]
Targets = dict[str, Target | None] | None


def _numbers(value: Any) -> Any:
    for number in value if isinstance(value, list) else [value]:
        if type(number) not in (int, float) or not 0 <= number < inf:
            raise ValueError(f"expected a number of at least 0, or a list of such, got {value!r}")
    return value


Scale = Annotated[float | list[float], PlainValidator(_numbers)]
Entries = Annotated[dict[str, dict[str, Any] | None], Field(min_length=1)]
Side = Annotated[int, Field(gt=0, le=4096)]


class _Render(Checked):
    enabled: bool
    scenario: str | None
    episode: Any
    width: Side
    height: Side
    format: Literal["mp4", "gif"]
    fps: Annotated[float, Field(gt=0)]


class _Env(Checked):
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


class _Algorithm(Checked):
    agent: Target
    exploration: Target
    use_symmetries: bool = False


class _InitFrom(Checked):
    run: str | None


class _Operator(Checked):
    intervention: Target | None


class Schema(Checked):
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

    def _check(self) -> None:
        self.trainer.check_operator(bool(self.operator and self.operator.intervention))
        if self.arm == "controller" and self.trainer.total_steps:
            raise ValueError(
                "trainer.total_steps: expected 0 with arm=controller, which trains nothing, got "
                f"{self.trainer.total_steps}; to train above the controller, choose arm=residual"
            )
        controller = str(self.controller.get("_target_"))
        if self.arm == "rl" and controller.rpartition(".")[2] != ZeroController.__name__:
            raise ValueError(
                "controller: expected controller=zero with arm=rl, which learns without one, got "
                f"{controller}; to train above it, choose arm=residual"
            )


def explain(error: ValidationError, prefix: str = "") -> list[str]:
    """Return Pydantic's findings, one line each."""
    lines = []
    for e in error.errors():
        path = ".".join(map(str, [prefix, *e["loc"]] if prefix else e["loc"]))
        lines.append(f"{path}: {in_words(e)}" if path else in_words(e))
    return lines
