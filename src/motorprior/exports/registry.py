"""Write motors of a prior or posterior in any format, and replay the exported motors next to our own.

The replay simulates one hinge in closed loop on two loads. With the motors' median armature a, the
shank has the inertia 0.1·a and the leg 1.25·a. Both have the gravity of a pendulum of 0.1 m,
linearised at 45°. For the shipped robot's motors (a = 0.0032 kg·m²) these are its bare shank and
its leg.
"""

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.actuator.optional_terms import constants_of
from motorprior.artifacts import read_text
from motorprior.bench.dynamometer import Trial, run, trial_of
from motorprior.bench.excitation import EXCITATIONS, zero_order_hold
from motorprior.bounds import require_count
from motorprior.exceptions import ConfigError, LogError
from motorprior.exports.bam import BAM
from motorprior.exports.cards import CARD
from motorprior.exports.exporter import Exporter, ReplayFunction, Request, described_loss, sampled
from motorprior.exports.mjcf import Mjcf
from motorprior.exports.mjcf_detailed import DETAILED
from motorprior.exports.plain_joint import PLAIN, TABLE
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import resample
from motorprior.signals import rmse

EXPORTERS = {each.name: each for each in (BAM, CARD, PLAIN, DETAILED, TABLE)}
MAX_STEP = 0.002  # maximum physics step of the replay [s]
# trial -> load inertia over the median armature [-], and signals in turn for the motors; steps
# reach the torque limit
TRIALS = {
    "leg": (1.25, ("gait", "sine")),
    "shank": (0.1, ("gait", "sine")),
    "leg_steps": (1.25, ("steps",)),
}
# torque of gravity, and its change with the angle, over the load inertia [1/s²]
GRAVITY_PER_INERTIA = 0.7 * 98.0
# duration of a trial and of each target (a 100 Hz policy's) [s]
SECONDS = 3.0
HOLD = 0.01
_SEED = 54


def is_supported(exporter: Exporter) -> bool:
    """Whether the installed MuJoCo has what the format uses."""
    return int(mujoco.__version__.split(".")[0]) >= exporter.mujoco


