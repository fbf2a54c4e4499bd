"""Episodes that are learned from, followed, tested on and counted at the end are never the same ones."""

import random
from itertools import pairwise

import pytest

from rrl.trainers import seeds
from rrl.trainers.seeds import MAX_SEED, Stream, first_seed
from rrl.trainers.settings import AcceptanceSettings, EvaluationSettings, TrainerSettings

MOST = MAX_SEED
"""Episodes that a stream plays, at most."""


def band(stream):
    """All seeds that a stream may give: the first of them, and the one behind the last."""
    return stream * 2**29, (stream + 1) * 2**29


def test_bands_follow_one_another_and_fit_in_an_int32():
    bands = [band(stream) for stream in Stream]
    assert all(end <= start for (_, end), (start, _) in pairwise(bands))
    assert bands[0][0] == 0
    assert bands[-1][1] <= 2**31


@pytest.mark.parametrize("stream", Stream)
@pytest.mark.parametrize("digest", [bytes(8), b"\xff" * 8, bytes(range(8))])
def test_whatever_a_seed_is_hashed_to_it_stays_in_its_stream(stream, digest, monkeypatch):
    class Hash:
        def digest(self):
            return digest

    monkeypatch.setattr(seeds.hashlib, "blake2b", lambda *_, **__: Hash())
    start, end = band(stream)
    assert start <= first_seed(stream, 0)
    assert first_seed(stream, 0) + MOST - 1 < end


@pytest.mark.parametrize("stream", Stream)
def test_every_seed_s_episodes_stay_in_their_stream(stream):
    draw = random.Random(0)
    named = [0, 1, MAX_SEED - 1, *(draw.randrange(MAX_SEED) for _ in range(2000))]
    start, end = band(stream)
    for seed in named:
        for after in (0, 1, draw.randrange(10**9), 2**63):
            first = first_seed(stream, seed, after)
            assert start <= first
            assert first + MOST - 1 < end


def test_a_run_that_begins_anew_in_its_middle_gets_other_episodes():
    firsts = [first_seed(Stream.TRAINING, 3, after) for after in (0, 1, 1000, 1001)]
    assert len(set(firsts)) == 4
    assert firsts == [first_seed(Stream.TRAINING, 3, after) for after in (0, 1, 1000, 1001)]


@pytest.mark.parametrize("seed", [-1, MAX_SEED])
def test_a_seed_out_of_range_is_refused(seed):
    with pytest.raises(ValueError, match=f"seed: expected 0 to {MAX_SEED - 1}, got {seed}"):
        first_seed(Stream.TRAINING, seed)
    for settings in (TrainerSettings, EvaluationSettings):
        with pytest.raises(ValueError, match="seed"):
            settings(seed=seed)


@pytest.mark.parametrize(
    ("settings", "name"),
    [
        (EvaluationSettings, "episodes"),
        (EvaluationSettings, "final_episodes"),
        (AcceptanceSettings, "episodes"),
    ],
)
def test_no_more_episodes_than_a_stream_has_are_allowed(settings, name):
    assert getattr(settings(**{name: MOST}), name) == MOST
    with pytest.raises(ValueError, match=name):
        settings(**{name: MOST + 1})
