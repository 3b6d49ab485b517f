"""A motor as what every engine has: armature, damping, dry friction and a position servo with delay and force limit.

It is written into the user's MJCF, of which comments and the order of elements stay.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
from __future__ import annotations

import math
import re
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias
from xml.dom import minidom
from xml.parsers.expat import ExpatError

import mujoco
import numpy as np

from motorprior.artifacts import read_text, write_json, write_text
from motorprior.bench.dynamometer import Trial
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.exports.exporter import ConstantArrays, Exporter, Request, described_loss, one_motor
from motorprior.robots.model_source import model_files

_NOT_EXPRESSED = ("velocity_filter", "stribeck_torque", "load_friction", "gear_stiffness", "backlash", "gear_damping")
MIN_STEP = 0.0005  # shortest physics step for which the delay lines are long enough [s]
UNITS = {
    "armature": "kg·m²", "damping": "N·m·s/rad", "frictionloss": "N·m", "kp": "N·m/rad", "kv": "N·m·s/rad",
    "forcerange": "N·m", "delay": "s", "offset": "rad",
}  # fmt: skip
Element: TypeAlias = Any  # minidom element; minidom's types allow every parent to be None


@dataclass
class Mjcf:
    """A document, and the model that it was before any change."""

    document: Any  # minidom document
    compiled: mujoco.MjModel
    path: Path | None = None
    in_degrees: bool = False  # unit of its angles

    @classmethod
    def load(cls, path: Path) -> Mjcf:
        """Read a file; raises ArtifactError if it is not a well-formed MJCF."""
        text = read_text(path)
        try:
            spec = mujoco.MjSpec.from_file(str(path))
            return cls(minidom.parseString(text.encode()), spec.compile(), path, spec.compiler.degree)
        except (ExpatError, ValueError) as error:
            reason = " ".join(str(error).split())[:300]
            raise ArtifactError(f"cannot be read as MJCF ({reason})", where=path, remedy="correct the model") from error

    def joint(self, name: str) -> Element:
        """The joint of this name in the bodies; raises ConfigError if this file has none."""
        joints = {each.getAttribute("name") or "?": each for each in self._inside("worldbody", "joint")}
        if name not in joints:
            remedy = f"it has {', '.join(joints) or 'no joints'}; joints of an included file: give that file"
            raise ConfigError(f"no joint {name!r}", where=self.path, remedy=remedy, argument="joints")
        return joints[name]

    def actuator_of(self, joint: str) -> Element | None:
        """The actuator that names the joint, None without any; ConfigError for several, or for one in another file."""
        every = self._inside("actuator", "*")
        found = [each for each in every if joint in map(each.getAttribute, ("joint", "jointinparent"))]
        model = self.compiled
        on_joint = np.isin(model.actuator_trntype, (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT))
        count = np.count_nonzero(on_joint & (model.actuator_trnid[:, 0] == model.joint(joint).id))
        if count > 1 or count > len(found):
            problem = f"joint {joint!r} has {count} actuators, {len(found)} of them in this file"
            remedy = "leave one, in this file: the motor takes its place"
            raise ConfigError(problem, where=self.path, remedy=remedy, argument="model")
        return found[0] if found else None

    def _inside(self, section: str, element: str) -> list[Element]:
        sections = self.document.getElementsByTagName(section)
        return [found for each in sections for found in each.getElementsByTagName(element)]

    def section(self, name: str) -> Element:
        """The first section of this name, which is added if there is none."""
        root = self.document.documentElement
        return next((each for each in root.childNodes if each.nodeName == name), None) or self.add(root, name)

    def element(self, tag: str, /, **attributes: str) -> Element:
        """A new element, not yet in the document."""
        made = self.document.createElement(tag)
        for key, value in attributes.items():
            made.setAttribute(key, value)
        return made

    def add(self, parent: Element, tag: str, before: Element | None = None, /, **attributes: str) -> Element:
        """Add an element to another, before one of its children or at its end."""
        made = parent.insertBefore(self.element(tag, **attributes), before)
        parent.insertBefore(self.document.createTextNode("\n"), before)
        return made

    def text(self) -> str:
        """The document as text."""
        return "\n".join(each.toxml() for each in self.document.childNodes)


# writes one motor, of its constants by name, at a joint
WriteMotor = Callable[[Mjcf, str, Mapping[str, float]], None]


def plain(values: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters by name of UNITS, in the shape of the constants."""
    return {
        "armature": values["armature"], "damping": values["viscous_damping"], "frictionloss": friction(values),
        "kp": values["kp"], "kv": values["kd"], "forcerange": values["torque_limit"], "delay": values["delay"],
        "offset": values["encoder_zero"],
    }  # fmt: skip


