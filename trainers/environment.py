"""From a bare environment and a controller to what the policy sees: the chain of transforms."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase, ParallelEnv, SerialEnv
from torchrl.envs.transforms import Compose, Transform

from rrl.checks import check_length
from rrl.inputs import Input
from rrl.keys import ACTION, BASE_ACTION, PREVIOUS_ACTION
from rrl.symmetry import Symmetry, as_map
from rrl.transforms import (
    ActionHistory,
    FiniteAction,
    Intervention,
    JudgedSuccess,
    ResidualAction,
)

from .conversions import convert
from .descriptions import named, plain
from .entry_checks import (
    Batching,
    check_action,
    check_base,
    check_factory,
    check_period,
    check_reported,
    check_reward,
    check_slots,
    make_native,
)
from .input_entries import as_inputs, read_inputs
from .metric import Metric
from .resumable_env import ResumableEnv
from .workers import WorkerErrors, keep_sockets_short

__all__ = ["Batching", "EnvironmentFactory", "Input"]


@dataclass(frozen=True)
class EnvironmentFactory:
    """Builds environments: ``[safety, disturbances, sensing, operator, residual, memory]``.

    The order is the method's: on the way to the policy, sensing faults come before the controller,
    which therefore sees what a real one would see; on the way back the superposition comes first,
    then the disturbance, and safety limits have the last word. An environment in double precision
    or on another device than the CPU is converted first.

    Args:
        base: Makes the bare environment; called as ``base(num_envs=...)`` when ``batching`` is
            ``native``, else without arguments.
        controller: Makes a controller.
        inputs: The observation entries that the policy reads, in this order, and how each is
            normalized; of a plain list of names all are standardized by the first episodes, unless
            there are ``symmetries``. Beside the environment's own
            there are ``base_action`` and ``previous_action``, what the policy said in the last
            ``action_history`` steps. Entries that look like images are read as images.
        critic_inputs: The entries that the critics read, such as poses that only a simulation
            knows; None: the same. Critics are not needed where the policy acts.
        disturbances: Make the transforms of the executed action (control noise).
        sensing: Make the transforms of the observation entries (camera noise, latency).
        safety: Make the transforms that limit what reaches the environment; by default no command
            that is not a number does, and zeros do in its place (``configs/safety/none.yaml``).
        residual_scale: Authority of the residual, in half ranges of the action, one number or one
            for each dimension.
        batching: ``native`` for an environment with a batch size of its own, ``serial`` to run
            copies in turn, ``parallel`` to run each copy in its own process.
        max_episode_steps: Steps of an episode: bounds those of evaluations, and is what discount,
            warm-up and the price of the residual are derived from.
        action_history: How many actions ``previous_action`` holds, if the policy reads it.
        symmetries: Mirrors of the task by name, each with a map (:class:`rrl.symmetry.Symmetry`) of
            ``action`` and of every input but ``base_action`` and ``previous_action``, which are
            actions. A mirror goes through the inputs' ``loc``.
        metrics: Unit and reduction of what the environment writes under ``("metrics", NAME)``, by
            name. Names that are not here are reported with their mean and without a unit.
        control_period: Seconds from one action to the next; None: what the environment's attribute
            of that name says, or unknown.
        judged: Whether success is what a person says; for an environment that does not write it.
        intervention: Makes the transform through which an operator may take over in training.
        units: What the numbers of ``action`` and of observation entries are counted in, by name.
    """

    base: Callable[..., EnvBase]
    controller: Callable[[], TensorDictModuleBase]
    inputs: Mapping[str, Input] | Sequence[str]
    critic_inputs: Mapping[str, Input] | Sequence[str] | None = None
    disturbances: Sequence[Callable[[], Transform]] = ()
    sensing: Sequence[Callable[[], Transform]] = ()
    safety: Sequence[Callable[[], Transform]] = (partial(FiniteAction, "zero"),)
    residual_scale: float | Sequence[float] = 0.5
    batching: Batching = "native"
    max_episode_steps: int = 1000
    action_history: int = 1
    symmetries: Mapping[str, Mapping[str, Sequence[int]]] = field(default_factory=dict)
    metrics: Mapping[str, Metric] = field(default_factory=dict)
    control_period: float | None = None
    judged: bool = False
    intervention: Callable[[], Intervention] | None = None
    units: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_factory(vars(self))

    def with_overrides(self, **overrides: Any) -> EnvironmentFactory:
        """Return the same chain on a base environment with other arguments (another scenario)."""
        return replace(self, base=partial(self.base, **overrides))

    def described(self) -> dict[str, Any]:
        """Return what decides what is stored: ``{"environment": {name: JSON}}``."""
        fields = ["controller", "disturbances", "sensing", "safety", "residual_scale"]
        fields += ["batching", "max_episode_steps", "action_history", "symmetries"]
        values = {name: getattr(self, name) for name in fields}
        for name in ("inputs", "critic_inputs"):
            read = as_inputs(getattr(self, name) or ())
            values[name] = {key: [e.loc, e.scale, e.channels] for key, e in read.items()}
        values["base"] = named(self.base, modules=False)
        values["metrics"] = {name: metric.model_dump() for name, metric in self.metrics.items()}
        values |= {"judged": self.judged, "intervention": self.intervention}
        return {"environment": plain(values, modules=False)}

    def make(self, num_envs: int = 1, *, operated: bool = False) -> ResumableEnv:
        """Build the environment with ``num_envs`` slots.

        Args:
            num_envs: How many.
            operated: Whether the operator may take over, if there is one: in training alone.

        Raises:
            KeyError: If an input or the controller names an entry that the environment lacks, or
                its action is called otherwise.
            TypeError: If ``base`` makes something else, an input holds no numbers, or the action is
                not continuous.
            ValueError: If there are not ``num_envs`` slots, the action is no vector, reward or an
                entry that is reported is not one number a slot, ``control_period`` is not the
                robot's own, or ``metrics`` names one that the environment does not write.
        """
        errors = WorkerErrors() if self.batching == "parallel" and num_envs > 1 else None
        env = ResumableEnv(self._make_base(num_envs, errors), Compose())
        env.__dict__["worker_errors"] = errors
        check_slots(env.batch_size, num_envs)
        if self.judged:
            env.append_transform(JudgedSuccess())
        check_period(env.base_env, self.control_period)
        check_action(env.full_action_spec)
        check_reward(env.full_reward_spec)
        check_reported(env.observation_spec, env.ndim, self.metrics)
        convert(env)
        for make in (*self.safety, *self.disturbances, *self.sensing):
            env.append_transform(make())
        if operated and self.intervention is not None:
            env.append_transform(self.intervention())
        residual = ResidualAction(self.controller(), scale=self.residual_scale)
        env.append_transform(residual)
        check_length("residual_scale", residual.scale, residual.limits().shape[-1], "the action")
        if PREVIOUS_ACTION in {*self.inputs, *(self.critic_inputs or ())}:
            env.append_transform(ActionHistory(self.action_history))
        self.read_inputs(env)
        self.read_critic_inputs(env)
        return env

    def read_inputs(self, env: EnvBase) -> dict[str, Input]:
        """Return the policy's inputs with the shapes that they have in ``env``.

        Raises:
            KeyError: If ``env`` lacks one of them.
            TypeError: If one of them holds no numbers.
            ValueError: If a center or scale does not fit its entry.
        """
        return read_inputs("inputs", as_inputs(self.inputs), env)

    def read_critic_inputs(self, env: EnvBase) -> dict[str, Input] | None:
        """Return the critics' inputs; None if they read what the policy reads.

        Raises:
            KeyError, TypeError, ValueError: See :meth:`read_inputs`.
        """
        if self.critic_inputs is None:
            return None
        given = as_inputs(self.inputs) | as_inputs(self.critic_inputs)
        wanted = {name: given[name] for name in self.critic_inputs}
        return read_inputs("critic_inputs", wanted, env)

    def symmetry(self) -> Symmetry | None:
        """Return the symmetry of features and action; None if there are no mirrors.

        Raises:
            ValueError: If a mirror lacks an input's map, or has one that is no map or does not fit
                ``scale``.
        """
        if not self.symmetries:
            return None
        mirrors = []
        for name, given in self.symmetries.items():
            try:
                maps = {key: as_map(key, numbers) for key, numbers in given.items()}
                parts = [
                    self._map(key, entry, maps) for key, entry in as_inputs(self.inputs).items()
                ]
                mirrors.append((_joined(parts), maps[ACTION]))
            except KeyError as missing:
                raise ValueError(
                    f"symmetries.{name}: expected a map of {missing}, got {sorted(given)}"
                ) from None
            except ValueError as error:
                raise ValueError(f"symmetries.{name}.{error}") from None
        return Symmetry(mirrors)

    def _map(self, key: str, entry: Input, maps: Mapping[str, Sequence[int]]) -> Sequence[int]:
        if key in (BASE_ACTION, PREVIOUS_ACTION):
            return _joined([maps[ACTION]] * (self.action_history if key == PREVIOUS_ACTION else 1))
        scale = replace(entry, shape=(len(maps[key]),)).column("scale")
        if any(scale[abs(i) - 1] != scale[n] for n, i in enumerate(maps[key])):
            raise ValueError(
                f"{key}: expected equal scales of numbers that the mirror exchanges, "
                f"got {entry.scale}"
            )
        return maps[key]

    def _make_base(self, num_envs: int, errors: WorkerErrors | None) -> EnvBase:
        if self.batching == "native":
            return check_base(make_native(self.base, num_envs))
        if num_envs == 1:
            return _one(self.base)
        make = partial(_one, self.base)
        if errors is None:
            return SerialEnv(num_envs, make)
        keep_sockets_short()
        return ParallelEnv(num_envs, [errors.reporting(make, i) for i in range(num_envs)])


def _one(base: Callable[..., EnvBase]) -> EnvBase:
    return check_base(base())


def _joined(maps: Sequence[Sequence[int]]) -> list[int]:
    """Return one map of vectors that stand one after the other."""
    joined: list[int] = []
    for numbers in maps:
        offset = len(joined)
        joined += [i + offset if i > 0 else i - offset for i in numbers]
    return joined
