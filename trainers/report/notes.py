"""What has to be said beside the tables of final evaluations."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from rrl.keys import METRICS

from ..metric_names import ACCEPTED, CONTROLLER, FAULTS
from .panels import Declared
from .runs import Record

Results = Mapping[str, Sequence[Record]]
"""Scenario to the records of the runs that are shown as one."""

NOTE = (
    "Brackets hold 95 % intervals. Controller, and residual of one run: Wilson's, over its "
    "episodes; the controller's return: Student's t over them. Residual of several runs: the "
    "success rate of runs and episodes like these, beta-binomial, or Student's t of the return. "
    "Gain: paired on the same frozen episodes. Rescued and broken: episodes that only the residual "
    "or only the controller solves, mean of the runs. No interval: returns of a single run, or "
    "returns that are all alike."
)
UNPAIRED = (
    "The episodes of {} are not frozen: played twice they came out differently. Controller and "
    "residual are independent samples there; the gain has the interval of these, and no episode is "
    "called rescued or broken."
)

FAULTY = (
    "Faults of the robot in the middle of an episode: {}. Such an episode is played again, twice "
    "at most; one with a fault every time counts as failed, and its return is not a number."
)


def notes(results: Results, declared: Declared) -> list[str]:
    """Return how the tables are to be read, which budgets were kept, and what is handed over."""
    found = [NOTE]
    loose = [name for name, records in results.items() if not all(map(is_frozen, records))]
    if loose:
        found.append(UNPAIRED.format(", ".join(loose)))
    found += _faults(results)
    found += [text for name, how in declared.items() for text in _budget(results, name, how)]
    records = next(iter(results.values()), ())
    steps = [r["summary"].get(f"{ACCEPTED}env_steps") for r in records]
    tested = [int(step) for step in steps if step is not None]
    if tested:
        found.append(_what_is_handed_over(tested))
    return found


def _faults(results: Results) -> Iterator[str]:
    """Say how many faults of a robot the final episodes met, by policy, if they met any."""
    named = {"controller": CONTROLLER, "residual": "", "handed over": ACCEPTED}
    found = []
    for scenario, records in results.items():
        counts = {
            name: sum(int(record["summary"].get(prefix + FAULTS, 0)) for record in records)
            for name, prefix in named.items()
        }
        if any(counts.values()):
            found.append(f"{scenario} {', '.join(f'{n} {count}' for n, count in counts.items())}")
    if found:
        yield FAULTY.format("; ".join(found))


def _budget(results: Results, name: str, how: Mapping[str, Any]) -> Iterator[str]:
    """Say in which scenarios the mean over episodes keeps to a quantity's budget, if it has one.

    Of what is handed over too, where its mean is another one.
    """
    if (budget := how.get("budget")) is None:
        return

    def judged(records: Sequence[Record], prefix: str = "") -> str:
        key = f"{METRICS}/{name}"
        found = [r["summary"].get(prefix + key, r["summary"][key]) for r in records]
        mean = float(np.mean(found))
        return f"{mean:.4g}, {'kept' if mean <= budget else 'not kept'}"

    words = []
    for scenario, records in results.items():
        latest, accepted = judged(records), judged(records, ACCEPTED)
        words.append(f"{scenario} {latest}")
        words += [f"{scenario}, handed over, {accepted}"] if accepted != latest else []
    quantity = f"{name.replace('_', ' ')}, {budget:g} {how.get('unit', '')}".rstrip()
    yield f"Budget for the mean of {quantity}: {'; '.join(words)}."


def _what_is_handed_over(steps: Sequence[int]) -> str:
    """Say what the runs hand over; 0 steps stand for the controller."""
    learned, runs = [step for step in steps if step], len(steps)
    test = "passed the test that it is not worse than the controller."
    if len(learned) == runs == 1:
        return f"Handed over: the policy after {learned[0]} environment steps, which {test}"
    if runs == 1:
        return f"Handed over: the controller alone. No policy {test}"
    if len(learned) == runs:
        return f"Handed over: a learned policy by all {runs} runs, which {test}"
    return (
        f"Handed over: a learned policy by {len(learned)} of {runs} runs, the controller alone by "
        "the others, in which no policy passed the test against it."
    )


def is_frozen(record: Record) -> bool:
    """Return whether a scenario's episodes can be played again."""
    return bool(record["summary"].get("frozen", True))
