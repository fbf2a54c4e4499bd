"""What `rrl train` leaves behind, and in which order."""

import json

from rrl.trainers.cli import train
from rrl.trainers.cli.main import main
from situation_commands import SMALL


def test_a_run_is_finished_once_its_report_is_there(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_dir, write_report = tmp_path / "run", train.write_report
    results, report = run_dir / "results.json", run_dir / "report.html"

    def full_disk(runs, out):
        raise OSError("no space left")

    def before_the_results(runs, out):
        assert not results.exists()
        return write_report(runs, out)

    monkeypatch.setattr(train, "write_report", full_disk)
    assert main(["train", *SMALL, "hydra.run.dir=run"]) == 2
    assert not results.exists()
    monkeypatch.setattr(train, "write_report", before_the_results)
    assert main(["train", "resume=run"]) == 0
    assert json.loads(results.read_text())
    assert "has no final evaluation yet" not in report.read_text()
