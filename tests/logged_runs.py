"""Small runs as they lie on the disk, for the tests of reports."""

import numpy as np
import yaml

from rrl.trainers.evaluation.episodes import Comparison, Episodes, write_results
from rrl.trainers.loggers import CSVLogger
from rrl.trainers.storage.versions import write_versions

EPISODES = 20
FORCE = {"unit": "N", "reduce": "max"}
STEPS = range(0, 1001, 50)


def episodes(solved, force):
    metrics = {"contact_force": np.full(EPISODES, force), "tilt": np.full(EPISODES, 0.1)}
    success = np.arange(EPISODES) < solved
    return Episodes(
        success - 5.0, np.full(EPISODES, 50), success, np.zeros(EPISODES, dtype=bool), metrics
    )


def make_run(
    folder, arm="residual", seed=0, finished=True, compared=Comparison, budget=None, **changes
):
    folder.mkdir(parents=True)
    env = {"name": "insertion", "scenarios": {"misaligned": {}, "aligned": {}}}
    config = {
        "name": f"insertion-{arm}",
        "arm": arm,
        "env": {**env, "metrics": {"contact_force": {**FORCE, "budget": budget}}},
        "controller": {"_target_": "rrl.controllers.ZeroController"},
        "disturbance": {"control_noise": None},
        "algorithm": {"agent": {"_target_": "rrl.algorithms.TD3", "tau": 0.01} | changes},
        "trainer": {"seed": seed, "total_steps": 1000, "evaluation": {"episodes": EPISODES}},
    }
    (folder / "config.yaml").write_text(yaml.safe_dump(config, sort_keys=False))
    logger = CSVLogger()
    logger.start(folder, config, 0)
    for step in STEPS:
        comparison = compared(episodes(step // 60 + seed, 30.0 + seed), episodes(4, 20.0))
        logger.log({f"eval/misaligned/{k}": v for k, v in comparison.summary().items()}, step)
        logger.log({"loss/loss_critic": 1.0 / (1 + step), "safety/step": 0.1}, step)
        logger.log({"action/residual_share": 0.4}, step)
        seconds = {"collect": 1.0, "collect/physics": 0.5, "update": 2.0, "sample": 0.3}
        logger.log({f"time/{part}": value for part, value in seconds.items()}, step)
    logger.finish()
    if finished:
        write_results({"misaligned": comparison, "aligned": comparison}, folder / "results.json")
        write_versions(folder)
    return folder


def edit(run, **sections):
    """Change keys of a run's configuration, section by section."""
    config = yaml.safe_load((run / "config.yaml").read_text())
    merged = {name: {**config.get(name, {}), **keys} for name, keys in sections.items()}
    (run / "config.yaml").write_text(yaml.safe_dump({**config, **merged}, sort_keys=False))


def make_group(folder, **arguments):
    return [make_run(folder / f"seed-{seed}", seed=seed, **arguments) for seed in (0, 1, 2)]
