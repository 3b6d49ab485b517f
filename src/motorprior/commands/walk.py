"""Train walking policies into folders, on motors sampled for every episode."""

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
from motorprior.simulation.training import SEED_FOLDER, WalkSettings, train_policy

PICTURE = "seeds.png"


@dataclass(frozen=True, kw_only=True)
class Walk(WalkSettings):
    """Train a walking policy."""

    out: Path
    """Folder for policy.safetensors, curve.json, metrics.jsonl and the checkpoint."""
    motors: str
    """Motors that are sampled for every episode: prior:FILE, posterior:FILE,prior=FILE, pd,
    pd:kp=8.8,kd=0.84, fleet or fleet:NAME. docs/training.md describes their options."""
    start: Path | None = None
    """Initial policy, from another folder; the untrained gait if not given. The training can have
    other motors than the initial policy's training, but commands must be in its range of speeds."""
    workers: int = min(2, os.cpu_count() or 1)
    """Number of episodes at a time; at most the number of cores, except on a Ray cluster. The
    result does not depend on it."""
    executor: ExecutorName = "threads"
    """Episodes run in threads of this process, or in Ray processes; the result does not depend on
    it."""
    ray_address: str | None = None
    """Address of a running Ray cluster, for the executor ray; if not given, Ray starts on this
    machine."""
    robot: str = DEFAULT_ROBOT
    """Robot: name of a shipped robot, or the .toml file of your robot (docs/your-robot.md)."""
    seeds: int = 1
    """Number of trainings, with the seeds search.seed, search.seed + 1, …. With several, each has a
    folder seed_K, and a picture shows all learning curves."""


def run_walk(config: Walk, progress: Progress = SILENT, name: str = "walk") -> Policy:
    """Train or resume one seed, unless the folder is finished with these settings.

    A training with other settings is replaced. Errors as `train_policy`.
    """
    values = {field.name: getattr(config, field.name) for field in fields(WalkSettings)}
    settings = WalkSettings(**values)
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
    """Train with several seeds, each in the folder seed_K of ``config.out``.

    The first seed is the search's. The executor "threads" trains several seeds at a time. The
    picture has the learning curves. Returns the mean return [m] of each best policy in its training
    simulation, or on the validation fleet if there is one.
    """
    # here, since they import matplotlib
    from motorprior.report.plots import learning_curves, read_curves
    from motorprior.report.plots_style import png_bytes

    require_count("seeds", config.seeds)
    require_count("workers", config.workers)
    threads = 1
    if config.executor == "threads":
        threads = min(config.seeds, usable_threads(config.workers, progress))
    workers = max(1, config.workers // threads)

    first = config.search.seed
    folders: dict[int, Path] = {}
    trainings = []
    for seed in range(first, first + config.seeds):
        folders[seed] = config.out / SEED_FOLDER.format(seed)
        search = replace(config.search, seed=seed)
        walk = replace(config, out=folders[seed], search=search, workers=workers)
        trainings.append(partial(run_walk, walk, name=f"walk, seed {seed}"))
    policies = in_parallel(trainings, threads, progress)

    curves = read_curves(folders.values())
    with atomic_path(config.out / PICTURE) as temporary:
        temporary.write_bytes(png_bytes(learning_curves({config.out.name: curves})))

    rows = []
    for seed, policy in zip(folders, policies, strict=True):
        best_return = float(policy.provenance["best_return"])
        rows.append(Result("best_return", "m", best_return, seed=seed))
    results = Results(rows)
    write_results(config.out, results)
    return results
