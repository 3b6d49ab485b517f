"""Motor logs in, motor prior out."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import read_tensors, write_tensors
from motorprior.bench.facts import FACTS, LOG, read_bench
from motorprior.bounds import require_count, require_seed
from motorprior.exceptions import ArtifactError
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.parquet_io import read_log
from motorprior.pipeline.progress import SILENT, Progress, Task
from motorprior.pipeline.stage import Stopwatch, description, is_finished, remove, working

if TYPE_CHECKING:  # they import JAX
    from motorprior.identification.presets import Preset
    from motorprior.identification.windows import TrainingData

PRIOR, CHECKPOINT = "prior.safetensors", "checkpoint.safetensors"


@dataclass(frozen=True)
class Identify:
    """Learn a motor prior from the log of a bench or of a hung robot."""

    bench: Path
    """Folder that `motorprior bench` wrote, or a motor log (.parquet) whose loads are known, as that of a robot
    that hung."""
    out: Path
    """Folder for prior.safetensors."""
    preset: str = "rollout"
    """Recipe: rollout (closed loop, grey box), paper (torque regression), or one of the baselines one_motor, per_motor,
    latent_network, one_network, actuator_net, paper_wide."""
    seed: int = 0
    """Seed of weights, windows and noise."""
    steps: int | None = None
    """Adam steps; the preset's own number if not given."""
    torque: bool = True
    """Use the log's joint_torque; without it the prior learns from positions and velocities alone."""


def run_identify(config: Identify, progress: Progress = SILENT) -> None:
    """Train, unless the folder holds this very prior already.

    Raises:
        LogError, ConfigError: the log does not fit the recipe.
    """
    if config.steps is not None:
        require_count("steps", config.steps)
    require_seed(config.seed)
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    from motorprior.identification.presets import identification_preset
    from motorprior.identification.standardise import MOTORS_TO_TRUST
    from motorprior.identification.windows import training_data

    preset = identification_preset(config.preset)
    if config.steps is not None:
        preset = replace(preset, steps=config.steps)
    log, inputs, origin = _training_log(config.bench)
    wanted = description("identify", asdict(config), inputs, recipe=asdict(preset))
    if is_finished(config.out, wanted):
        return
    data = training_data(log if config.torque else replace(log, joint_torque=None), preset, str(inputs[0]))
    if preset.num_latents and log.num_joints < MOTORS_TO_TRUST:
        progress.note(
            f"note: {log.num_joints} motors say little about a distribution: the prior reproduces these motors, but "
            f"its draws are a guess (record {MOTORS_TO_TRUST} or more)"
        )
    with working(config.out, wanted) as clock:
        title = f"identify {config.preset}: {preset.steps} Adam steps"
        with progress.start(title, preset.steps) as task:
            kept = _Checkpoint(config.out / CHECKPOINT, wanted, clock)
            prior = _trained(config, preset, data, log, origin, kept, task)
        prior.save(config.out / PRIOR)
        MotorPrior.load(config.out / PRIOR)  # what nobody could load is no success
        remove(config.out, CHECKPOINT)


def _trained(
    config: Identify, preset: Preset, data: TrainingData, log: MotorLog, origin: _Origin, kept: _Checkpoint, task: Task
) -> MotorPrior:
    """The prior, with the figures that it is judged by later."""
    from motorprior.identification.reference import reference_metrics
    from motorprior.identification.train import CHUNK, identify

    def report(done: int, total: int, loss: float) -> None:  # the last chunk may be a short one
        kept.clock.note()
        task.advance(done % CHUNK or CHUNK, f"loss {loss:.4f}")

    found = identify(data, preset, config.seed, report, kept)
    metrics = {"final_loss": float(found.losses[-1]), "minutes_of_log": log.duration / 60 * log.num_joints}
    metrics |= {"aggregate_posterior_kl": found.aggregate_kl}
    metrics |= reference_metrics(found.network, data, preset, found.mean, log)
    return MotorPrior(
        found.network, found.mean, found.log_var, config.preset, origin.robot, origin.motor,
        origin.provenance | {"recipe": asdict(preset), "seed": config.seed}, metrics,
    )  # fmt: skip


@dataclass(frozen=True)
class _Origin:
    """Whose motors these are, and what the prior will say about it."""

    robot: str
    motor: str
    provenance: dict[str, Any]


def _training_log(path: Path) -> tuple[MotorLog, list[Path], _Origin]:
    """The log of a bench's folder, or a log of its own; the files that the prior depends on, the log first.

    Raises:
        LogError, ArtifactError: missing, truncated or inconsistent files.
    """
    if path.suffix == ".parquet":
        log = read_log(path)
        return log, [path], _Origin(log.robot, log.motor, {"log": log.source})
    log, facts = read_bench(path)
    origin = _Origin(facts.fleet.robot, facts.fleet.motor, {"bench": facts.as_json()})
    return log, [path / LOG, path / FACTS], origin


@dataclass(frozen=True)
class _Checkpoint:
    """A file beside the prior, of this very stage or ignored."""

    path: Path
    stage: dict[str, Any]
    clock: Stopwatch

    def load(self) -> dict[str, np.ndarray] | None:
        try:
            arrays, header = read_tensors(self.path)
        except ArtifactError:  # none there, or a damaged one: from the start
            return None
        return arrays if header == self.stage else None

    def save(self, state: dict[str, np.ndarray]) -> None:
        write_tensors(self.path, state, self.stage)
