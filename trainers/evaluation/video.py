"""Film controller and residual on the same frozen episode, side by side."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import imageio.v3 as iio
import numpy as np
import torch
from matplotlib.font_manager import findfont
from PIL import Image, ImageDraw, ImageFont
from tensordict.nn import TensorDictModuleBase

from rrl.keys import REWARD, SUCCESS

from ..environment import EnvironmentFactory, Input
from ..generators import isolated_generators
from .camera_views import beside, camera_views
from .rollout import rollout, zero_residual

Renderer = Callable[..., np.ndarray]
"""``renderer(base_env, states, width=..., height=...)`` gives uint8 frames ``[T, h, w, 3]``."""

Outcome = bool | float
"""Whether a state is a success, or the return so far."""
COLORS = {"solved": (46, 125, 50), "failed": (183, 28, 28)}
NEUTRAL = (70, 70, 70)
HOLD_SECONDS = 1.0
"""How long the last frame stays."""


def render_comparison(
    environment: EnvironmentFactory,
    policy: TensorDictModuleBase,
    renderer: Renderer,
    seed: int,
    out: Path,
    settings: Mapping[str, Any],
) -> Path:
    """Play one frozen episode under the controller alone and under the residual, and film both.

    What the policy's cameras see stands beside the scene.

    Args:
        environment: The scenario.
        policy: The residual policy.
        renderer: Makes frames of what the bare environment's ``physics_state()`` gave.
        seed: Seed of the episode.
        out: The file; its ending decides the format (``.mp4``, ``.gif``). The last frame is
            written beside it as PNG.
        settings: ``width`` and ``height`` of each half in pixels, ``fps``.

    Raises:
        RuntimeError: If this machine cannot render.
    """
    halves = []
    for title, run_policy in (("controller alone", None), ("controller + residual", policy)):
        env = environment.make(1)
        chosen = run_policy or zero_residual(env)
        inputs = environment.read_inputs(env)
        played = record(env, chosen, seed, environment.max_episode_steps, inputs)
        size = {"width": settings["width"], "height": settings["height"]}
        with isolated_generators(seed):
            frames = renderer(env.base_env, played.states, **size)
        halves.append(_label(beside(frames, played.views), title, played.outcomes))
        env.close()
    frames = _side_by_side(halves)
    out.parent.mkdir(parents=True, exist_ok=True)
    hold = np.repeat(frames[-1:], round(HOLD_SECONDS * settings["fps"]), axis=0)
    with tempfile.TemporaryDirectory(prefix=".", dir=out.parent) as folder:  # whole, or not there
        partial = Path(folder, out.name)
        iio.imwrite(partial, np.concatenate([frames, hold]), **_format(out, settings["fps"]))
        iio.imwrite(partial.with_suffix(".png"), frames[-1])
        partial.with_suffix(".png").replace(out.with_suffix(".png"))
        partial.replace(out)
    return out


@dataclass
class Recording:
    """One episode, ``[T + 1]`` each.

    Attributes:
        states: Physics states.
        outcomes: Whether the state is a success, or the return so far where none is reported.
        views: Pictures of the policy's cameras.
    """

    states: list[np.ndarray] = field(default_factory=list)
    outcomes: list[Outcome] = field(default_factory=list)
    views: list[list[np.ndarray]] = field(default_factory=list)


def record(
    env: Any,
    policy: TensorDictModuleBase,
    seed: int,
    max_steps: int,
    inputs: Mapping[str, Input] = MappingProxyType({}),
) -> Recording:
    """Play one episode; ``inputs`` are the policy's, of which images are kept."""
    played, total = Recording(), 0.0
    with isolated_generators(seed):
        for td, _ in rollout(env, policy, seed, max_steps):
            played.states.append(np.array(_physics_state(env.base_env)))
            played.views.append(camera_views(td, inputs))
            total += float(td.get(REWARD, torch.zeros(1)).sum())
            solved = td.get(SUCCESS, None)
            played.outcomes.append(total if solved is None else bool(solved.any()))
    return played


def _physics_state(base: Any) -> Any:
    if not hasattr(base, "physics_state"):
        raise TypeError(
            f"base: expected a method physics_state(), which gives the renderer an array of this "
            f"moment, got a {type(base).__name__} without; of a MuJoCo environment it returns "
            "rrl.envs.mujoco_state(self). Or set env.renderer=null"
        )
    return base.physics_state()


def _label(frames: np.ndarray, title: str, outcomes: Sequence[Outcome]) -> np.ndarray:
    """Write the title into every frame, and the outcome once it is known."""
    height = frames.shape[1]
    font = ImageFont.truetype(findfont("DejaVu Sans"), max(12, height // 22))
    bar = height // 12
    labelled = []
    for i, frame in enumerate(frames):
        image = Image.fromarray(frame)
        draw = ImageDraw.Draw(image, "RGBA")
        draw.rectangle((0, 0, image.width, bar), fill=(20, 20, 20, 190))
        draw.text((bar / 3, bar / 2), title, font=font, fill="white", anchor="lm")
        if text := _outcome_text(outcomes[i], i == len(frames) - 1):
            color = COLORS.get(text, NEUTRAL)
            width = draw.textlength(text, font=font) + bar / 1.5
            draw.rectangle((image.width - width, 0, image.width, bar), fill=color)
            draw.text(
                (image.width - width / 2, bar / 2), text, font=font, fill="white", anchor="mm"
            )
        labelled.append(np.asarray(image))
    return np.stack(labelled)


def _outcome_text(outcome: Outcome, ended: bool) -> str:
    """Say what is known of the episode by now."""
    if not isinstance(outcome, bool):
        return f"return {outcome:.1f}"
    return "solved" if outcome else "failed" if ended else ""


def _side_by_side(halves: Sequence[np.ndarray]) -> np.ndarray:
    length = max(map(len, halves))
    padded = [np.concatenate([h, np.repeat(h[-1:], length - len(h), axis=0)]) for h in halves]
    return np.concatenate(padded, axis=2)


def _format(out: Path, fps: int) -> dict[str, Any]:
    if out.suffix == ".gif":
        return {"duration": 1000 / fps, "loop": 0}
    return {"fps": fps, "codec": "libx264", "macro_block_size": 2, "output_params": ["-crf", "23"]}
