"""A temporary folder whose name is too long for a socket's path."""

import os
import subprocess
import sys

import pytest

PROGRAM = """
from rrl.controllers import ZeroController
from rrl.trainers import EnvironmentFactory
from situation_envs import Machine


class Remembering(Machine):
    # Its state is a tensor, which a worker hands over through a socket.

    def state_dict(self, *args, **kwargs):
        return {"count": self._count}

if __name__ == "__main__":
    made = EnvironmentFactory(Remembering, ZeroController, ["position"], batching="parallel")
    env = made.make(2)
    print(tuple(env.rollout(4).batch_size), len(env.base_env.state_dict()))
    env.close(raise_if_closed=False)
"""


@pytest.mark.slow
@pytest.mark.parametrize("length", [1, 150])
def test_workers_start_below_any(tmp_path, length):
    folder = tmp_path / ("t" * length)
    folder.mkdir()
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    search = os.pathsep.join(sys.path)
    done = subprocess.run(
        [sys.executable, str(program)],
        env={**os.environ, "TMPDIR": str(folder), "PYTHONPATH": search},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert "(2, 4)" in done.stdout
