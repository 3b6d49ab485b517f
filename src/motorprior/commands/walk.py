"""Train a walking policy into a folder, on motors drawn for every episode."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from motorprior.artifacts import write_json
from motorprior.bench.fleet import fleet_files
from motorprior.exceptions import ConfigError
from motorprior.locomotion.executor import Kind, require_executor
from motorprior.locomotion.policy import Policy
from motorprior.progress import SILENT, Progress
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.motors import motors_as_json
from motorprior.simulation.training import CHECKPOINT, Training, TrainingFiles, WalkSettings
from motorprior.stage import description, digest, is_finished, working

POLICY, CURVE = "policy.safetensors", "curve.json"
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
    """Train or resume, unless the folder is finished with these settings. A training with other settings is replaced.

    Returns:
        Whether it trained.

    Raises:
        ConfigError, ArtifactError: settings out of range, or a file or folder that cannot be used.
        SimulationFault: every episode had one.
        KeyboardInterrupt: after a checkpoint of the complete iterations.
    """
    if config.start is not None and config.start.resolve() == (config.out / POLICY).resolve():
        raise ConfigError(
            f"start is {POLICY} of the folder out itself, which the training would overwrite", where=config.start,
            remedy="give another folder as out", argument="out",
        )  # fmt: skip
    robot, start = load_robot(config.robot), None if config.start is None else Policy.load(config.start)
    settings = WalkSettings(**{each.name: getattr(config, each.name) for each in fields(WalkSettings)})
    training = Training(robot, config.motors, settings, start, config.start or "start")
    inputs = [*training.motors.files, *robot.files, *([] if config.start is None else [config.start])]
    if config.validation is not None:
        inputs += fleet_files(robot, config.validation)
    wanted = description(
        "walk", {name: value for name, value in asdict(config).items() if name not in _WITHOUT_EFFECT}, inputs
    )
    if is_finished(config.out, wanted):
        return False
    require_executor(config.executor, config.ray_address)
    files = TrainingFiles(config.out, wanted)
    training.note(progress)
    with working(config.out, wanted):
        training.run(config.workers, progress, name, config.executor, config.ray_address, files)
        training.policy(
            motors=motors_as_json(config.motors, config.out),
            start_sha256=None if config.start is None else digest(config.start),
        ).save(config.out / POLICY)  # fmt: skip
        write_json(config.out / CURVE, training.curve)
    (config.out / CHECKPOINT).unlink(missing_ok=True)  # after the marker: a run killed before resumes from it
    return True
