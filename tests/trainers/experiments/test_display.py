"""What the terminal says of a run under way."""

from rrl.trainers.launch.display import latest
from rrl.trainers.loggers import CSVLogger


def write(run_dir, rows):
    logger = CSVLogger()
    logger.start(run_dir, {}, 0)
    for steps, values in rows:
        logger.log(values, steps)
    logger.finish()


def test_success_is_that_of_the_followed_scenario_in_the_last_evaluation(tmp_path):
    first, second = "eval/misaligned/success", "eval/aligned/success"
    rows = [
        (100, {first: 0.1}),
        (200, {first: 0.5}),
        (200, {second: 1.0}),
        (250, {"x": 0.0}),
    ]
    write(tmp_path, rows)
    assert latest(tmp_path) == (250, 0.5)


def test_a_run_that_was_not_evaluated_has_no_success(tmp_path):
    write(tmp_path, [(100, {"loss/critic": 1.0})])
    assert latest(tmp_path) == (100, None)
    assert latest(tmp_path / "nowhere") == (0, None)
