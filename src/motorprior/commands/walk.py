"""Train walking policies into folders, on motors sampled for every episode: with one seed or several."""

import os
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path

from motorprior.artifacts import atomic_path
from motorprior.bounds import require_count
from motorprior.locomotion.executor import ExecutorName
from motorprior.locomotion.policy import Policy
from motorprior.progress import SILENT, Progress, in_parallel, usable_threads
from motorprior.results import Result, Results, write_results
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.training import WalkSettings, train_policy

PICTURE = "seeds.png"
SEED_FOLDER = "seed_{}"


@dataclass(frozen=True, kw_only=True)
class Walk(WalkSettings):
    """Train a walking policy."""

    out: Path
    """Folder for policy.safetensors, curve.json, metrics.jsonl and the checkpoint."""
    motors: str
    """The motors of every episode: prior:FILE, posterior:FILE,prior=FILE, pd, pd:kp=8.8,kd=0.84, fleet or fleet:NAME.
    docs/training.md has their options."""
    start: Path | None = None
    """A policy in another folder to continue from, with other motors for example, within its range of speeds; the plain
    gait if not given."""
    workers: int = min(2, os.cpu_count() or 1)
    """Episodes at a time, at most the number of cores, except on a Ray cluster. The result does not depend on it."""
    executor: ExecutorName = "threads"
    """Threads of this process, or Ray processes; the result does not depend on it."""
    ray_address: str | None = None
    """A running Ray cluster for the executor ray; Ray starts on this machine if not given."""
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md)."""
    seeds: int = 1
    """Number of trainings, with seeds from search.seed on, each in its own folder seed_K, and a picture of all."""


def run_walk(config: Walk, progress: Progress = SILENT, name: str = "walk") -> Policy:
    """Train or resume one seed, unless the folder is finished with these settings; errors as `train_policy`.

    A training with other settings is replaced.
    """
    settings = WalkSettings(
        **{each.name: getattr(config, each.name) for each in fields(WalkSettings)}
    )
    return train_policy(
        config.robot,
        config.motors,
        settings,
        start=config.start,
        out=config.out,
        workers=config.workers,
        executor=config.executor,
        ray_address=config.ray_address,
        name=name,
        progress=progress,
    )


def run_walk_seeds(config: Walk, progress: Progress = SILENT) -> Results:
    """Train with ``config.seeds`` seeds, from that of the search on, each in the folder seed_K of ``config.out``.

    The executor "threads" trains several seeds at a time. The picture has the learning curves.
    Returns the mean return [m] of each best policy in its training simulation, or on the validation
    fleet if there is one.
    """
    from motorprior.report.plots import learning_curves, read_curves
    from motorprior.report.plots_style import png_bytes  # here, since they import matplotlib

    require_count("seeds", config.seeds)
    require_count("workers", config.workers)
    threads = (
        min(config.seeds, usable_threads(config.workers, progress))
        if config.executor == "threads"
        else 1
    )
    first = config.search.seed
    workers = max(1, config.workers // threads)
    folders = {
        seed: config.out / SEED_FOLDER.format(seed) for seed in range(first, first + config.seeds)
    }
    walks = [
        replace(config, out=out, search=replace(config.search, seed=seed), workers=workers)
        for seed, out in folders.items()
    ]
    works = [partial(run_walk, walk, name=f"walk, seed {walk.search.seed}") for walk in walks]
    found = in_parallel(works, threads, progress)
    with atomic_path(config.out / PICTURE) as temporary:
        temporary.write_bytes(
            png_bytes(learning_curves({config.out.name: read_curves(folders.values())}))
        )
    best = {
        seed: float(policy.provenance["best_return"])
        for seed, policy in zip(folders, found, strict=True)
    }
    results = Results(Result("best_return", "m", value, seed=seed) for seed, value in best.items())
    write_results(config.out, results)
    return results
