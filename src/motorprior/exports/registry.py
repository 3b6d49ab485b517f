"""Write motors of a prior or posterior in any format, and replay the exported motors next to our own.

The replay simulates one hinge in closed loop on two loads. With the motors' median armature a, the shank has the
inertia 0.1·a and the leg 1.25·a. Both have the gravity of a pendulum of 0.1 m, linearised at 45°. For the shipped
robot's motors (a = 0.0032 kg·m²) these are its bare shank and its leg.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.actuator.optional_terms import constants_of
from motorprior.bench.dynamometer import Trial, run, trial_of
from motorprior.bench.excitation import EXCITATIONS, zero_order_hold
from motorprior.bounds import require_count, require_seed
from motorprior.exceptions import ConfigError, LogError
from motorprior.exports.bam import BAM
from motorprior.exports.cards import CARD
from motorprior.exports.exporter import Exporter, Replay, Request, described_loss, prior_of, sampled, with_kd
from motorprior.exports.mjcf import Mjcf
from motorprior.exports.mjcf_detailed import DETAILED
from motorprior.exports.plain_joint import PLAIN, TABLE
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import resample
from motorprior.signals import rmse

EXPORTERS = {each.name: each for each in (BAM, CARD, PLAIN, DETAILED, TABLE)}
MAX_STEP = 0.002  # maximum physics step of the replay [s]
SMOOTH, STEP_SIGNALS = ("gait", "sine"), ("steps",)  # signals, in turn for the motors
# trial -> load inertia over the median armature [-], and signals; steps reach the torque limit
TRIALS = {"leg": (1.25, SMOOTH), "shank": (0.1, SMOOTH), "leg_steps": (1.25, STEP_SIGNALS)}
GRAVITY_PER_INERTIA = 0.7 * 98.0  # torque of gravity, and its change with the angle, over the load inertia [1/s²]
SECONDS, HOLD = 3.0, 0.01  # duration of a trial and of each target (a 100 Hz policy's) [s]
_SEED = 54


def is_supported(exporter: Exporter) -> bool:
    """Whether the installed MuJoCo has what the format uses."""
    return int(mujoco.__version__.split(".")[0]) >= exporter.mujoco


@dataclass(frozen=True)
class Exported:
    """Files of `export`, and what the format changes."""

    files: tuple[Path, ...]
    losses: dict[str, float]  # RMSE against our own motors by load [rad]; empty for a format without loss
    not_expressed: dict[str, float]  # median by name of the constants that the format lacks
    gains: tuple[float, float] | None  # medians of kp and kd of the motors in the unit of the logs, if these have gains
    plain: float = 0.0  # share of motors that mjcf-detailed wrote as plain joints, too stiff for the timestep [-]

    def __str__(self) -> str:
        lines = [f"{len(self.files)} files in {self.files[0].parent}"]
        if self.gains is not None:
            kp, kd = (f"{value:.4g}" for value in self.gains)
            lines.append(f"motors at kp {kp}{'' if kd == kp else f' and kd {kd}'}, in the unit of their logs")
        if self.plain:
            lines.append(
                f"{100 * self.plain:.0f} % are plain joints: too stiff for the model's timestep, see format mjcf"
            )
        if self.losses:  # a card loses nothing
            lines.append(described_loss(self.losses, self.not_expressed))
        return "\n".join(lines)


def export(
    source: MotorPrior | MotorPosterior,
    format: str,
    out: str | Path,
    *,
    motors: int = 1,
    seed: int = 0,
    model: str | Path | None = None,
    joints: tuple[str, ...] = (),
    gains: np.ndarray | tuple[float, float] | None = None,
    log: MotorLog | None = None,
) -> Exported:
    """Write ``motors`` samples per joint for another simulator, and measure the error of the format in closed loop.

    Args:
        source: prior or posterior with physical constants.
        format: bam, card, mjcf, mjcf-detailed or table (docs/export.md).
        out: folder for the files.
        motors: number of samples, K; formats with an MJCF write K variants of it.
        seed: of the samples; the files are deterministic.
        model: your MJCF, for mjcf and mjcf-detailed.
        joints: names of the J joints; those of the source if not given, one joint for a bench's prior.
        gains: kp and kd of all joints (2,) or of each (2, J), see `MotorPrior.sample`; those of the log if not given.
        log: of the J joints, with loads: the loss on it is measured, too.

    Raises:
        ConfigError: an unknown format or joint, no model, or a prior without physical constants.
        ArtifactError: the model cannot be read, or ``out`` cannot be written.
        LogError: a log without loads.
    """
    if format not in EXPORTERS:
        raise ConfigError(f"no format {format!r}", remedy=f"use one of {', '.join(EXPORTERS)}", argument="format")
    exporter = EXPORTERS[format]
    require_count("motors", motors)
    require_seed(seed)
    if exporter.needs_model and model is None:
        raise ConfigError(f"format {format} changes your MJCF", remedy="give model", argument="model")
    if not is_supported(exporter):
        problem = f"format {format} needs MuJoCo {exporter.mujoco}, and this is {mujoco.__version__}"
        raise ConfigError(problem, remedy="export where no extra holds MuJoCo back", argument="format")
    joints = joints or source.joint_names or ("motor",)
    if gains is None and log is not None and prior_of(source).model.gain_unit:
        gains = log.gains
    each = None if gains is None else np.broadcast_to(np.reshape(gains, (2, -1)), (2, len(joints)))
    bank = sampled(source, motors, seed, joints, each)
    step, values = min(MAX_STEP, bank.model.period), with_kd(bank.constants())
    not_expressed = {name: float(np.median(np.abs(values[name]))) for name in exporter.not_expressed}
    errors: dict[str, float] = {}
    if exporter.replay is not None:
        not_expressed |= {name: float(np.median(values[name])) for name in constants_of(bank.model.terms)}
        recorded = None if log is None else log_trial(log, joints, motors, step)
        errors = losses(exporter.replay, bank, step, recorded)
    table = {name: value.reshape(motors, -1) for name, value in (values | {"carried": carried(bank, step)}).items()}
    changed, plain = Mjcf.load(Path(model)) if exporter.needs_model and model is not None else None, 0.0
    if changed is not None and exporter.becomes_plain is not None:
        plain = float(np.mean(exporter.becomes_plain(values, changed.compiled.opt.timestep)))
    request = Request(source, joints, seed, table, Path(out), changed, errors, not_expressed)
    logged = None if bank.gains is None else (float(np.median(bank.gains[0])), float(np.median(bank.gains[1])))
    return Exported(tuple(exporter.write(request)), errors, not_expressed, logged, plain)


def replay_trial(name: str, armature: np.ndarray, dt: float) -> Trial:
    """One of TRIALS for motors with these armatures (n,) [kg·m²], at steps of ``dt`` [s]."""
    load, signals = TRIALS[name]
    rng, steps, n = np.random.default_rng(_SEED), round(SECONDS / dt), len(armature)
    chosen = [EXCITATIONS[signals[motor % len(signals)]].target for motor in range(n)]
    targets = np.stack([zero_order_hold(signal(rng, steps, dt), round(HOLD / dt)) for signal in chosen], axis=1)
    inertia = np.full(n, load * float(np.median(armature)))
    weight = np.tile(-GRAVITY_PER_INERTIA * inertia, (steps, 1))
    return Trial(targets, weight, inertia, dt, load_stiffness=weight)


def log_trial(log: MotorLog, joints: Sequence[str], robots: int, dt: float) -> Trial:
    """Commands and loads of a log's longest segment for these joints, robot after robot; errors as of `export`."""
    if log.load_inertia is None or log.external_torque is None:
        raise LogError("no loads", where=log.source, remedy="import it with loads (docs/your-motors.md)")
    if missing := [name for name in joints if name not in log.joint_names]:
        problem = f"{log.source} has no joint {', '.join(missing)}, but {', '.join(log.joint_names)}"
        raise ConfigError(problem, remedy="name joints of the log", argument="joints")
    segment = trial_of(resample(max(log.segments(), key=lambda each: each.num_rows), dt))
    columns = [log.joint_names.index(name) for name in joints] * robots
    external, stiffness = segment.external_torque[:, columns], segment.load_stiffness
    return Trial(
        segment.position_target[:, columns], external, segment.load_inertia[columns], dt,
        load_stiffness=np.zeros_like(external) if stiffness is None else stiffness[:, columns],
    )  # fmt: skip


def carried(motors: GreyBoxActuator, dt: float) -> np.ndarray:
    """(n,) mean absolute torque in the gears on the leg [N·m]."""
    given = replay_trial("leg", motors.constants()["armature"], dt)
    return np.abs(run(motors, given).joint_torque).mean(axis=0)


def losses(replay: Replay, motors: GreyBoxActuator, dt: float, log: Trial | None = None) -> dict[str, float]:
    """RMSE over all motors of exported against our own joint angles [rad], by the name in TRIALS, and of a ``log``."""
    values = with_kd(motors.constants()) | {"carried": carried(motors, dt)}
    trials = {name: replay_trial(name, values["armature"], dt) for name in TRIALS}
    trials |= {} if log is None else {"log": log}
    return {name: float(rmse(replay(values, given), run(motors, given).joint_pos)) for name, given in trials.items()}
