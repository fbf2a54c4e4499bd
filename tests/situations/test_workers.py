"""One environment of a parallel batch raises, or its process dies, after a while."""

import re
from functools import partial

import pytest

from situation_envs import Failing

HOT = "the motor is too hot"
ENDINGS = {
    "raise": f"ValueError: {HOT}",
    "exit": f"SystemExit: {HOT}",
    "die": "it left no word, so it was killed or crashed (Cannot proceed, worker ",
}
AT = 35  # a step of a worker; by then 60 transitions of both are stored


def check(make_trainer, environment, marker, said):
    """The run ends with worker and reason, and goes on with all that it had stored."""
    marker.touch()
    with make_trainer(environment, num_envs=2, steps_per_collection=10) as trainer:
        with pytest.raises(RuntimeError, match=r"worker [01]\b") as ended:
            trainer.run()
        assert trainer.env_steps == 60
    message = str(ended.value)
    assert message.startswith("environment: ")
    assert said in message
    assert "the newest checkpoint and all transitions that were stored" in message
    assert not marker.exists()
    with make_trainer(environment, num_envs=2, steps_per_collection=10) as resumed:
        resumed.resume()
        assert (resumed.env_steps, resumed.store.pending) == (40, 20)
        resumed.run()
        assert resumed.store.log.count == 100


@pytest.mark.slow  # starting worker processes takes its time
@pytest.mark.parametrize("how", ENDINGS)
def test_a_worker_that_ends_is_named_with_its_reason(make_trainer, factory, tmp_path, how):
    base = partial(Failing, AT, how, tmp_path / "hot")
    check(make_trainer, factory(base, batching="parallel"), tmp_path / "hot", ENDINGS[how])


@pytest.mark.slow
@pytest.mark.parametrize("how", ENDINGS)
def test_so_it_is_where_a_second_process_collects(make_trainer, factory, tmp_path, how):
    base = partial(Failing, AT, how, tmp_path / "hot")
    make = partial(make_trainer, collection="overlap")
    check(make, factory(base, batching="parallel"), tmp_path / "hot", ENDINGS[how])


class Unplugged(Failing):
    """Raises in a reset, and in no step."""

    def _step(self, tensordict):
        marker, self._marker = self._marker, None
        out = super()._step(tensordict)
        self._marker = marker
        return out

    def _reset(self, tensordict=None, **kwargs):
        if self._steps >= self._at and self._first():
            raise ConnectionError("no robot answers")
        return super()._reset(tensordict, **kwargs)


@pytest.mark.slow
def test_a_reset_that_fails_is_named_too(make_trainer, factory, tmp_path):
    base = partial(Unplugged, 32, "raise", tmp_path / "hot")
    environment = factory(base, batching="parallel")
    said = "ConnectionError: no robot answers"
    check(make_trainer, environment, tmp_path / "hot", said)


def test_one_alone_says_what_it_raised(make_trainer, factory, tmp_path):
    (tmp_path / "hot").touch()
    environment = factory(partial(Failing, AT, "raise", tmp_path / "hot"))
    with make_trainer(environment) as trainer, pytest.raises(ValueError, match=re.escape(HOT)):
        trainer.run()
    assert trainer.store.log.count == 20
