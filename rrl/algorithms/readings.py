"""What actor and critics read: features of observation entries, and who teaches their encoders."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor

from rrl.checks import check, check_whole, require
from rrl.encoders.interface import EncoderFactory, Inputs
from rrl.inputs import Input
from rrl.keys import ACTION, CRITIC_OBSERVATION, OBSERVATION


def with_shapes(inputs: Mapping[NestedKey, Input | int] | None) -> dict[NestedKey, Input]:
    """Return inputs; a number stands for a vector of that size."""
    return {
        key: entry
        if isinstance(entry, Input)
        else Input(shape=(check_whole(f"inputs.{key}", entry, 1),))
        for key, entry in (inputs or {}).items()
    }


class Reading:
    """Some entries, and the features that an encoder makes of them.

    Args:
        key: Where the features go.
        inputs: The entries.
        make_encoder: Makes the encoder.
        taught_by_policy: Whether an encoder that learns does so with the policy, not the critics.

    Attributes:
        augmented: The entries that :meth:`augment` changes.
    """

    def __init__(
        self, key: str, inputs: Inputs, make_encoder: EncoderFactory, taught_by_policy: bool = False
    ) -> None:
        self.key, self.keys, self.taught_by_policy = key, list(inputs), taught_by_policy
        self.augmented = list(inputs)
        self.encoder: Any = make_encoder(inputs)

    @property
    def learned(self) -> list[Tensor]:
        """What the encoder learns; one that learns nothing is run once a batch."""
        return [p for p in self.encoder.parameters() if p.requires_grad]

    @property
    def calibrated_by(self) -> list[NestedKey]:
        """The entries that the encoder derives something from."""
        if not hasattr(self.encoder, "calibrate"):
            return []
        return list(getattr(self.encoder, "calibrated_by", self.keys))

    def calibrate(self, entries: TensorDictBase) -> dict[NestedKey, Any]:
        """Let the encoder derive what it derives from the first entries ``[n]``."""
        if not self.calibrated_by:
            return {}
        return dict(self.encoder.calibrate(*(entries[key] for key in self.calibrated_by)))

    def prepare(self, entries: TensorDictBase, out: TensorDictBase) -> None:
        """Set what an update needs: the features, or the entries that they are learned from."""
        if self.learned:
            for key, value in zip(self.keys, self._values(entries), strict=True):
                out.set(key, value)
        else:
            with torch.no_grad():
                out.set(self.key, self._features(entries))

    def augment(self, batch: TensorDictBase) -> None:
        """Put what the encoder wants to learn from in the place of a training batch's entries."""
        if self.learned and hasattr(self.encoder, "augment"):
            values = self.encoder.augment(*(batch.get(key) for key in self.keys))
            for key, value in zip(self.keys, values, strict=True):
                if key in self.augmented:
                    batch.set(key, value)

    def read(self, batch: TensorDictBase, learning: bool) -> None:
        """Set the features of a training batch, unless :meth:`prepare` has."""
        if self.learned:
            with torch.set_grad_enabled(learning):
                batch.set(self.key, self._features(batch))

    def _features(self, entries: TensorDictBase) -> Tensor:
        return self.encoder(*self._values(entries))

    def _values(self, entries: TensorDictBase) -> list[Tensor]:
        return [require(self.encoder, entries, key) for key in self.keys]


class Readings:
    """What actor and critics read.

    Critics that read what the actor reads share its encoder and teach it. Critics with entries of
    their own have an encoder of their own, and the policy teaches the actor's: they would teach it
    nothing that they can read elsewhere, such as in the poses that only a simulation knows.

    Args:
        inputs: Of the actor.
        critic_inputs: Of the critics; none: the same.
        make_encoder: Makes an encoder.

    Attributes:
        actor: The actor's.
        critic: The critics'.
        learn: Whether an encoder learns.

    Raises:
        ValueError: If there is no entry, or one is called as features or the action are.
    """

    def __init__(self, inputs: Inputs, critic_inputs: Inputs, make_encoder: EncoderFactory) -> None:
        check("inputs", list(inputs), "at least one observation entry", bool(inputs))
        taken = dict.fromkeys((OBSERVATION, CRITIC_OBSERVATION), "features go")
        for key, what in {**taken, ACTION: "what the policy says goes"}.items():
            if key in inputs or key in critic_inputs:
                raise ValueError(
                    f"inputs: expected no entry called {key!r}, which is where {what}; rename it "
                    "(torchrl.envs.RenameTransform)"
                )
        shared = not critic_inputs
        self.actor = Reading(OBSERVATION, inputs, make_encoder, taught_by_policy=not shared)
        self.critic = self.actor
        if not shared:
            self.critic = Reading(CRITIC_OBSERVATION, critic_inputs, make_encoder)
            if self.actor.learned:  # what both read is augmented once
                self.critic.augmented = [k for k in critic_inputs if k not in inputs]
        self._all = [self.actor] if shared else [self.actor, self.critic]
        self.learn = any(reading.learned for reading in self._all)

    def __iter__(self) -> Iterator[Reading]:
        return iter(self._all)

    @property
    def calibrated_by(self) -> set[NestedKey]:
        """The entries that encoders derive something from: numbers, and seldom an image."""
        return {key for reading in self._all for key in reading.calibrated_by}

    def prepare(self, batches: TensorDictBase) -> TensorDict:
        """Return transitions with the features of fixed encoders in the place of entries.

        Raises:
            KeyError: If an entry is missing.
            ValueError: If the transitions are not ``[k, B]``.
        """
        if batches.ndim != 2:
            raise ValueError(
                f"batches: expected transitions [k, B], got {list(batches.shape)}; use unsqueeze(0)"
            )
        following = batches["next"]
        entries = [key for reading in self._all for key in reading.keys]
        out, out_next = batches.exclude("next", *entries), following.exclude(*entries)
        for reading in self._all:
            reading.prepare(batches, out)
            reading.prepare(following, out_next)
        return out.set("next", out_next)

    def for_critics(self, batch: TensorDictBase) -> TensorDictBase:
        """Return a batch with the features that the critics' loss reads, where they are learned."""
        if not self.learn:
            return batch
        out = batch.clone(False)
        following = out["next"]
        for reading in self._all:
            reading.augment(out)
            reading.augment(following)
            reading.read(following, learning=False)
            if not reading.taught_by_policy:
                reading.read(out, learning=True)
        return out

    def for_policy(self, batch: TensorDictBase) -> TensorDictBase:
        """Return the same batch with the features that the policy's loss reads."""
        if not self.learn:
            return batch
        out = batch.clone(False)
        for reading in self._all:
            if reading.taught_by_policy:
                reading.read(out, learning=True)
            else:
                out.set(reading.key, out[reading.key].detach())
        return out
