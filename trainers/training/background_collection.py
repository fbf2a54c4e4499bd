"""Experience collected in a process of its own while the updates run."""

from __future__ import annotations

import atexit
import io
import os
import pickle
import signal
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Mapping
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection
from typing import Any

import cloudpickle
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.checkpoint import GlobalRNGState

from rrl.algorithms.compilation import import_compiler

from ..environment import EnvironmentFactory
from ..settings import TrainerSettings
from .collection import Experience, InTurn, Metrics
from .interruption import SIGNALS
from .profiling import beside
from .torch_setup import configure_process

PATIENCE = 10.0
"""Seconds that a process gets to close its environment before it is ended."""


class Overlapped(Experience):
    """Collects the next round while this round's updates run, in a process that holds the environment.

    Round ``k`` acts with the policy that the updates of round ``k - 2`` left (the first two with the initial one),
    whether its collection began ahead or not. What a run learns therefore depends neither on timing nor on where it was
    checkpointed. The process gets the policy's parameters with every request and runs an :class:`InTurn`.

    Args:
        settings, environment, exploration: see :class:`InTurn`; the last two must be such that ``cloudpickle`` can
            send them.

    Raises:
        RuntimeError: if the process dies. What the environment raises is raised here.

    """

    def __init__(
        self,
        settings: TrainerSettings,
        environment: EnvironmentFactory,
        exploration: Callable[..., TensorDictModuleBase],
    ) -> None:
        context = get_context(
            "spawn"
        )  # a fork would inherit the threads' locks without the threads
        self._connection, far_end = context.Pipe()
        recipe = cloudpickle.dumps((settings, environment, exploration))
        self._process = context.Process(
            target=_serve, args=(far_end, recipe), name="rrl-collection"
        )
        self._process.start()
        far_end.close()
        atexit.register(
            self.close
        )  # before multiprocessing's own handler, which would wait for the process
        self._under_way = False
        self._before: dict[str, Any] | None = (
            None  # the state in which the collection that is under way began
        )
        self._continues: bool | None = None
        import_compiler()  # the process takes longer to start, and who collects so mostly compiles too
        self.sizes = self._receive()

    def follow(self, policy: TensorDictModuleBase) -> None:
        """Act with copies of ``policy``, one round of updates late."""
        self._policy = policy
        self._acting: Tensor | None = None  # parameters of the policy that collects next
        self._call("follow", cloudpickle.dumps(policy))

    def collect(self, env_steps: int) -> tuple[TensorDictBase, Metrics]:
        """Wait for the collection that was begun ahead, or collect now."""
        if not self._under_way:
            self._request(env_steps)
        self._under_way = False
        entries, metrics = self._receive()
        data = {key: torch.from_numpy(value) for key, value in entries.items()}
        return TensorDict(data, next(iter(data.values())).shape[:2]).unflatten_keys("/"), metrics

    def begin(self, env_steps: int | None, checkpoint: bool) -> None:
        """Begin the next collection with the policy as it is now, before this round's updates."""
        self._acting = _parameters(self._policy)
        if env_steps is not None:
            self._before = self.state_dict() if checkpoint else None
            self._request(env_steps)

    @property
    def under_way(self) -> bool:
        """Whether a collection was begun that :meth:`collect` has not returned."""
        return self._under_way

    @property
    def continues(self) -> bool:
        """Whether the environment has a state to save."""
        if self._continues is None:
            self._continues = self._call("continues")
        return self._continues

    def start_anew(self, seed: int) -> None:
        """Begin the next episode."""
        self._call("start_anew", seed)

    def state_dict(self) -> dict[str, Any]:
        """The process's state and the parameters that it acts with next; before a collection that is under way."""
        if self._under_way and self._before is not None:
            return self._before
        acting = _parameters(self._policy) if self._acting is None else self._acting
        return {"acting": acting, **_unpack(self._call("state"))}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore both."""
        self._acting = state["acting"]
        self._call(
            "restore", _pack({key: value for key, value in state.items() if key != "acting"})
        )

    def close(self) -> None:
        """Have the process close its environment, and end it if it does not."""
        atexit.unregister(self.close)
        self._connection.close()  # it reads the end of the requests
        self._process.join(PATIENCE)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._process.close()

    def _request(self, env_steps: int) -> None:
        parameters = _parameters(self._policy) if self._acting is None else self._acting
        self._send("collect", env_steps, parameters.numpy())
        self._under_way = True

    def _call(self, method: str, *arguments: Any) -> Any:
        if self._under_way:
            raise RuntimeError(f"{method}: a collection is under way")
        self._send(method, *arguments)
        return self._receive()

    def _send(self, method: str, *arguments: Any) -> None:
        try:
            self._connection.send((method, arguments))
        except OSError as error:
            raise self._death() from error

    def _receive(self) -> Any:
        try:
            succeeded, result = self._connection.recv()
        except (EOFError, OSError) as error:
            raise self._death() from error
        if succeeded:
            return result
        failure, text = pickle.loads(result)
        raise failure from RuntimeError(f"in the collecting process:\n{text}")

    def _death(self) -> RuntimeError:
        self._process.join(PATIENCE)
        return RuntimeError(
            f"the collecting process died with exit status {self._process.exitcode}; everything before is on disk: "
            "the newest checkpoint and all transitions that were stored"
        )


class _Collecting:
    """The far end: an :class:`InTurn` with a policy of its own."""

    def __init__(self, recipe: bytes) -> None:
        settings, environment, exploration = cloudpickle.loads(recipe)
        configure_process(settings)
        self.experience = InTurn(settings, environment, exploration)
        self.rng = GlobalRNGState()

    def follow(self, policy: bytes) -> None:
        self.policy = cloudpickle.loads(policy)
        self.experience.follow(self.policy)

    def collect(self, env_steps: int, parameters: Any) -> tuple[dict[str, Any], Metrics]:
        _assign(self.policy, torch.from_numpy(parameters))
        start = time.perf_counter()
        data, metrics = self.experience.collect(env_steps)
        if self.experience.settings.profile:
            metrics = beside(metrics, time.perf_counter() - start)
        return {key: value.numpy() for key, value in data.flatten_keys("/").items()}, metrics

    def continues(self) -> bool:
        return self.experience.continues

    def start_anew(self, seed: int) -> None:
        self.experience.start_anew(seed)

    def state(self) -> bytes:
        policy = {
            key: value
            for key, value in self.policy.state_dict().items()
            if not isinstance(value, Tensor)
        }
        return _pack(
            {"policy": policy, "rng": self.rng.state_dict(), **self.experience.state_dict()}
        )

    def restore(self, packed: bytes) -> None:
        state = _unpack(packed)
        self.policy.load_state_dict(state["policy"], strict=False)
        self.rng.load_state_dict(state["rng"])
        self.experience.load_state_dict(state)


def _serve(connection: Connection, recipe: bytes) -> None:
    """Answer requests until there are no more."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)  # they stop the run; the run ends this process
    threading.Thread(target=_end_with_parent, daemon=True).start()
    warnings.simplefilter("ignore")  # the run itself has said them
    collecting: _Collecting | None = None
    try:
        try:
            collecting = _Collecting(recipe)
            connection.send((True, collecting.experience.sizes))
        except Exception as error:
            connection.send((False, _portable(error)))
            return
        while True:
            method, arguments = connection.recv()
            try:
                answer = True, getattr(collecting, method)(*arguments)
            except Exception as error:
                answer = False, _portable(error)
            connection.send(answer)
    except (EOFError, OSError):
        pass
    finally:
        if collecting is not None:
            collecting.experience.close()


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _portable(error: Exception) -> bytes:
    """An exception and its traceback's text, as another kind where it cannot be sent."""
    text = "".join(traceback.format_exception(type(error), error, error.__traceback__))
    try:
        packed = pickle.dumps((error, text))
        pickle.loads(packed)
    except Exception:
        packed = pickle.dumps((RuntimeError(f"{type(error).__name__}: {error}"), text))
    return packed


def _tensors(policy: torch.nn.Module) -> list[Tensor]:
    return [tensor.data for tensor in (*policy.parameters(), *policy.buffers())]


def _parameters(policy: torch.nn.Module) -> Tensor:
    """All numbers of a policy in one vector, a copy."""
    return torch.cat([tensor.flatten() for tensor in _tensors(policy)])


def _assign(policy: torch.nn.Module, vector: Tensor) -> None:
    tensors = _tensors(policy)
    for tensor, part in zip(tensors, vector.split([t.numel() for t in tensors]), strict=True):
        tensor.copy_(part.view_as(tensor))


def _pack(state: Any) -> bytes:
    buffer = io.BytesIO()
    torch.save(state, buffer)
    return buffer.getvalue()


def _unpack(packed: bytes) -> Any:
    return torch.load(io.BytesIO(packed), map_location="cpu", weights_only=True)
