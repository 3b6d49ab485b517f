"""A motor as what every engine has: armature, damping, dry friction and a position servo with delay and force limit."""

from __future__ import annotations

import math
import re
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from motorprior.artifacts import write_json, write_text
from motorprior.bench.dynamometer import Trial
from motorprior.exceptions import ArtifactError
from motorprior.exports.exporter import Constants, Request, one_motor
from motorprior.exports.mjcf_text import MjcfText, attribute_text
from motorprior.exports.replay import RIG, as_mrad, replay_mjcf
from motorprior.robots.model_source import model_files

DROPS = ("velocity_filter", "stribeck_torque", "load_friction", "gear_stiffness", "backlash", "gear_damping")
MIN_STEP = 0.0005  # shortest physics step for which the delay lines are long enough [s]
UNITS = {
    "armature": "kg·m²", "damping": "N·m·s/rad", "frictionloss": "N·m", "kp": "N·m/rad", "kv": "N·m·s/rad",
    "forcerange": "N·m", "delay": "s", "offset": "rad",
}  # fmt: skip
# Writes one motor, of its constants by name, at a joint of a text
WriteMotor = Callable[[MjcfText, str, Mapping[str, float]], None]


def plain(values: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters by name of UNITS, in the shape of the constants."""
    return {
        "armature": values["armature"], "damping": values["viscous_damping"], "frictionloss": dry_friction(values),
        "kp": values["kp"], "kv": values["kd"], "forcerange": values["torque_limit"], "delay": values["delay"],
        "offset": values["encoder_zero"],
    }  # fmt: skip


def dry_friction(values: Mapping[str, Any]) -> Any:
    """Dry friction [N·m] with its load-dependent part at the mean torque on a leg."""
    return values["coulomb"] + values["load_friction"] * values["carried"]


def servo(values: Mapping[str, float], kv: float, timestep: float) -> dict[str, str]:
    """Attributes of an actuator with the force clip(kp·(target - q - encoder_zero) - kv·dq, ±torque_limit), delayed.

    A ``position`` actuator is the same without the encoder zero.
    """
    kp, limit = values["kp"], values["torque_limit"]
    bias = " ".join(map(number, (-kp * values["encoder_zero"], -kp, -kv)))
    law = {"gaintype": "fixed", "gainprm": number(kp), "biastype": "affine", "biasprm": bias}
    bounded = {"forcelimited": "true", "forcerange": f"{number(-limit)} {number(limit)}"}
    # our targets are means from half a step before to half a step after now; MuJoCo's minimum delay is one step
    delay = max(values["delay"] + 0.5 * timestep, timestep)
    samples = math.ceil(delay / min(timestep, MIN_STEP)) + 2  # linear interpolation reads the sample before, too
    delayed = {"nsample": str(samples), "interp": "linear", "delay": number(delay)}
    return law | (bounded if math.isfinite(limit) else {}) | delayed


def number(value: float) -> str:
    """Six significant digits."""
    return f"{value:.6g}"


def write_plain(text: MjcfText, joint: str, values: Mapping[str, float]) -> None:
    """One motor as attributes of its joint and a position actuator."""
    found = plain(values)
    text.set(text.joint(joint), {name: number(found[name]) for name in ("armature", "damping", "frictionloss")})
    drive(text, joint, joint, servo(values, values["kd"], text.compiled.opt.timestep))


def drive(text: MjcfText, joint: str, driven: str, attributes: Mapping[str, str]) -> None:
    """Make the actuator of a joint this servo of the joint ``driven``, under its name; add one if there is none."""
    tag, attributes = text.actuator_of(joint), {"joint": driven, **attributes}
    if tag is None:
        text.insert_in("actuator", f"<general {attribute_text({'name': joint, **attributes})}/>")
    else:
        text.set(tag, attributes, "general", _OTHERS)


# attributes of actuators that a servo lacks, or that mean something else there
_OTHERS = (
    "kp", "kv", "dampratio", "timeconst", "inheritrange", "ctrlrange", "ctrllimited", "dyntype", "dynprm", "gaintype",
    "gainprm", "biastype", "biasprm", "forcelimited", "forcerange", "jointinparent",
)  # fmt: skip


def replayed(values: Constants, given: Trial, write: WriteMotor) -> np.ndarray:
    """(steps, n) joint angles [rad] of motors that ``write`` has written into the test model."""
    columns = []
    with TemporaryDirectory() as folder:
        path = Path(folder) / "rig.xml"
        for motor, inertia in enumerate(given.load_inertia.tolist()):
            path.write_text(RIG.format(dt=given.dt, inertia=inertia), "utf-8")
            text = MjcfText(path)
            write(text, "joint", one_motor(values, motor))
            columns.append(replay_mjcf(text.text(), given, motor))
    return np.stack(columns, axis=1)


def write_variants(request: Request, write: WriteMotor) -> list[Path]:
    """K variants of the user's MJCF, with copies of the files that it names, and motors.json."""
    assert request.model is not None
    model = request.model.resolve()
    for file in model_files(model)[1:]:
        if not file.is_relative_to(model.parent):
            problem = f"it names {file}, outside its folder"
            raise ArtifactError(problem, where=model, remedy="give an MJCF whose files are in its folder")
        target = request.out / file.relative_to(model.parent)
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.resolve() != file:
            shutil.copyfile(file, target)
    texts = [MjcfText(model) for _ in request.sample.robots]
    for index, joint, values in request.motors():
        write(texts[index], joint, values)
    files = [request.out / f"{model.stem}_{index:03d}.xml" for index in range(len(texts))]
    for path, text in zip(files, texts, strict=True):
        write_text(path, f"{text.text().rstrip()}\n<!-- {_about(request)} -->\n")
    return [*files, *write_table(request)]


def _about(request: Request) -> str:
    """Origin and loss of the export, for a comment, in which XML allows no double hyphen."""
    lost = ", ".join(f"{name} (median {value:.3g})" for name, value in request.not_expressed.items())
    origin = f"motors of {request.sample.prior.motor}, seed {request.sample.seed}"
    found = f"RMSE against the learned motors: {as_mrad(request.losses)}; not expressed: {lost or 'nothing'}"
    return re.sub("-{2,}", "-", f"{origin}; {found}")


def write_table(request: Request) -> list[Path]:
    """Parameters of every sample and joint, their 5, 50 and 95 % quantiles, and correlations of their logarithms.

    Correlations are those between units: of the deviations from the mean of each joint.
    """
    found = plain(request.constants)
    positive = [name for name in found if name != "offset"]
    logs = np.stack([np.log(np.maximum(found[name], 1e-12)) for name in positive])  # (constants, K, J)
    columns = (logs - logs.mean(axis=1, keepdims=True)).reshape(len(logs), -1)
    spread = columns.std(axis=1, keepdims=True)
    scaled = columns / np.where(spread > 0.0, spread, 1.0)
    matrix = (scaled @ scaled.T / scaled.shape[1]).tolist() if logs.shape[1] > 2 else None
    content = {
        **request.provenance(), "units": UNITS,
        "samples": {name: value.tolist() for name, value in found.items()},  # (K, J)
        "quantiles_5_50_95": {  # (J, 3)
            name: np.quantile(value, (0.05, 0.5, 0.95), axis=0).T.tolist() for name, value in found.items()
        },
        "correlation_of_logarithms": {"order": positive, "matrix": matrix},
    }  # fmt: skip
    path = request.out / "motors.json"
    write_json(path, content)
    return [path]
