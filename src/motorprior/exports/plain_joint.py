"""A motor as what every engine has: armature, damping, dry friction and a position servo with delay and force limit."""

from __future__ import annotations

import math
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from motorprior.artifacts import write_json, write_text
from motorprior.bench.dynamometer import Trial
from motorprior.exceptions import ArtifactError
from motorprior.exports.exporter import Constants, Request
from motorprior.exports.mjcf_text import MjcfText
from motorprior.exports.replay import replay_mjcf, rig
from motorprior.robots.model_source import model_files

DROPS = ("velocity_filter", "stribeck_torque", "load_friction", "gear_stiffness", "backlash", "gear_damping")
MIN_STEP = 0.0005  # shortest physics step for which the delay lines are long enough [s]
UNITS = {
    "armature": "kg·m²", "damping": "N·m·s/rad", "frictionloss": "N·m", "kp": "N·m/rad", "kv": "N·m·s/rad",
    "forcerange": "N·m", "delay": "s", "offset": "rad",
}  # fmt: skip
# Writes one motor, of constants () by name, at a joint of a text
WriteMotor = Callable[[MjcfText, str, Constants], None]


def plain(values: Constants) -> dict[str, np.ndarray]:
    """Parameters by name of UNITS, in the shape of the constants."""
    return {
        "armature": values["armature"], "damping": values["viscous_damping"], "frictionloss": dry_friction(values),
        "kp": values["kp"], "kv": values["kd"], "forcerange": values["torque_limit"], "delay": values["delay"],
        "offset": values["encoder_zero"],
    }  # fmt: skip


def dry_friction(values: Constants) -> np.ndarray:
    """Dry friction [N·m] at the mean torque on a leg, which stands for that of the load."""
    return values["coulomb"] + values["load_friction"] * values["carried"]


def servo(values: Constants, kv: float, timestep: float) -> dict[str, str]:
    """Attributes of an actuator with the force clip(kp·(target - q - encoder_zero) - kv·dq, ±torque_limit).

    A ``position`` actuator is the same without the encoder zero.
    """
    kp, limit = float(values["kp"]), float(values["torque_limit"])
    bias = " ".join(map(number, (-kp * float(values["encoder_zero"]), -kp, -kv)))
    law = {"gaintype": "fixed", "gainprm": number(kp), "biastype": "affine", "biasprm": bias}
    bounded = {"forcelimited": "true", "forcerange": f"{number(-limit)} {number(limit)}"}
    return law | (bounded if math.isfinite(limit) else {}) | delayed(float(values["delay"]), timestep)


def delayed(delay: float, timestep: float) -> dict[str, str]:
    """Attributes of an actuator whose target is late by ``delay`` [s].

    Our targets are means from half a step before to half a step after now, so half a step is added; the least delay of
    MuJoCo is one step.
    """
    late = max(delay + 0.5 * timestep, timestep)
    samples = math.ceil(late / min(timestep, MIN_STEP)) + 2  # linear interpolation reads the sample before, too
    return {"nsample": str(samples), "interp": "linear", "delay": number(late)}


def number(value: float | np.ndarray) -> str:
    """Six significant digits."""
    return f"{float(value):.6g}"


def write_plain(text: MjcfText, joint: str, values: Constants) -> None:
    """One motor as attributes of its joint and a position actuator."""
    found = plain(values)
    own = {name: number(found[name]) for name in ("armature", "damping", "frictionloss")}
    text.set(text.joint(joint), own)
    drive(text, joint, joint, "general", servo(values, float(values["kd"]), text.timestep))


def drive(text: MjcfText, joint: str, driven: str, element: str, attributes: dict[str, str]) -> None:
    """Make the actuator of a joint this servo of the joint ``driven``, under its name; add one if there is none."""
    tag = text.actuator_of(joint)
    if tag is None:
        values = {"name": joint, "joint": driven} | attributes
        text.insert_in("actuator", [f"<{element} " + " ".join(f'{k}="{v}"' for k, v in values.items()) + "/>"])
        return
    text.set(tag, {"joint": driven} | attributes, element, _OTHERS)


