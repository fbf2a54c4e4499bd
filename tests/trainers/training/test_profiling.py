"""The profile names every part of a step, and the parts make up the whole."""

import pytest

from rrl.trainers.loggers import read_metrics


def test_a_profile_names_physics_transforms_policy_sampling_and_update(make_trainer):
    with make_trainer(profile=True) as trainer:
        trainer.run()
    rows = trainer.profile.rows()
    names = {name.strip() for name, _ in rows}
    assert {
        "collect",
        "environment",
        "ResidualAction",
        "policy",
        "exploration",
        "store",
        "sample",
        "update",
    } <= names
    assert trainer.profile.env_steps == 120  # rounds of 20 steps, the first updates at step 100
    start = next(i for i, (name, _) in enumerate(rows) if name == "collect")
    parts = [value for name, value in rows[start + 1 :] if name.startswith("  ")]
    assert abs(sum(parts) - rows[start][1]) < 1e-9
    assert all(value >= 0 for value in parts)
    assert "time/collect/environment" in read_metrics(trainer.run_dir)


@pytest.mark.slow
def test_what_a_second_process_does_stands_below_the_sum(make_trainer, simulated):
    with make_trainer(profile=True, collection="overlap", environment=simulated) as trainer:
        trainer.run()
    rows = trainer.profile.rows()
    names = [name for name, _ in rows]
    start = names.index("background")
    assert {"  environment", "  policy", "  the rest"} <= set(names[start:])
    assert all(value >= 0 for _, value in rows)
    assert abs(sum(value for _, value in rows[start + 1 :]) - rows[start][1]) < 1e-9
    first = trainer.profile.table().columns[0]._cells
    assert first.index("sum") == first.index("background") - 1


@pytest.mark.slow
def test_without_it_the_parts_of_a_collection_are_not_timed(make_trainer):
    with make_trainer() as trainer:
        trainer.run()
    assert not any(name.startswith(" ") for name, _ in trainer.profile.rows())
