"""Write motors of a prior or posterior in any format."""

import copy
from dataclasses import dataclass, field, replace
from pathlib import Path

import mujoco
import numpy as np

from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.actuator.optional_terms import constants_of
from motorprior.artifacts import read_text
from motorprior.bounds import require_count
from motorprior.exceptions import ConfigError
from motorprior.exports.bam import BAM
from motorprior.exports.cards import CARD
from motorprior.exports.exporter import Exporter, Request, described_loss, sampled
from motorprior.exports.mjcf import MJCF
from motorprior.exports.mjcf_detailed import DETAILED
from motorprior.exports.mjcf_document import Mjcf, number
from motorprior.exports.model_run import SECONDS, ModelRun, run_model
from motorprior.exports.motion_profile import SPEED
from motorprior.exports.replay import MAX_STEP, constants, log_trial, losses
from motorprior.exports.table import TABLE
from motorprior.logs.motor_log import MotorLog
from motorprior.texts import ShownInNotebooks

# factors on a model's timestep at which an export that diverges is tried again
SHORTER_STEPS = (0.5, 0.25, 0.125)
MAX_LOSS = 0.02  # a loss that is larger is pointed out [rad]
# control of motors that do not follow positions, by command mode
CONTROLS = {"velocity": "velocity target [rad/s]", "torque": "torque [N·m]"}
EXPORTERS = {exporter.name: exporter for exporter in (BAM, CARD, MJCF, DETAILED, TABLE)}