# attributes of actuators that a servo lacks, or that mean something else there
_OTHERS = (
    "kp", "kv", "dampratio", "timeconst", "inheritrange", "ctrlrange", "ctrllimited", "dyntype", "dynprm", "gaintype",
    "gainprm", "biastype", "biasprm", "forcelimited", "forcerange", "jointinparent",
)  # fmt: skip


def replayed(values: Constants, given: Trial, write: WriteMotor) -> np.ndarray:
    """(steps, n) joint angles [rad] of motors that ``write`` has written into the test model."""
    texts = []
    with TemporaryDirectory() as folder:
        path = Path(folder) / "rig.xml"
        for motor in range(len(values["kp"])):
            path.write_text(rig(given, motor), "utf-8")
            text = MjcfText(path)
            write(text, "joint", {name: value[motor] for name, value in values.items()})
            texts.append(text.text())
    return replay_mjcf(texts, given)


def write_variants(request: Request, write: WriteMotor) -> list[Path]:
    """K variants of the user's MJCF, with copies of the files that it names, and motors.json."""
    assert request.model is not None
    model, files = request.model.resolve(), []
    for file in model_files(model)[1:]:
        if not file.is_relative_to(model.parent):
            problem = f"it names {file}, outside its folder"
            raise ArtifactError(problem, where=model, remedy="give an MJCF whose files are in its folder")
        target = request.out / file.relative_to(model.parent)
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.resolve() != file:
            shutil.copyfile(file, target)
    values = request.sample.constants()
    for index in range(len(request.sample.robots)):
        text = MjcfText(model)
        for column, joint in enumerate(request.sample.joint_names):
            write(text, joint, {name: value[index, column] for name, value in values.items()})
        path = request.out / f"{model.stem}_{index:03d}.xml"
        write_text(path, _with_comment(text.text(), request))
        files.append(path)
    write_table(request, request.out / "motors.json")
    return [*files, request.out / "motors.json"]


def _with_comment(text: str, request: Request) -> str:
    """The text with the loss of the export in a comment at its end."""
    lost = ", ".join(f"{name} (median {value:.3g})" for name, value in request.not_expressed.items())
    found = ", ".join(f"{load} {1e3 * value:.1f} mrad" for load, value in request.losses.items())
    note = f"motors of {request.sample.prior.motor}, seed {request.sample.seed}; RMSE against the learned motors: "
    note = re.sub("-{2,}", "-", f"{note}{found}; not expressed: {lost or 'nothing'}")
    return f"{text.rstrip()}\n<!-- {note} -->\n"


def write_table(request: Request, path: Path) -> None:
    """Parameters of every sample and joint, their 5, 50 and 95 % quantiles, and correlations of their logarithms."""
    found = plain(request.sample.constants())
    positive = {name: value for name, value in found.items() if name != "offset"}
    columns = np.stack([np.log(np.maximum(value, 1e-12)).ravel() for value in positive.values()])
    quantiles = {name: np.quantile(value, (0.05, 0.5, 0.95), axis=0).T.tolist() for name, value in found.items()}
    several = columns.shape[1] > 2
    spread = columns.std(axis=1, keepdims=True)
    scaled = (columns - columns.mean(axis=1, keepdims=True)) / np.where(spread > 0.0, spread, 1.0)
    content = {
        **request.sample.provenance(), "units": UNITS,
        "samples": {name: value.tolist() for name, value in found.items()},  # (K, J)
        "quantiles_5_50_95": quantiles,  # (J, 3)
        "correlation_of_logarithms": {
            "order": list(positive), "matrix": (scaled @ scaled.T / scaled.shape[1]).tolist() if several else None,
        },
        "loss_rad": dict(request.losses), "not_expressed": dict(request.not_expressed),
    }  # fmt: skip
    write_json(path, content)
