"""What the algorithms on stacked seeds share: networks, optimisers, the order of the updates, the extra state."""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import Any, ClassVar

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor, nn
from torchrl.objectives import LossModule, SoftUpdate
from torchrl.objectives.utils import ValueEstimators

from rrl.algorithms.adam import Adam
from rrl.algorithms.networks import StackedMLP
from rrl.algorithms.steps import GradientSteps, Step
from rrl.algorithms.symmetric_actor import SymmetricActor
from rrl.checks import check
from rrl.keys import ACTION
from rrl.slot_random import SlotGenerators
from rrl.symmetry import Symmetry

__all__ = ["Agent"]

UPDATES_PER_GRAPH = 4
"""At most: every further one saves less time in a call and takes as long to compile as the first."""

LOSS_FUNCTIONS = ("l1", "l2", "smooth_l1")


class Agent(nn.Module, ABC):
    """``S`` independent learners: an actor, critics, a TorchRL loss with ``reduction="none"``, target networks.

    A subclass names the :attr:`stream` of its random numbers, makes its networks with :meth:`make_actor` and
    :meth:`make_critics`, hands its loss to :meth:`learn_from`, and implements :meth:`value_loss` and
    :meth:`actor_loss`. Losses come as ``[S, B]``; their mean over ``B`` is summed over the seeds, which leaves the
    seeds' gradients apart. Random numbers of the losses are drawn outside (:meth:`prepare`), from one generator a
    seed, and enter as data.

    Args:
        input_sizes: size of each observation entry that actor and critics read, by key.
        action_size: size of the action; the policy's action lies in [-1, 1].
        num_seeds: how many independent learners are stacked.
        seed: learner ``k`` is the learner that ``seed + k`` alone would give.
        hidden: widths of the hidden layers, of actor and critics.
        layer_norm: normalise the hidden layers of actor and critics.
        last_layer_bound: the actor's output layer is drawn from ``U(-bound, bound)``; 0 makes an untrained residual
            exactly zero.
        actor_lr, critic_lr: learning rates of Adam.
        gamma: discount.
        tau: share by which the targets follow.
        policy_delay: critic updates per update of policy and targets.
        critic_burn_in: updates at the start in which the critics learn and the policy waits.
        loss_function: the critics' loss, ``"l2"``, ``"l1"`` or ``"smooth_l1"``.
        reward_scale: factor on the stored reward before the critics see it.
        compiled: compile the whole update into one graph.
        symmetry: of the task; the learners then learn from randomly chosen mirror images of their transitions, and act
            as the mean over all images (:class:`rrl.symmetry.SymmetricActor`).

    Raises:
        ValueError: a hyperparameter out of its range.

    """

    stream: str
    loss: LossModule
    __signature__: ClassVar[inspect.Signature]
    _actor: StackedMLP
    _actor_arguments: dict[str, Any]

    def __init__(
        self,
        input_sizes: dict[str, int],
        action_size: int,
        *,
        num_seeds: int = 1,
        seed: int = 0,
        hidden: Sequence[int] = (256, 256),
        layer_norm: bool = False,
        last_layer_bound: float = 0.0,
        actor_lr: float = 1e-3,
        critic_lr: float = 1e-3,
        gamma: float = 0.99,
        tau: float = 0.005,
        policy_delay: int = 1,
        critic_burn_in: int = 0,
        loss_function: str = "l2",
        reward_scale: float = 1.0,
        compiled: bool = False,
        symmetry: Symmetry | None = None,
    ) -> None:
        super().__init__()
        check("gamma", gamma, "a discount in [0, 1)", 0 <= gamma < 1)
        check("tau", tau, "a share in (0, 1]", 0 < tau <= 1)
        check("policy_delay", policy_delay, "at least 1 update", policy_delay >= 1)
        check("critic_burn_in", critic_burn_in, "0 updates or more", critic_burn_in >= 0)
        check(
            "loss_function",
            loss_function,
            " or ".join(LOSS_FUNCTIONS),
            loss_function in LOSS_FUNCTIONS,
        )
        self.input_keys = list(input_sizes)
        self.action_size, self.num_seeds, self.seed = action_size, num_seeds, seed
        self.hidden, self.layer_norm, self.last_layer_bound = hidden, layer_norm, last_layer_bound
        self.actor_lr, self.critic_lr = actor_lr, critic_lr
        self.gamma, self.tau, self.loss_function, self.reward_scale = (
            gamma,
            tau,
            loss_function,
            reward_scale,
        )
        self.policy_delay, self.critic_burn_in = policy_delay, critic_burn_in
        self.compiled = compiled
        self.num_updates = 0
        self._in_size = sum(input_sizes.values())
        self._generators = [torch.Generator().manual_seed(seed + k) for k in range(num_seeds)]
        self._noise = SlotGenerators(seed, num_seeds, stream=self.stream)
        self._images = SlotGenerators(seed, num_seeds, stream="images")
        self.symmetry = symmetry
        if symmetry is not None:
            sizes, expected = (
                (symmetry.observation_size, symmetry.action_size),
                (self._in_size, action_size),
            )
            maps = f"maps of {expected[0]} numbers of observation and {expected[1]} of action"
            check("symmetry", sizes, maps, sizes == expected)
            check("symmetry", self.input_keys, "one observation entry", len(self.input_keys) == 1)

    def __init_subclass__(cls, **arguments: Any) -> None:
        """Show in the signature what ``**hyperparameters`` passes on; checks of a configuration read it."""
        super().__init_subclass__(**arguments)
        kinds = [kind for kind in reversed(cls.__mro__) if issubclass(kind, Agent)]
        parameters = {
            name: p
            for kind in kinds
            for name, p in inspect.signature(kind.__init__).parameters.items()
        }
        shown = [p for p in parameters.values() if p.kind is not p.VAR_KEYWORD]
        cls.__signature__ = inspect.Signature(shown[1:])  # without self

    # ---------------------------------------------------------------- construction

    def make_actor(self, out_features: int, squash: bool) -> StackedMLP:
        """Make the actor network; weights are drawn from the seeds' generators, actor before critics."""
        self._actor_arguments = {
            "in_features": self._in_size,
            "out_features": out_features,
            "hidden": list(self.hidden),
            "last_layer_bound": self.last_layer_bound,
            "layer_norm": self.layer_norm,
            "squash": squash,
        }
        self._actor = StackedMLP(
            self.num_seeds, generators=self._generators, **self._actor_arguments
        )
        return self._actor

    def make_critics(self, count: int) -> list[TensorDictModule]:
        """Make critics from the input keys and the action to ``state_action_value`` [S, B, 1]."""
        networks = [
            StackedMLP(
                self.num_seeds,
                self._in_size + self.action_size,
                1,
                list(self.hidden),
                layer_norm=self.layer_norm,
                generators=self._generators,
            )
            for _ in range(count)
        ]
        keys = [*self.input_keys, ACTION]
        return [
            TensorDictModule(n, in_keys=keys, out_keys=["state_action_value"]) for n in networks
        ]

    def learn_from(
        self, loss: LossModule, critic_params: TensorDictBase, actor_params: TensorDictBase
    ) -> None:
        """Take over the loss, and make optimisers and targets for it."""
        self.loss = loss
        self.loss.make_value_estimator(ValueEstimators.TD0, gamma=self.gamma)
        self.soft_update = SoftUpdate(self.loss, tau=self.tau)
        self._critic_params = list(critic_params.values(True, True))
        self._actor_params = list(actor_params.values(True, True))
        self.critic_optimizer = Adam(self._critic_params, self.critic_lr)
        self.actor_optimizer = Adam(self._actor_params, self.actor_lr)
        self._take = GradientSteps(self, self.compiled)

    def start_from(self, other: Agent, k: int) -> None:
        """Take the networks of learner ``k`` of ``other`` as every learner's initial weights; optimisers stay fresh.

        Raises:
            ValueError: if ``other`` is of another algorithm or has networks of other sizes.

        """
        given, own = other.loss.state_dict(), self.loss.state_dict()
        weights = [
            name for name, value in own.items() if value.ndim >= 3
        ]  # [..., S, rows, columns]
        for name in weights:
            if name not in given or given[name].shape[-2:] != own[name].shape[-2:]:
                raise ValueError(
                    f"initial weights: expected a {type(self).__name__} with {name} of {tuple(own[name].shape[-2:])}, "
                    f"got a {type(other).__name__} with {tuple(given[name].shape[-2:]) if name in given else 'none'}"
                )
        with torch.no_grad():
            for name in weights:
                own[name].copy_(given[name].narrow(-3, k, 1))

    # ---------------------------------------------------------------- acting

    @property
    def policy(self) -> TensorDictModuleBase:
        """The policies of all seeds: input keys ``[S * E, ...]``, seed-major, to ``action`` in [-1, 1]."""
        return self.wrap(self._symmetric(self._actor), self.seed)

    def policy_of(self, k: int) -> TensorDictModuleBase:
        """A copy of seed ``k``'s policy that accepts any batch size."""
        actor = StackedMLP(1, generators=[torch.Generator()], **self._actor_arguments)
        actor.load_state_dict({n: p[k : k + 1] for n, p in self._actor.state_dict().items()})
        return self.wrap(self._symmetric(actor), self.seed + k)

    def _symmetric(self, actor: StackedMLP) -> StackedMLP | SymmetricActor:
        return actor if self.symmetry is None else SymmetricActor(actor, self.symmetry)

    def wrap(self, actor: StackedMLP | SymmetricActor, seed: int) -> TensorDictModuleBase:
        """Make a policy of an actor network; ``seed`` is the first seed of its stack."""
        return TensorDictModule(actor, in_keys=self.input_keys, out_keys=[ACTION])

    # ---------------------------------------------------------------- learning

    @property
    def compile_seconds(self) -> float:
        """Seconds that compiling updates has taken so far."""
        return self._take.compile_seconds

    def update(self, batches: TensorDictBase) -> dict[str, Tensor]:
        """Take one gradient step per batch.

        Args:
            batches: ``[k, S, B]``, with the input keys, ``action``, and in ``next`` the input keys, ``reward``,
                ``done`` and ``terminated``; changed in place.

        Returns:
            Means over the ``k`` updates, ``[S]`` each: ``loss_critic``, ``loss_actor`` (absent while no policy update
            was due) and what the algorithm adds.

        """
        following = batches["next"]
        following["reward"] = following["reward"] * self.reward_scale
        if self.symmetry is not None:
            self._reflect(batches, self.symmetry)
        self.prepare(batches)
        entries = sorted(batches.items(True, True), key=lambda item: str(item[0]))
        keys, columns = (
            tuple(key for key, _ in entries),
            [value.contiguous() for _, value in entries],
        )
        history: dict[str, list[Tensor]] = {}
        for first, steps in self._plan(len(batches)):
            part = [column[first : first + len(steps)] for column in columns]
            for name, values in self._take(steps, keys, part).items():
                history.setdefault(name, []).append(values)
        return {name: torch.cat(values).mean(0) for name, values in history.items()}

    def _plan(self, k: int) -> Iterator[tuple[int, tuple[Step, ...]]]:
        """The next ``k`` updates in parts, up to a policy update each, with the number of a part's first update."""
        first = 0
        while first < k:
            to_policy = self.policy_delay - self.num_updates % self.policy_delay
            size = min(to_policy, k - first, UPDATES_PER_GRAPH)
            yield first, tuple(self._next_step() for _ in range(size))
            first += size

    def _next_step(self) -> Step:
        self.num_updates += 1
        if self.num_updates % self.policy_delay:
            return self._critic_step
        return (
            self._critic_and_target_step
            if self.num_updates <= self.critic_burn_in
            else self._critic_and_policy_step
        )

    def _reflect(self, batches: TensorDictBase, symmetry: Symmetry) -> None:
        """Put a mirror image, drawn by the transition's seed, in the place of each transition."""
        k, _, batch = batches.shape
        which = self._images.integers(symmetry.num_images, (k, batch)).transpose(
            0, 1
        )  # drawn as (S, k, B)
        for key in (self.input_keys[0], ("next", self.input_keys[0])):
            batches[key] = symmetry.reflect(batches[key], which)
        batches[ACTION] = symmetry.reflect_action(batches[ACTION], which)

    def prepare(self, batches: TensorDictBase) -> None:
        """Add random numbers that the losses need to ``batches`` [k, S, B]."""

    def draw(self, shape: torch.Size) -> Tensor:
        """Draw standard normal numbers ``[k, S, B, n_act]`` from the seeds' own generators."""
        k, _, batch, size = shape
        return self._noise.normal((k, batch, size)).transpose(0, 1)  # drawn as (S, k, B, n_act)

    @abstractmethod
    def value_loss(self, batch: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the critics' loss ``[S, B]`` and metrics ``[S]``."""

    @abstractmethod
    def actor_loss(self, batch: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the policy's loss ``[S, B]`` and metrics ``[S]``."""

    def _critic_step(self, batch: TensorDictBase) -> dict[str, Tensor]:
        loss, info = self.value_loss(batch)
        loss = loss.mean(-1)
        self.critic_optimizer.step(torch.autograd.grad(loss.sum(), self._critic_params))
        return {"loss_critic": loss.detach(), **info}

    def _critic_and_target_step(self, batch: TensorDictBase) -> dict[str, Tensor]:
        metrics = self._critic_step(batch)
        self.soft_update.step()
        return metrics

    def _critic_and_policy_step(self, batch: TensorDictBase) -> dict[str, Tensor]:
        metrics = self._critic_step(batch)
        loss, info = self.actor_loss(batch)
        loss = loss.mean(-1)
        self.actor_optimizer.step(torch.autograd.grad(loss.sum(), self._actor_params))
        self.soft_update.step()
        return metrics | {"loss_actor": loss.detach(), **info}

    # ---------------------------------------------------------------- state

    def get_extra_state(self) -> dict[str, Any]:
        """What a checkpoint needs beyond tensors: the update counter and the generators of noise and images."""
        images = {} if self.symmetry is None else {"images": self._images.state_dict()}
        return {"num_updates": self.num_updates, "noise": self._noise.state_dict(), **images}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restore :meth:`get_extra_state`."""
        self.num_updates = state["num_updates"]
        self._noise.load_state_dict(state["noise"])
        if self.symmetry is not None:
            self._images.load_state_dict(state["images"])
