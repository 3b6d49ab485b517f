"""Train walking policies into folders, on motors drawn for every episode: with one seed or several."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path

from motorprior.artifacts import atomic_path, write_json
from motorprior.bench.fleet import fleet_files
from motorprior.bounds import require_count
from motorprior.exceptions import ConfigError
from motorprior.locomotion.executor import Kind, require_executor
from motorprior.locomotion.policy import Policy
from motorprior.progress import SILENT, Progress, in_parallel, usable_threads
from motorprior.results import Result, Results
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.motors import motors_as_json
from motorprior.simulation.training import CHECKPOINT, Training, TrainingFiles, WalkSettings
from motorprior.stage import description, digest, is_finished, working, write_results
from motorprior.studies.compare import POLICY

CURVE, PICTURE, SEED_FOLDER = "curve.json", "seeds.png", "seed_{}"
SEEDS_APART = 1000  # demos and studies with different seeds share no search seed
_WITHOUT_EFFECT = ("workers", "executor", "ray_address")  # on the result


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
    executor: Kind = "threads"
    """Threads of this process, or Ray processes; the result does not depend on it."""
    ray_address: str | None = None
    """A running Ray cluster for the executor ray; Ray starts on this machine if not given."""
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md)."""


def run_walk(config: Walk, progress: Progress = SILENT, name: str = "walk") -> bool:
    """Train or resume, unless the folder is finished with these settings; returns whether it trained.

    A training with other settings is replaced. Raises SimulationFault if every episode had one, KeyboardInterrupt after
    a checkpoint of the complete iterations.
    """
    if config.start is not None and config.start.resolve() == (config.out / POLICY).resolve():
        problem = f"start is {POLICY} of the folder out itself, which the training would overwrite"
        raise ConfigError(problem, where=config.start, remedy="give another folder as out", argument="out")
    robot, start = load_robot(config.robot), None if config.start is None else Policy.load(config.start)
    settings = WalkSettings(**{each.name: getattr(config, each.name) for each in fields(WalkSettings)})
    training = Training(robot, config.motors, settings, start, config.start or "start")
    inputs = [*training.motors.files, *robot.files, *([] if config.start is None else [config.start])]
    if config.validation is not None:
        inputs += fleet_files(robot, config.validation)
    described = {name: value for name, value in asdict(config).items() if name not in _WITHOUT_EFFECT}
    wanted = description("walk", described, inputs)
    if is_finished(config.out, wanted):
        return False
    require_executor(config.executor, config.ray_address)
    files = TrainingFiles(config.out, wanted)
    training.note(progress)
    with working(config.out, wanted):
        training.run(config.workers, progress, name, config.executor, config.ray_address, files)
        start_sha256 = None if config.start is None else digest(config.start)
        policy = training.policy(motors=motors_as_json(config.motors, config.out), start_sha256=start_sha256)
        policy.save(config.out / POLICY)
        write_json(config.out / CURVE, training.curve)
    (config.out / CHECKPOINT).unlink(missing_ok=True)  # after the marker: a run killed before resumes from it
    return True


def run_walk_seeds(config: Walk, seeds: int, progress: Progress = SILENT) -> Results:
    """Train with ``seeds`` seeds, from that of the search on, each in the folder seed_K of ``config.out``.

    The executor "threads" trains several seeds at a time. The picture has the learning curves. Returns the mean return
    [m] of each best policy in its training simulation, or on the validation fleet if there is one.
    """
    from motorprior.report.plots import learning_curves, read_curves
    from motorprior.report.plots_style import png_bytes  # here, since they import matplotlib

    require_count("seeds", seeds)
    require_count("workers", config.workers)
    threads = min(seeds, usable_threads(config.workers, progress)) if config.executor == "threads" else 1
    first, workers = config.search.seed, max(1, config.workers // threads)
    folders = {seed: config.out / SEED_FOLDER.format(seed) for seed in range(first, first + seeds)}
    walks = [
        replace(config, out=out, search=replace(config.search, seed=seed), workers=workers)
        for seed, out in folders.items()
    ]
    in_parallel([partial(_train, walk) for walk in walks], threads, progress)
    with atomic_path(config.out / PICTURE) as temporary:
        temporary.write_bytes(png_bytes(learning_curves({config.out.name: read_curves(folders.values())})))
    best = {seed: float(Policy.load(out / POLICY).provenance["own_return"]) for seed, out in folders.items()}
    results = Results.of(Result("own_return", "m", value, seed=seed) for seed, value in best.items())
    write_results(config.out, results)
    return results


def _train(walk: Walk, progress: Progress) -> None:
    if not run_walk(walk, progress, f"walk, seed {walk.search.seed}"):
        progress.note(f"{walk.out} is finished with these settings: nothing was trained")
