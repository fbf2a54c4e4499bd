"""A run with an operator: what it stores, learns from, resumes and evaluates."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import pytest
import torch

from rrl.controllers import ProportionalController
from rrl.interventions import ScriptedOperator
from rrl.transforms import Intervention
from runs import assert_same_run, run, run_until


def operator(**arguments) -> ScriptedOperator:
    controller = ProportionalController(gain=2.0, clip=1.0, unit=0.1)
    return ScriptedOperator(controller, share=0.5, steps=9, noise=0.2, **arguments)


@pytest.fixture
def operated(simulated):
    """The drifting point, with somebody who takes over half of the episodes for some steps."""
    return replace(simulated, intervention=partial(Intervention, operator, step_limit=0.3))


@pytest.mark.parametrize("n_step", [1, 3])
def test_what_is_stored_was_executed_and_a_share_is_drawn(make_trainer, operated, n_step):
    trainer = make_trainer(environment=operated, intervention_share=0.25, n_step=n_step)
    run(trainer)
    stored = trainer.store.replay[:]
    taken = stored["intervened"].squeeze(-1)
    assert 20 < taken.sum() < 120
    assert (stored["exceeds_authority"].squeeze(-1) <= taken).all()
    assert (stored["action"].abs() <= 1).all()
    assert "intervened" not in trainer.store.sample(1)
    torch.manual_seed(0)
    drawn = trainer.replay.sample(32 * 100)["intervened"].reshape(100, 32)
    assert (drawn.sum(-1) >= 8).all()
    metrics = (trainer.run_dir / "metrics.csv").read_text()
    assert "intervention/steps" in metrics and "intervention/exceeds" in metrics


def test_what_the_policy_said_is_measured_whatever_was_executed(make_trainer, operated):
    """Before it has learned it says nothing, and an operator acts."""
    changes = {"total_steps": 80, "warmup_steps": 60, "controller_steps": 60}
    trainer = run(make_trainer(environment=operated, **changes))
    assert trainer.store.replay[:]["action"].abs().max() > 0.1
    rows = [row.split(",") for row in (trainer.run_dir / "metrics.csv").read_text().splitlines()]
    said = [float(value) for _, name, value in rows if name == "action/residual_rms"]
    assert said and max(said[:3]) < 0.01


@pytest.mark.parametrize("collection", ["turn", pytest.param("overlap", marks=pytest.mark.slow)])
def test_a_run_that_dies_is_the_run_that_never_died(make_trainer, operated, collection):
    changes = {
        "steps_per_collection": 10,
        "buffer_capacity": 60,
        "intervention_share": 0.3,
        "collection": collection,
    }
    make = partial(make_trainer, environment=operated, **changes)
    whole = run(make("whole"))
    for place, env_steps in (("store.extend", 110), ("agent.update", 160)):
        broken = make("broken")
        if env_steps > 110:
            broken.resume()
        run_until(broken, place, env_steps)
    broken = make("broken")
    broken.resume()
    assert_same_run(whole, run(broken))


def test_evaluations_have_no_operator(make_trainer, operated, simulated):
    alone = make_trainer("alone", environment=simulated, total_steps=0)
    with_operator = make_trainer("operated", environment=operated, total_steps=0)
    results = [trainer.run()["drift"] for trainer in (alone, with_operator)]
    assert (results[0].residual.returns == results[1].residual.returns).all()
    alone.close()
    with_operator.close()


def test_a_share_without_an_operator_is_refused(make_trainer, simulated):
    with pytest.raises(ValueError, match=r"expected 0 without an operator, got 0\.2"):
        make_trainer(environment=simulated, intervention_share=0.2)
