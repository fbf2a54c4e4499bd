"""What all algorithms share: networks, optimizers, the order of the updates."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor, nn
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.objectives import LossModule, SoftUpdate
from torchrl.objectives.utils import ValueEstimators

from rrl.algorithms.calibration import derived
from rrl.algorithms.networks import ActingNetwork, FirstOnly, Movable, learned, output_layer
from rrl.algorithms.precision import single_precision
from rrl.algorithms.readings import Readings, with_shapes
from rrl.algorithms.reward_scale import RewardScale
from rrl.algorithms.settings import AgentSettings
from rrl.algorithms.symmetric_actor import SymmetricActor
from rrl.algorithms.transfer import ingredients, remade, take_over
from rrl.algorithms.updates import UPDATES_PER_GRAPH, Kind, Updates
from rrl.algorithms.value_bounds import BoundedTD0Estimator, bound_values
from rrl.checks import check_whole
from rrl.inputs import Input
from rrl.keys import ACTION, REWARD
from rrl.symmetry import Symmetry


class Agent(Movable, ABC):
    """A learner: actor, critics, a TorchRL loss, target networks, optimizers.

    A subclass makes its networks (:meth:`make_actor`, :meth:`make_policy`, :meth:`make_critics`),
    hands its loss to :meth:`learn_from`, and implements :meth:`value_loss` and :meth:`actor_loss`.
    Random numbers of weights, losses and acting come from torch's global generator.

    Args:
        inputs: Observation entries that the policy reads, or their sizes.
        action_size: Size ``m`` of the action; the policy's action lies in [-1, 1].
        critic_inputs: Entries that the critics read, such as those that only a simulation can give;
            none: the same as the policy.
        symmetry: Of features and action; the learner then learns from randomly chosen mirror images
            of its transitions, and acts as the mean over all images.
        episode_steps: Steps of an episode, from which a discount of None is derived.
        settings: See the class's ``Settings``.

    Raises:
        ValueError: If a hyperparameter is unknown or out of range, or ``symmetry`` does not fit.
    """

    Settings: ClassVar[type[AgentSettings]] = AgentSettings
    bounded_targets: ClassVar[type[BoundedTD0Estimator]] = BoundedTD0Estimator
    """What makes targets where ``value_bounds`` is true."""
    loss: LossModule
    critic_optimizer: Any
    actor_optimizer: Any
    residual_weight: Tensor
    """Weight of the action's square, a scalar."""
    policy: TensorDictModuleBase
    """From the inputs ``[*batch, *shape]`` to ``action`` [*batch, m] in [-1, 1]."""
    policy_waits = False  # in the update at work

    def __init__(
        self,
        inputs: Mapping[NestedKey, Input | int],
        action_size: int,
        *,
        critic_inputs: Mapping[NestedKey, Input | int] | None = None,
        symmetry: Symmetry | None = None,
        episode_steps: int | None = None,
        **settings: Any,
    ) -> None:
        super().__init__()
        self.settings = self.Settings(**settings)
        self.gamma = derived(self.settings, "gamma", episode_steps)
        self.penalty_updates = derived(self.settings, "penalty_updates", episode_steps)
        self.is_calibrated = False
        self.rewards = RewardScale(self.settings.reward_scale)
        self.register_buffer("residual_weight", torch.tensor(self.settings.residual_penalty))
        self.inputs, self.critic_inputs = with_shapes(inputs), with_shapes(critic_inputs)
        self.readings = Readings(self.inputs, self.critic_inputs, self.settings.encoder)
        self.encoders = nn.ModuleList(reading.encoder for reading in self.readings)
        self.read_keys = [reading.key for reading in self.readings]
        self.action_size, self.symmetry = check_whole("action_size", action_size, 1), symmetry
        self.num_updates = 0
        if symmetry is not None:
            if self.readings.learn or critic_inputs:
                raise ValueError(
                    "symmetry: expected an encoder that learns nothing and critics that read what "
                    "the policy reads; set use_symmetries to false to do without symmetry"
                )
            symmetry.check_sizes(self.encoder.out_features, action_size)

    @property
    def reward_scale(self) -> Tensor:
        """Factor on the stored reward, a scalar."""
        return self.rewards.value

    @property
    def encoder(self) -> Any:
        """The policy's encoder."""
        return self.readings.actor.encoder

    def make_actor(self, out_features: int) -> nn.Module:
        """Make the actor network, from features to ``[*batch, out_features]``."""
        size, bound = self.encoder.out_features, self.settings.last_layer_bound
        network = self.settings.network(in_features=size, out_features=out_features)
        self._action_layer = output_layer(network, size)
        for parameter in network.get_submodule(self._action_layer).parameters():
            nn.init.uniform_(parameter, -bound, bound)
        return network.float()

    def make_critics(self, count: int) -> list[TensorDictModule]:
        """Make critics from what is read and the action to ``state_action_value`` [*batch, 1]."""
        read = self.readings.critic
        sizes = read.encoder.out_features, self.action_size
        networks = [
            self.settings.network(in_features=sum(sizes), out_features=1).float()
            for _ in range(count)
        ]
        keys = [read.key, ACTION]
        self._value_layer = output_layer(networks[0], *sizes)
        return [
            TensorDictModule(n, in_keys=keys, out_keys=["state_action_value"]) for n in networks
        ]

    def make_policy(self, actor: nn.Module) -> Any:
        """Make :attr:`policy` of the actor network; return the actor module for the loss."""
        acting = actor if self.symmetry is None else SymmetricActor(actor, self.symmetry)
        self.policy = self.actor_module(ActingNetwork(self.encoder, acting), list(self.inputs))
        # TorchRL's losses give critics nothing that is not among the actor's keys.
        learning = actor if len(self.read_keys) == 1 else FirstOnly(actor)
        return self.actor_module(learning, list(self.read_keys))

    def actor_module(self, network: nn.Module, keys: list[NestedKey]) -> Any:
        """Return the module from ``keys`` to ``action``; a stochastic policy has its own."""
        return TensorDictModule(network, in_keys=keys, out_keys=[ACTION])

    def learn_from(
        self, loss: LossModule, critic_params: TensorDictBase, actor_params: TensorDictBase
    ) -> None:
        """Take over the loss, and make optimizers and targets for it."""
        self.loss = loss
        self.loss.make_value_estimator(ValueEstimators.TD0, gamma=self.gamma)
        if self.settings.value_bounds:
            bound_values(self.loss, self.bounded_targets)
        self.soft_update = SoftUpdate(self.loss, tau=self.settings.tau)
        self._critic_params, self._actor_params = map(learned, (critic_params, actor_params))
        for reading in self.readings:
            pupils = self._actor_params if reading.taught_by_policy else self._critic_params
            pupils.extend(reading.learned)
        make = self.settings.optimizer
        self.critic_optimizer = make(self._critic_params, lr=self.settings.critic_lr)
        self.actor_optimizer = make(self._actor_params, lr=self.settings.actor_lr)
        compiled, bfloat16 = self.settings.compiled, self.settings.products == "bfloat16"
        self._updates = Updates(self, self._take_step, compiled, bfloat16)

    def start_from(self, other: Agent) -> None:
        """Take over networks, targets and temperature of ``other``, and what it has derived.

        Raises:
            ValueError: If ``other`` is of another algorithm or has networks of other sizes.
        """
        take_over(self, other)

    @torch.no_grad()
    def calibrate(self, transitions: TensorDictBase) -> dict[str, Any]:
        """Derive what is not set from the first transitions, before anything is learned from them.

        Args:
            transitions: ``[n]``, as for :meth:`update`.

        Returns:
            ``gamma``, ``penalty_updates``, ``reward_scale`` and, of every input that was
            standardized, center and scale.
        """
        inputs = dict[NestedKey, Any]()
        self.follow_rewards(transitions)
        for reading in self.readings if self.symmetry is None else ():
            inputs |= reading.calibrate(transitions)
        self.is_calibrated = True
        lengths = {"gamma": self.gamma, "penalty_updates": self.penalty_updates}
        return {**lengths, "reward_scale": float(self.reward_scale), "inputs": inputs}

    def follow_rewards(self, transitions: TensorDictBase) -> None:
        """Let a derived reward scale follow all rewards ``[n]`` as the environment gave them."""
        self.rewards.follow(transitions, self.gamma, self.loss, self._value_layer)

    @property
    def compile_seconds(self) -> float:
        """Seconds that compiling updates has taken so far."""
        return self._updates.compile_seconds

    @single_precision()
    def update(self, batches: TensorDictBase) -> dict[str, Tensor]:
        """Take one gradient step per batch.

        Args:
            batches: Transitions ``[k, B]`` with the inputs, ``action``, and in ``next`` the inputs,
                ``reward``, ``done`` and ``terminated``.

        Returns:
            Means over the ``k`` updates: ``loss_critic``, ``loss_actor`` (absent while no policy
            update was due) and what the algorithm adds; ``reward_scale`` if it is derived.

        Raises:
            ValueError: If the transitions are not ``[k, B]``.
        """
        fall = 1 + self.num_updates / self.penalty_updates
        self.residual_weight.fill_(self.settings.residual_penalty / fall)
        batches = self._prepared(batches)
        if self.symmetry is not None:
            self.symmetry.reflect_transitions(batches)
        entries = sorted(batches.items(True, True), key=lambda item: str(item[0]))
        keys, columns = tuple(k for k, _ in entries), [v.contiguous() for _, v in entries]
        history: dict[str, list[Tensor]] = {}
        for first, kinds in self._plan(len(batches)):
            part = [column[first : first + len(kinds)] for column in columns]
            for name, values in self._updates(kinds, keys, part).items():
                history.setdefault(name, []).append(values)
        if self.rewards.derives:
            history["reward_scale"] = [self.reward_scale.reshape(1).clone()]
        return {name: torch.cat(values).mean() for name, values in history.items()}

    def _prepared(self, batches: TensorDictBase) -> TensorDict:
        """Return what the updates need, in their precision."""
        out, scale = self.readings.prepare(batches), self.reward_scale
        action, reward = (out[key].to(scale.dtype) for key in (ACTION, ("next", REWARD)))
        return out.update({ACTION: action, "next": {REWARD: reward * scale}})

    def _plan(self, k: int) -> Iterator[tuple[int, tuple[Kind, ...]]]:
        """Yield the next ``k`` updates in parts, up to a policy update each, with their place."""
        first = 0
        while first < k:
            to_policy = self.settings.policy_delay - self.num_updates % self.settings.policy_delay
            size = min(to_policy, k - first, UPDATES_PER_GRAPH)
            yield first, tuple(self._next_kind() for _ in range(size))
            first += size

    def _next_kind(self) -> Kind:
        self.num_updates += 1
        if self.num_updates % self.settings.policy_delay:
            return "critics"
        return "targets" if self.num_updates <= self.settings.critic_burn_in else "policy"

    @abstractmethod
    def value_loss(self, batch: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the critics' loss and metrics, scalars, of a batch ``[B]``."""

    @abstractmethod
    def actor_loss(self, batch: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the policy's loss and metrics, scalars, of a batch ``[B]``."""

    def _take_step(self, kind: Kind, batch: TensorDictBase) -> dict[str, Tensor]:
        batch, self.policy_waits = self.readings.for_critics(batch), kind == "targets"
        loss, info = self.value_loss(batch)
        self.critic_optimizer.step(torch.autograd.grad(loss, self._critic_params))
        metrics = {"loss_critic": loss.detach(), **info}
        if kind == "policy":
            metrics |= self._learn_policy(self.readings.for_policy(batch))
        if kind != "critics":
            self.soft_update.step()
        return metrics

    def _learn_policy(self, batch: TensorDictBase) -> dict[str, Tensor]:
        loss, info = self.actor_loss(batch)
        if self.settings.residual_penalty:
            square = self._residual(batch).square().sum(-1).mean()
            loss = loss + self.residual_weight * square
            info = {**info, "residual_square": square.detach()}
        self.actor_optimizer.step(torch.autograd.grad(loss, self._actor_params))
        return {"loss_actor": loss.detach(), **info}

    def _residual(self, batch: TensorDictBase) -> Tensor:
        """Return the policy's action without exploration, ``[B, m]``."""
        loss: Any = self.loss
        acting = batch.select(*self.read_keys)
        with (
            set_exploration_type(ExplorationType.DETERMINISTIC),
            loss.actor_network_params.to_module(loss.actor_network, preserve_module_state=False),
        ):
            return loss.actor_network(acting)[ACTION]

    def __reduce__(self) -> tuple[Any, ...]:
        return remade, ingredients(self)  # for copies and pickles

    def get_extra_state(self) -> dict[str, Any]:
        """Return what a checkpoint needs beyond tensors."""
        return {"num_updates": self.num_updates, "is_calibrated": self.is_calibrated}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restore :meth:`get_extra_state`."""
        self.num_updates = state["num_updates"]
        self.is_calibrated = state["is_calibrated"]