@dataclass(frozen=True)
class Exported:
    """Files of `export`, and what the format changes."""

    files: tuple[Path, ...]
    # RMSE against our own motors by load [rad]; empty for a format without loss
    losses: dict[str, float]
    not_expressed: dict[str, float]  # median by name of the constants that the format lacks
    # medians of kp and kd of the motors in the unit of the logs, if these have gains
    gains: tuple[float, ...] | None
    # share of motors that mjcf-detailed wrote as plain joints, too stiff for the timestep [-]
    plain: float = 0.0

    def __str__(self) -> str:
        lines = [f"{len(self.files)} files in {self.files[0].parent}"]
        if self.gains is not None:
            kp, kd = (f"{value:.4g}" for value in self.gains)
            lines.append(
                f"motors at kp {kp}{'' if kd == kp else f' and kd {kd}'}, in the unit of their logs"
            )
        if self.plain:
            share = f"{100 * self.plain:.0f} %"
            lines.append(
                f"{share} are plain joints: too stiff for the model's timestep, see format mjcf"
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
        joints: names of the J joints; those of the source if not given, one joint for a bench's
            prior.
        gains: kp and kd of all joints (2,) or of each (2, J), see `MotorPrior.sample`; those of the
            log if not given.
        log: of the J joints, with loads: the loss on it is measured, too.

    Raises:
        ConfigError: an unknown format or joint, no model, or a prior without physical constants.
        ArtifactError: the model cannot be read, or ``out`` cannot be written.
        LogError: a log without loads.
    """
    if format not in EXPORTERS:
        raise ConfigError(
            f"no format {format!r}", remedy=f"use one of {', '.join(EXPORTERS)}", argument="format"
        )
    exporter = EXPORTERS[format]
    changed = None
    plain = 0.0
    require_count("motors", motors)
    if not is_supported(exporter):
        problem = (
            f"format {format} needs MuJoCo {exporter.mujoco}, and this is {mujoco.__version__}"
        )
        raise ConfigError(
            problem, remedy="export where no extra holds MuJoCo back", argument="format"
        )
    if exporter.needs_model:
        if model is None:
            raise ConfigError(
                f"format {format} changes your MJCF", remedy="give model", argument="model"
            )
        changed = Mjcf.read(read_text(Path(model)), Path(model))
    joints = joints or source.joint_names or ("motor",)
    if log is not None:
        if missing := [name for name in joints if name not in log.joint_names]:
            problem = (
                f"{log.source} has no joint {', '.join(missing)}, but {', '.join(log.joint_names)}"
            )
            raise ConfigError(problem, remedy="name joints of the log", argument="joints")
        log = log.with_joints([log.joint_names.index(name) for name in joints])
        gains = log.gains if gains is None else gains
    bank = sampled(source, motors, seed, joints, gains)
    step = min(MAX_STEP, bank.model.period)
    values = constants(bank, step)
    not_expressed = {
        name: float(np.median(np.abs(values[name]))) for name in exporter.not_expressed
    }
    errors: dict[str, float] = {}
    if exporter.replay is not None:
        not_expressed |= {
            name: float(np.median(values[name])) for name in constants_of(bank.model.terms)
        }
        errors = losses(
            exporter.replay, bank, step, None if log is None else log_trial(log, motors, step)
        )
    if changed is not None and exporter.becomes_plain is not None:
        plain = float(np.mean(exporter.becomes_plain(values, changed.compiled.opt.timestep)))
    table = {name: value.reshape(motors, -1) for name, value in values.items()}
    request = Request(source, joints, seed, table, Path(out), changed, errors, not_expressed)
    logged = None if bank.gains is None else tuple(np.median(bank.gains, axis=1).tolist())
    return Exported(tuple(exporter.write(request)), errors, not_expressed, logged, plain)


def replay_trial(name: str, armature: np.ndarray, dt: float) -> Trial:
    """One of TRIALS for motors with these armatures (n,) [kg·m²], at steps of ``dt`` [s]."""
    load, signals = TRIALS[name]
    rng = np.random.default_rng(_SEED)
    steps = round(SECONDS / dt)
    n = len(armature)
    chosen = [EXCITATIONS[signals[motor % len(signals)]].target for motor in range(n)]
    targets = np.stack(
        [zero_order_hold(signal(rng, steps, dt), round(HOLD / dt)) for signal in chosen], axis=1
    )
    inertia = np.full(n, load * float(np.median(armature)))
    weight = np.tile(-GRAVITY_PER_INERTIA * inertia, (steps, 1))
    return Trial(targets, weight, inertia, dt, load_stiffness=weight)


def log_trial(log: MotorLog, robots: int, dt: float) -> Trial:
    """Commands and loads of a log's longest segment, robot after robot; LogError without loads."""
    if log.load_inertia is None or log.external_torque is None:
        raise LogError(
            "no loads", where=log.source, remedy="import it with loads (docs/your-motors.md)"
        )
    one = trial_of(resample(max(log.segments(), key=lambda each: each.num_rows), dt))
    stiffness = (
        np.zeros_like(one.external_torque) if one.load_stiffness is None else one.load_stiffness
    )
    series = (one.position_target, one.external_torque, one.load_inertia, stiffness)
    targets, external, inertia, stiffness = (np.tile(each, robots) for each in series)
    return Trial(targets, external, inertia, dt, load_stiffness=stiffness)


def constants(motors: GreyBoxActuator, dt: float) -> dict[str, np.ndarray]:
    """(n,) constants by name, with kd = kp·kd_over_kp [N·m·s/rad] in place of kd_over_kp.

    ``friction`` is the dry friction with its load-dependent part at the mean absolute torque on the
    leg [N·m].
    """
    values = motors.constants()
    values["kd"] = values["kp"] * values.pop("kd_over_kp")
    torque = run(motors, replay_trial("leg", values["armature"], dt)).joint_torque
    return values | {
        "friction": values["coulomb"] + values["load_friction"] * np.abs(torque).mean(axis=0)
    }


def losses(
    replay: ReplayFunction, motors: GreyBoxActuator, dt: float, log: Trial | None = None
) -> dict[str, float]:
    """RMSE over all motors of exported against our own joint angles [rad], by the name in TRIALS, and of a ``log``."""
    values = constants(motors, dt)
    trials = {name: replay_trial(name, values["armature"], dt) for name in TRIALS}
    trials |= {} if log is None else {"log": log}
    return {
        name: float(rmse(replay(values, given), run(motors, given).joint_pos))
        for name, given in trials.items()
    }
