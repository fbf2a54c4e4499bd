"""Transitions collected in a process of its own while the updates run."""

from __future__ import annotations

import atexit
import contextlib
import io
import os
import signal
import threading
import time
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

from rrl.algorithms.compilation import import_compiler

from ..environment import EnvironmentFactory
from ..errors import packed, unpacked
from ..generators import Generators
from ..requests import Request, Requests, stop_of
from ..settings import TrainerSettings
from ..storage.plain_state import from_plain, to_plain
from .collection import Apart, Collection, InTurn, Metrics
from .interface import Exploration
from .interruption import SIGNALS
from .policy_vector import assign, flatten
from .profiling import as_background
from .torch_setup import configure_torch

CLOSE_SECONDS = 10.0
"""How long the process gets to close its environment before it is ended."""


class InBackground(Apart):
    """Collects the next round while this round's updates run, in a process with the environment.

    Round ``k`` acts with the policy that the updates of round ``k - 2`` left (the first two with
    the initial one), whether it was collected ahead or not. What a run learns therefore depends
    neither on timing nor on where it was checkpointed. The process gets the policy's parameters
    with every request and runs an :class:`InTurn`.

    Args:
        settings: Of the run.
        environment: Builds the training environment; ``cloudpickle`` must be able to send it.
        exploration: Makes the exploration module; the same holds for it.

    Raises:
        RuntimeError: If the process dies. What the environment raises is raised here.
        ValueError: If the environment is a robot: evaluations would drive it at the same time.
    """

    def __init__(
        self, settings: TrainerSettings, environment: EnvironmentFactory, exploration: Exploration
    ) -> None:
        context = get_context("spawn")  # a fork would inherit the threads' locks without threads
        self.requests = Requests()  # of this process's environments: evaluations
        self._connection, far_end = context.Pipe()
        heard, self._told = context.Pipe(duplex=False)
        recipe = cloudpickle.dumps((settings, environment, exploration))
        self._process = context.Process(
            target=_serve, args=(far_end, heard, recipe), name="rrl-collection"
        )
        self._process.start()
        far_end.close()
        heard.close()
        atexit.register(self.close)  # before multiprocessing's own, which would wait for it
        self._state_before: dict[str, Any] | None = None  # before the round that is collected ahead
        try:
            import_compiler()  # meanwhile the worker starts
            self.interface = self._receive()
        except BaseException:
            self.close()
            raise

    def pass_on(self, request: Request) -> None:
        """Tell the process, which may be collecting."""
        with contextlib.suppress(OSError):  # it has died, which the next call says
            self._told.send(request)

    def set_policy(self, policy: TensorDictModuleBase) -> None:
        """Act with copies of ``policy``, one round of updates late."""
        self._policy = policy
        self._acting: Tensor | None = None  # parameters of the policy that collects next
        self._call("set_policy", cloudpickle.dumps(policy))

    def collect(self, env_steps: int) -> tuple[TensorDictBase, Metrics]:
        """Wait for the round that is collected ahead, or collect now."""
        if not self.is_ahead:
            self._request(env_steps)
        self.is_ahead = False
        entries, metrics = self._receive()
        data = {key: torch.from_numpy(value) for key, value in entries}
        return TensorDict(data, next(iter(data.values())).shape[:2]), metrics

    def before_updates(self, next_round: int | None, checkpoint_due: bool) -> None:
        """Begin the next round with the policy as it is now."""
        self._acting = flatten(self._policy)
        if next_round is not None:
            self._state_before = self.state_dict() if checkpoint_due else None
            self._request(next_round)

    @property
    def can_continue(self) -> bool:
        """Whether the environment can go on in the middle of an episode."""
        return bool(self._call("can_continue"))

    def start_episode(self, seed: int) -> None:
        """Begin the next episode."""
        self._call("start_episode", seed)

    def state_dict(self) -> dict[str, Any]:
        """Return the process's state, before a round that is ahead, and the acting parameters."""
        if self.is_ahead and self._state_before is not None:
            return self._state_before
        acting = flatten(self._policy) if self._acting is None else self._acting
        return {"acting": acting, **_unpack(self._call("state"))}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore :meth:`state_dict`."""
        self._acting = state["acting"]
        self._call("restore", _pack({k: v for k, v in state.items() if k != "acting"}))

    def close(self) -> None:
        """Have the process close its environment, and end it if it does not."""
        if self._connection.closed:
            return
        atexit.unregister(self.close)
        self.tell(Request.GO_ON)  # or it would wait for ever
        self._connection.close()  # it reads the end of the requests
        self._process.join(CLOSE_SECONDS)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._process.close()

    def _request(self, env_steps: int) -> None:
        parameters = flatten(self._policy) if self._acting is None else self._acting
        self._send("collect", env_steps, parameters.numpy())
        self.is_ahead = True

    def _call(self, method: str, *arguments: Any) -> Any:
        if self.is_ahead:
            raise RuntimeError(f"{method}: expected no collection under way, got one")
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
        raise unpacked(result, "the collecting process")

    def _death(self) -> RuntimeError:
        self._process.join(CLOSE_SECONDS)
        return RuntimeError(
            f"the collecting process died with exit status {self._process.exitcode}; everything "
            "before is on disk: the newest checkpoint and all transitions that were stored"
        )


class _Worker:
    """The far end: an :class:`InTurn` with a policy of its own."""

    def __init__(self, recipe: bytes) -> None:
        settings, environment, exploration = cloudpickle.loads(recipe)
        configure_torch(settings, collects_only=True)
        self.collection = InTurn(settings, environment, exploration)
        if stop_of(self.collection.env) is not None:
            self.collection.close()
            raise ValueError(
                "trainer.collection: expected turn or realtime for a robot (an environment with a "
                "method stop), got overlap; an evaluation would drive it beside the second process"
            )
        self.rng = Generators()

    def set_policy(self, policy: bytes) -> None:
        self.policy = cloudpickle.loads(policy)
        self.collection.set_policy(self.policy)

    def collect(self, env_steps: int, parameters: Any) -> tuple[list[tuple[Any, Any]], Metrics]:
        assign(self.policy, torch.from_numpy(parameters))
        start = time.perf_counter()
        data, metrics = self.collection.collect(env_steps)
        if self.collection.settings.profile:
            metrics = as_background(metrics, time.perf_counter() - start)
        return [(key, value.numpy()) for key, value in data.items(True, True)], metrics

    def can_continue(self) -> bool:
        return self.collection.can_continue

    def start_episode(self, seed: int) -> None:
        self.collection.start_episode(seed)

    def state(self) -> bytes:
        return _pack({"rng": self.rng.state_dict(), **self.collection.state_dict()})

    def restore(self, packed: bytes) -> None:
        state = _unpack(packed)
        self.collection.load_state_dict(state)
        self.rng.load_state_dict(state["rng"])


def _serve(connection: Connection, told: Connection, recipe: bytes) -> None:
    """Answer requests until there are no more."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)  # they stop the run; the run ends this process
    threading.Thread(target=_end_with_parent, daemon=True).start()
    warnings.simplefilter("ignore")  # the run itself has said them
    worker: _Worker | None = None

    def answer(make: Callable[[], Any]) -> bool:
        try:
            connection.send((True, make()))
        except Exception as error:
            connection.send((False, packed(error)))
            return False
        return True

    def start() -> Any:
        nonlocal worker
        worker = _Worker(recipe)
        threading.Thread(target=_listen, args=(told, worker.collection), daemon=True).start()
        return worker.collection.interface

    try:
        if answer(start):
            while True:
                method, arguments = connection.recv()
                answer(lambda m=method, a=arguments: getattr(worker, m)(*a))  # type: ignore[misc]
    except (EOFError, OSError):
        pass
    finally:
        if worker is not None:
            worker.collection.close()


def _listen(told: Connection, collection: Collection) -> None:
    """Pass on what a person asks for, also in the middle of a collection."""
    with contextlib.suppress(EOFError, OSError):
        while True:
            collection.tell(told.recv())


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _pack(state: Any) -> bytes:
    buffer = io.BytesIO()
    torch.save(to_plain(state), buffer)
    return buffer.getvalue()


def _unpack(packed: bytes) -> Any:
    return from_plain(torch.load(io.BytesIO(packed), map_location="cpu", weights_only=True))
