"""What a repository keeps of runs: enough for figures, tables and claims, not the policies.

A run's directory without all that is large, 10 to 30 KB; `rrl report` reads it too::

    DATA/
        rotation-0.1-residual-rl-3f2a91c0/   as in the store; the key names the settings
            seed-0/
                config.yaml                  what was run
                metrics.csv                  success and return of the evaluations, wall time
                results.json                 the final evaluation
                versions.json                packages and machine
                positions.json               how widely it moved, where an experiment shows that
"""

from __future__ import annotations

import csv
import io
import json
import shutil
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import yaml

from ..launch.job import Job
from ..loggers import metrics
from ..metric_names import ACCEPTED, CONTROLLER
from ..report.runs import Run
from ..storage.files import write_atomically
from ..storage.run_files import CHECKPOINTS, CONFIG_FILE, METRICS, RESULTS, VERSIONS
from ..storage.transition_log import FOLDER as TRANSITIONS
from .plan import replaced
from .spec import Spread
from .spread import spatial_variance

ENTRIES = tuple(p + e for e in ("success", "return") for p in ("", CONTROLLER, ACCEPTED))


def keep(job: Job, data: Path, spreads: Sequence[Spread] = ()) -> None:
    """Write what is kept of a finished run below ``data``; what was taken from there stays."""
    run, folder = Run(job.path, job.name), _folder(job, data)
    if not _begun(job) and (folder / RESULTS).is_file():
        return  # the store has today's configuration of it, that folder what was run
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(folder / CONFIG_FILE, _config(job))
    for spread in spreads:
        write_atomically(folder / spread.file, _json(spatial_variance(run, spread).tolist()))
    write_atomically(folder / METRICS, _record(run))
    write_atomically(folder / VERSIONS, _json(run.versions))
    results = {name: _result(record) for name, record in run.results.items()}
    write_atomically(folder / RESULTS, _json(results))


def take(jobs: Sequence[Job], data: Path, spreads: Mapping[Path, Sequence[Spread]]) -> list[Job]:
    """Put kept runs into the store, in place of those that have not begun there.

    A run whose policy another one has yet to start from is not taken: it has to be trained. So has
    one of which not all is kept that is shown: by its path, what its variance is shown of.

    Returns:
        What was taken; these jobs are finished.
    """
    missing = [job for job in jobs if not job.finished]
    kept = [job for job in missing if not _begun(job) and _is_whole(job, data, spreads[job.path])]
    trained = _with_needs([job for job in missing if job not in kept], missing)
    taken = [job for job in kept if job not in trained]
    for job in taken:
        job.prepare()
        names = {path.name for path in _folder(job, data).iterdir()} - {CONFIG_FILE, RESULTS}
        for name in (*sorted(names), RESULTS):  # it marks a finished run
            shutil.copyfile(_folder(job, data) / name, job.path / name)
    return taken


def _is_whole(job: Job, data: Path, spreads: Sequence[Spread]) -> bool:
    files = [RESULTS, *(spread.file for spread in spreads)]
    return all((_folder(job, data) / name).is_file() for name in files)


def kept_runs(data: Path) -> int:
    """Return how many runs are kept below ``data``."""
    return len(list(data.glob(f"*/*/{RESULTS}")))


def train_again(jobs: Sequence[Job]) -> None:
    """Have runs made again that others have to start from, and of which there are numbers alone."""
    for job in _with_needs([job for job in jobs if not job.finished], jobs):
        if job.finished and not (job.path / CHECKPOINTS).is_dir():
            (job.path / RESULTS).unlink()


def _begun(job: Job) -> bool:
    """Return whether a run has collected anything in the store."""
    return any((job.path / name).exists() for name in (CHECKPOINTS, TRANSITIONS))


def _with_needs(wanted: Sequence[Job], among: Sequence[Job]) -> list[Job]:
    """Return the jobs that are wanted, and those among others that they start from, and so on."""
    found, left = [], list(wanted)
    while left:
        job = left.pop()
        found.append(job)
        left += [other for other in among if other.path in job.needs and other not in found]
    return found


def _folder(job: Job, data: Path) -> Path:
    """Return where a run is kept: whatever experiment and arm its point was named after there."""
    key = job.path.parent.name.rpartition("-")[2]
    present = sorted(data.glob(f"*-{key}"))
    return (present[0] if present else data / job.path.parent.name) / job.path.name


def _config(job: Job) -> str:
    """Return the configuration, with the runs that it starts from named as they are kept."""
    config = yaml.safe_load((job.path / CONFIG_FILE).read_text(encoding="utf-8"))
    names = {str(source): Path(source.parent.name, source.name) for source in job.needs}
    return yaml.safe_dump(replaced(config, names), sort_keys=False)


def _record(run: Run) -> str:
    """Return the metrics that figures show, and the sums of the wall time."""
    names = [metrics.name(metrics.EVALUATION, run.followed, entry) for entry in ENTRIES]
    rows = [(*point, name) for name in names for point in run.metrics.get(name, ())]
    for name in map(partial(metrics.name, metrics.TIME), metrics.WHOLE_SECTIONS):
        if points := run.metrics.get(name):
            rows.append((points[-1][0], sum(value for _, value in points), name))
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow([metrics.STEP_AXIS, "metric", "value"])
    writer.writerows([step, name, repr(value)] for step, value, name in rows)
    return file.getvalue()


def _result(record: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return a scenario's final evaluation with the episodes' success and return alone."""
    episodes = {key: record["episodes"][key] for key in ENTRIES if key in record["episodes"]}
    return {"summary": record["summary"], "episodes": episodes}


def _json(value: Any) -> str:
    return json.dumps(value) + "\n"
