"""What the terminal says of a run under way."""

import io

from rrl.trainers.console import Output
from rrl.trainers.launch.display import Display, latest
from rrl.trainers.launch.job import Job
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


def test_a_damaged_row_is_passed_over(tmp_path):
    write(tmp_path, [(100, {"eval/misaligned/success": 0.5})])
    with (tmp_path / "metrics.csv").open("a") as file:
        file.write("200,eval/misaligned/success,0.7x\n")
    assert latest(tmp_path) == (100, 0.5)


def test_a_run_that_was_never_started_has_not_failed(tmp_path):
    jobs = [Job(tmp_path / name, {"trainer": {"total_steps": 100}}) for name in ("first", "second")]
    file = io.StringIO()
    display = Display(Output(file=file))
    with display.showing(jobs, done=[], slots=1):
        display.started(jobs[0])
        for job in jobs:
            display.ended(job, done=False)
    failed, blocked = file.getvalue().splitlines()[-2:]
    assert failed.startswith("FAILED ") and "first" in failed
    assert blocked.startswith("NOT STARTED ") and "second" in blocked