def friction(values: Mapping[str, Any]) -> Any:
    """Dry friction [N·m] with its load-dependent part at the mean torque on a leg."""
    return values["coulomb"] + values["load_friction"] * values["carried"]


def servo(values: Mapping[str, float], kv: float, timestep: float) -> dict[str, str]:
    """Attributes of an actuator with the force clip(kp·(target - q - encoder_zero) - kv·dq, ±torque_limit), delayed.

    A ``position`` actuator is the same without the encoder zero.
    """
    kp, limit = values["kp"], values["torque_limit"]
    law = {"dyntype": "none", "gaintype": "fixed", "gainprm": number(kp), "biastype": "affine"}
    law |= {"biasprm": number(-kp * values["encoder_zero"], -kp, -kv), "ctrllimited": "false", "gear": "1"}
    bounded = {"forcelimited": "false"}  # whatever a default of the model says
    if math.isfinite(limit):
        bounded = {"forcelimited": "true", "forcerange": number(-limit, limit)}
    # our targets are means from half a step before to half a step after now; MuJoCo's minimum delay is one step
    delay = max(values["delay"] + 0.5 * timestep, timestep)
    samples = math.ceil(delay / min(timestep, MIN_STEP)) + 2  # linear interpolation reads the sample before, too
    return law | bounded | {"nsample": str(samples), "interp": "linear", "delay": number(delay)}


def number(*values: float) -> str:
    """Numbers of an attribute."""
    return " ".join(f"{value:.6g}" for value in values)


def write_plain(mjcf: Mjcf, joint: str, values: Mapping[str, float]) -> None:
    """One motor as attributes of its joint and a position actuator."""
    found, tag = plain(values), mjcf.joint(joint)
    for name in ("armature", "damping", "frictionloss"):
        tag.setAttribute(name, number(found[name]))
    drive(mjcf, joint, joint, servo(values, values["kd"], mjcf.compiled.opt.timestep))


def drive(mjcf: Mjcf, joint: str, driven: str, attributes: dict[str, str]) -> None:
    """Put a servo of the joint ``driven`` in the place of the actuator of a joint, under its name, or add one."""
    if (old := mjcf.actuator_of(joint)) is None:
        mjcf.add(mjcf.section("actuator"), "general", name=joint, joint=driven, **attributes)
    else:
        name = old.getAttribute("name") or joint
        if old.nodeName == "position" and old.getAttribute("ctrlrange"):
            attributes |= {"ctrllimited": "true", "ctrlrange": old.getAttribute("ctrlrange")}
        old.parentNode.replaceChild(mjcf.element("general", name=name, joint=driven, **attributes), old)


RIG = """<mujoco>
  <compiler angle="radian"/>
  <option timestep="{dt!r}" integrator="implicitfast" gravity="0 0 0"/>
  <worldbody>
    <body name="link"><inertial pos="0 0 0" mass="1" diaginertia="{inertia!r} {inertia!r} {inertia!r}"/>
      <joint name="joint" axis="0 1 0"/></body>
  </worldbody>
</mujoco>
"""


