"""``python -m rrl.envs.plant``: the insertion task as a robot of its own."""

from __future__ import annotations

import argparse
import gc
import signal
from collections.abc import Sequence
from typing import Any

import yaml

from rrl.pace import prioritize

from ..insertion.config import PRESETS, make_config
from .faults import Faults
from .protocol import ADDRESS
from .server import serve
from .simulated import SimulatedPlant


def main(arguments: Sequence[str] | None = None) -> None:
    """Simulate until SIGINT or SIGTERM."""
    parser = argparse.ArgumentParser(prog="python -m rrl.envs.plant", description=__doc__)
    parser.add_argument("--address", default=ADDRESS, help="where it listens (%(default)s)")
    parser.add_argument("--variant", default="real", choices=sorted(PRESETS))
    parser.add_argument(
        "--timeout", type=float, default=0.2, help="seconds until it stops without a command"
    )
    parser.add_argument(
        "--priority", type=int, default=20, help="real-time priority, 0 for none (%(default)s)"
    )
    parser.add_argument(
        "overrides", nargs="*", metavar="name=value", help="of rrl.envs.InsertionConfig"
    )
    chosen = parser.parse_args(arguments)
    ended = False

    def end(*_: object) -> None:
        nonlocal ended
        ended = True

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, end)
    pairs = (text.partition("=") for text in chosen.overrides)
    try:
        overrides: dict[str, Any] = {name: yaml.safe_load(value) for name, _, value in pairs}
        plant = SimulatedPlant(make_config(chosen.variant, overrides), chosen.timeout)
    except (ValueError, yaml.YAMLError) as error:
        parser.error(str(error))
    period = plant.description.period
    print(f"the plant listens at {chosen.address}, {1 / period:g} commands a second", flush=True)
    gc.freeze()  # what lives anyway is not looked through while the arm moves
    prioritize(chosen.priority)
    try:
        serve(plant, chosen.address, tick=plant.advance, running=lambda: not ended, faults=Faults())
    except OSError as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