@dataclass(frozen=True)
class Exported(ShownInNotebooks):
    """Files of `export`, and what the format changes."""

    files: tuple[Path, ...]
    # RMSE [rad] between the motors of the format and the source's own motors, on each load; empty
    # for a format that loses nothing
    losses: dict[str, float]
    not_expressed: dict[str, float]  # median by name of the constants that the format lacks
    # medians of kp and kd of the motors in the unit of the logs, if these have gains
    gains: tuple[float, ...] | None
    # share of motors that mjcf-detailed wrote as plain joints, too stiff for the timestep [-]
    plain: float = 0.0
    # RMSE [rad] by joint on the user's model, over all variants of it, see `run_model`; empty for
    # formats without a model
    model_losses: dict[str, float] = field(default_factory=dict)
    control: str = ""  # what the motors follow in place of positions

    def __str__(self) -> str:
        lines = [f"{len(self.files)} files in {self.files[0].parent}"]
        if self.gains is not None:
            kp, kd = self.gains
            text = f"kp {kp:.4g}"
            if f"{kd:.4g}" != f"{kp:.4g}":
                text += f" and kd {kd:.4g}"
            lines.append(f"motors at {text}, in the unit of their logs")
        if self.control:
            lines.append(f"the control of these motors is a {self.control}")
        if self.plain:
            lines.append(
                f"{100 * self.plain:.0f} % are plain joints: too stiff for the model's timestep, "
                "see format mjcf"
            )
        if self.model_losses:
            lines.append(_described_model_losses(self.model_losses))
        if SPEED in self.not_expressed:
            lines.append(
                "the firmware of these motors has a motion profile: apply mp.MotionProfile to the "
                "targets (docs/export.md)"
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
    """Write ``motors`` samples per joint for another simulator, and measure the format's error.

    The error is measured in a replay in closed loop, see `replay`. A model with exported motors is
    also run at its own timestep, next to the learned motors (`run_model`); an export that diverges
    there is refused.

    Args:
        source: prior or posterior with physical constants.
        format: bam, card, mjcf, mjcf-detailed or table (docs/export.md).
        out: folder for the files.
        motors: number of samples, K; formats with an MJCF write K variants of it.
        seed: of the samples; the files are deterministic.
        model: your MJCF, for mjcf and mjcf-detailed.
        joints: names of the J joints; the joints of the source if not given, one joint for a
            bench's prior.
        gains: kp and kd of all joints (2,) or of each (2, J), see `MotorPrior.sample`; the gains of
            the log if not given.
        log: log of the J joints, with loads; the format's error on its motion is measured, too.

    Raises:
        ConfigError: an unknown format or joint, no model, a prior without physical constants, or
            motors that diverge at the model's timestep; states the timestep that they need.
        ArtifactError: the model cannot be read, or ``out`` cannot be written.
        LogError: a log without loads.
    """
    exporter = _exporter_of(format)
    require_count("motors", motors)
    _require_supported(exporter)
    document = _model_of(exporter, model)
    joints = joints or source.joint_names or ("motor",)
    if log is not None:
        log = _with_joints(log, joints)
        if gains is None and log.command_mode in ("position", "mit"):
            gains = log.gains

    actuator = sampled(source, motors, seed, joints, gains)
    follows_positions = actuator.command_mode in ("position", "mit")
    if not follows_positions and not exporter.has_other_commands:
        raise ConfigError(
            f"motors of format {exporter.name} follow positions, and these motors "
            f"{actuator.command_mode} commands",
            remedy=_remedy_for_commands(actuator),
            argument="format",
        )
    step = min(MAX_STEP, actuator.model.period)
    values = constants(actuator, step)

    # what the format cannot express, and the error of its motors
    not_expressed = {}
    for name in exporter.not_expressed:
        not_expressed[name] = float(np.median(np.abs(values[name])))
    errors: dict[str, float] = {}
    if exporter.replay is not None:
        for name in constants_of(actuator.model.terms):
            not_expressed[name] = float(np.median(values[name]))
        trial = None if log is None else log_trial(log, motors, step)
        errors = losses(exporter.replay, actuator, step, trial)

    plain_share = 0.0
    if document is not None and exporter.is_written_as_plain_joint is not None:
        timestep = document.compiled.opt.timestep
        is_plain = exporter.is_written_as_plain_joint(values, timestep)
        plain_share = float(np.mean(is_plain))

    by_robot = {name: array.reshape(motors, -1) for name, array in values.items()}
    request = Request(source, joints, seed, by_robot, Path(out), document, errors, not_expressed)
    files = tuple(exporter.write(request))
    model_losses = {}
    if document is not None:
        model_losses = _losses_on_model(exporter, request, actuator, files)
    median_gains = None
    if actuator.gains is not None and follows_positions:
        median_gains = tuple(np.median(actuator.gains, axis=1).tolist())
    control = "" if exporter.replay is None else CONTROLS.get(actuator.command_mode, "")
    return Exported(files, errors, not_expressed, median_gains, plain_share, model_losses, control)


def _losses_on_model(
    exporter: Exporter, request: Request, actuator: GreyBoxActuator, files: tuple[Path, ...]
) -> dict[str, float]:
    """RMSE [rad] by joint over all variants of the user's model.

    Deletes the variants and raises ConfigError if one of them diverges.
    """
    runs = _runs_on_model(request, actuator, files)
    diverged = [run.diverged_at for run in runs if run.diverged_at is not None]
    if not diverged:
        losses = {}
        for name in request.joint_names:
            losses[name] = float(np.sqrt(np.mean([run.losses[name] ** 2 for run in runs])))
        return losses

    timestep = runs[0].timestep
    remedy = _remedy_for_divergence(exporter, request, actuator)
    for path in files[: len(runs)]:
        path.unlink()
    problem = (
        f"motors of format {exporter.name} diverge on the model after {min(diverged):.2g} s, at "
        f"its timestep of {timestep:g} s"
    )
    raise ConfigError(problem, remedy=remedy, argument="format")


def _remedy_for_divergence(exporter: Exporter, request: Request, actuator: GreyBoxActuator) -> str:
    """The longest of some shorter timesteps at which the motors follow, or another format."""
    assert request.model is not None
    original = request.model
    for factor in SHORTER_STEPS:
        compiled = copy.copy(original.compiled)
        compiled.opt.timestep *= factor
        document = original.document.cloneNode(True)
        shorter = replace(original, document=document, compiled=compiled)
        shorter.section("option").setAttribute("timestep", number(compiled.opt.timestep))
        runs = _runs_on_model(
            request, actuator, tuple(exporter.write(replace(request, model=shorter)))
        )
        if all(run.diverged_at is None for run in runs):
            loss = max(max(run.losses.values()) for run in runs)
            return (
                f'set timestep="{compiled.opt.timestep:g}" in the <option> of the model, where '
                f"they follow the learned motors within {1e3 * loss:.1f} mrad, or choose format "
                "mjcf"
            )
    return "choose format mjcf, or drive the model by DrivenJoints"


def _runs_on_model(
    request: Request, actuator: GreyBoxActuator, files: tuple[Path, ...]
) -> list[ModelRun]:
    """A run of every variant, next to its own learned motors."""
    assert request.model is not None and request.model.path is not None
    count = len(request.joint_names)
    runs = []
    for robot, path in enumerate(files[: len(request.constants["kp"])]):
        columns = slice(robot * count, (robot + 1) * count)
        gains = None if actuator.gains is None else actuator.gains[:, columns]
        motors = replace(actuator, z=actuator.z[columns], gains=gains)
        runs.append(run_model(request.model.path, path, motors, request.joint_names))
    return runs


def _described_model_losses(losses: dict[str, float]) -> str:
    errors = ", ".join(f"{name} {1e3 * error:.1f}" for name, error in losses.items())
    text = (
        f"RMSE against the learned motors on your model, {SECONDS:g} s in the air [mrad]: {errors}"
    )
    if max(losses.values()) > MAX_LOSS:
        text += "; mp.DrivenJoints puts the learned motors themselves on the model"
    return text


def is_supported(exporter: Exporter) -> bool:
    """Whether the installed MuJoCo has what the format uses."""
    return int(mujoco.__version__.split(".")[0]) >= exporter.min_mujoco


def _remedy_for_commands(actuator: GreyBoxActuator) -> str:
    """What to do if a format needs motors that follow positions; only logged gains can be given."""
    remedy = "choose format mjcf or table"
    if actuator.model.gain_unit:
        return f"give the gains kp and kd that will be sent, or {remedy}"
    return remedy


def _exporter_of(format: str) -> Exporter:
    if format not in EXPORTERS:
        raise ConfigError(
            f"no format {format!r}", remedy=f"use one of {', '.join(EXPORTERS)}", argument="format"
        )
    return EXPORTERS[format]


def _require_supported(exporter: Exporter) -> None:
    if not is_supported(exporter):
        raise ConfigError(
            f"format {exporter.name} needs MuJoCo {exporter.min_mujoco}, "
            f"and this is {mujoco.__version__}",
            remedy="export in an environment without extras, which may require an older MuJoCo",
            argument="format",
        )


def _model_of(exporter: Exporter, model: str | Path | None) -> Mjcf | None:
    """The user's MJCF for a format that changes it, None for the others."""
    if not exporter.needs_model:
        return None
    if model is None:
        raise ConfigError(
            f"format {exporter.name} changes your MJCF", remedy="give model", argument="model"
        )
    return Mjcf.read(read_text(Path(model)), Path(model))


def _with_joints(log: MotorLog, joints: tuple[str, ...]) -> MotorLog:
    """The log of these joints, in their order."""
    missing = [name for name in joints if name not in log.joint_names]
    if missing:
        raise ConfigError(
            f"{log.source} has no joint {', '.join(missing)}, but {', '.join(log.joint_names)}",
            remedy="name joints of the log",
            argument="joints",
        )
    return log.with_joints([log.joint_names.index(name) for name in joints])