def replayed(values: ConstantArrays, given: Trial, write: WriteMotor) -> np.ndarray:
    """(steps, n) joint angles [rad] of motors that ``write`` has written into RIG."""
    assert given.load_stiffness is not None
    out = np.zeros_like(given.position_target)
    for motor, inertia in enumerate(given.load_inertia.tolist()):
        rig = RIG.format(dt=given.dt, inertia=inertia)
        mjcf = Mjcf(minidom.parseString(rig), mujoco.MjModel.from_xml_string(rig))
        write(mjcf, "joint", one_motor(values, motor))
        model = mujoco.MjModel.from_xml_string(mjcf.text())
        data, targets = mujoco.MjData(model), given.position_target[:, motor]
        data.qpos[:] = targets[0]
        for actuator, samples in enumerate(model.actuator_history[:, 0].tolist()):
            if samples:  # fill the delay line with a control that has never changed
                times = model.opt.timestep * np.arange(-samples, 0.0)
                mujoco.mj_initCtrlHistory(model, data, actuator, times, np.full(samples, targets[0]))
        joint = data.joint("joint")
        for step, angle in enumerate(out):
            angle[motor], data.ctrl[0] = joint.qpos[0], targets[step]
            load = given.external_torque[step, motor] + given.load_stiffness[step, motor] * angle[motor]
            joint.qfrc_applied[0] = load
            mujoco.mj_step(model, data)
    return out


def write_variants(request: Request, write: WriteMotor) -> list[Path]:
    """K variants of the user's MJCF, with copies of the files that it names, and motors.json."""
    assert request.model is not None
    model = request.model.resolve()
    for file in model_files(model)[1:]:
        if not file.is_relative_to(model.parent):
            problem = f"it names {file}, outside its folder"
            raise ArtifactError(problem, where=model, remedy="give an MJCF whose files are in its folder")
        target = request.out / file.relative_to(model.parent)
        if target.resolve() != file:
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, target)
    original = Mjcf.load(model)
    variants = [replace(original, document=original.document.cloneNode(True)) for _ in request.constants["kp"]]
    for index, joint, values in request.motors():
        write(variants[index], joint, values)
    loss = described_loss(request.losses, request.not_expressed)
    about = re.sub("-{2,}", "-", f"motors of {request.prior.motor}, seed {request.seed}; {loss}")  # no -- in comments
    files = [request.out / f"{model.stem}_{index:03d}.xml" for index in range(len(variants))]
    for path, variant in zip(files, variants, strict=True):
        write_text(path, f"{variant.text()}\n<!-- {about} -->\n")
    return [*files, *write_table(request)]


def write_table(request: Request) -> list[Path]:
    """Parameters of every sample and joint, their 5, 50 and 95 % quantiles, and correlations of their logarithms.

    Correlations are those between units: of the deviations from the mean of each joint.
    """
    found = plain(request.constants)  # (K, J)
    positive = [name for name in found if name != "offset"]
    logs = np.stack([np.log(np.maximum(found[name], 1e-12)) for name in positive])  # (constants, K, J)
    columns = (logs - logs.mean(axis=1, keepdims=True)).reshape(len(logs), -1)
    spread = columns.std(axis=1, keepdims=True)
    scaled = columns / np.where(spread > 0.0, spread, 1.0)
    matrix = (scaled @ scaled.T / scaled.shape[1]).tolist() if logs.shape[1] > 2 else None
    write_json(request.out / "motors.json", {
        **request.provenance(), "units": UNITS, "samples": {name: value.tolist() for name, value in found.items()},
        "quantiles_5_50_95": {name: np.quantile(x, (0.05, 0.5, 0.95), axis=0).T.tolist() for name, x in found.items()},
        "correlation_of_logarithms": {"order": positive, "matrix": matrix},
    })  # fmt: skip
    return [request.out / "motors.json"]


TABLE = Exporter("table", _NOT_EXPRESSED, write_table, partial(replayed, write=write_plain))
PLAIN = replace(TABLE, name="mjcf", write=partial(write_variants, write=write_plain), needs_model=True)
