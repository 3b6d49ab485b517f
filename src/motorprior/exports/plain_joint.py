"""A motor as what every engine has: armature, damping, dry friction and a position servo with delay and force limit."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
import math
import os
import re
import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import mujoco
import numpy as np

from motorprior.artifacts import write_json, write_text
from motorprior.bench.dynamometer import Trial
from motorprior.exports.exporter import (
    ConstantArrays,
    Exporter,
    Request,
    described_loss,
    one_motor,
    prior_of,
)
from motorprior.exports.mjcf import Mjcf, number
from motorprior.robots.model_source import model_files
from motorprior.simulation.driven_joints import hinge, require_uncoupled

_NOT_EXPRESSED = (
    "velocity_filter",
    "stribeck_torque",
    "load_friction",
    "gear_stiffness",
    "backlash",
    "gear_damping",
)
MIN_STEP = 0.0005  # shortest physics step for which the delay lines are long enough [s]
PASSIVE = ("armature", "damping", "frictionloss")  # attributes of a joint that a motor determines
# parameter -> constant and unit
PARAMETERS = {
    "armature": ("armature", "kg·m²"), "damping": ("viscous_damping", "N·m·s/rad"), "frictionloss": ("friction", "N·m"),
    "kp": ("kp", "N·m/rad"), "kv": ("kd", "N·m·s/rad"), "forcerange": ("torque_limit", "N·m"), "delay": ("delay", "s"),
    "offset": ("encoder_zero", "rad"),
}  # fmt: skip
# integers, since an enumeration of MuJoCo 4 does not equal a numpy integer
_NOT_INTEGRATED = [
    int(getattr(mujoco.mjtDyn, f"mjDYN_{name}")) for name in ("NONE", "FILTER", "FILTEREXACT")
]
# writes one motor, of its constants by name, at a joint
WriteMotor = Callable[[Mjcf, str, Mapping[str, float]], None]


def servo(values: Mapping[str, float], kv: float, timestep: float) -> dict[str, str]:
    """Attributes of an actuator with the force clip(kp·(target - q - encoder_zero) - kv·dq, ±torque_limit), delayed.

    A ``position`` actuator is the same without the encoder zero.
    """
    kp = values["kp"]
    limit = values["torque_limit"]
    law = {"dyntype": "none", "gaintype": "fixed", "gainprm": number(kp), "biastype": "affine"}
    law |= {
        "biasprm": number(-kp * values["encoder_zero"], -kp, -kv),
        "ctrllimited": "false",
        "gear": "1",
    }
    bounded = {"forcelimited": "false"}  # whatever a default of the model says
    if math.isfinite(limit):
        bounded = {"forcelimited": "true", "forcerange": number(-limit, limit)}
    # our targets are means from half a step before to half a step after now; MuJoCo's minimum delay
    # is one step
    delay = max(values["delay"] + 0.5 * timestep, timestep)
    # linear interpolation reads the sample before, too
    samples = math.ceil(delay / min(timestep, MIN_STEP)) + 2
    return law | bounded | {"nsample": str(samples), "interp": "linear", "delay": number(delay)}


def write_plain(mjcf: Mjcf, joint: str, values: Mapping[str, float]) -> None:
    """One motor as attributes of its joint and a position actuator."""
    for name in PASSIVE:
        mjcf.joint(joint).setAttribute(name, number(values[PARAMETERS[name][0]]))
    drive(mjcf, joint, joint, servo(values, values["kd"], mjcf.compiled.opt.timestep))


def drive(mjcf: Mjcf, joint: str, driven: str, attributes: dict[str, str]) -> None:
    """Put a servo of the joint ``driven`` in the place of the actuator of a joint, under its name, or add one.

    It keeps range and controls of a position servo; other controls in keyframes become the joint's
    angle.
    """
    model = mjcf.compiled
    old = mjcf.actuator_of(joint)
    angles = [number(angle) for angle in model.key_qpos[:, model.joint(joint).qposadr[0]]]
    if old is None:
        mjcf.add(mjcf.section("actuator"), "general", name=joint, joint=driven, **attributes)
        mjcf.edit_keyframes("ctrl", lambda words, key: words.append(angles[key]))
        return
    element, index = old
    is_servo = model.actuator_gainprm[index, 0] == -model.actuator_biasprm[index, 1] != 0.0
    if (
        is_servo
        and model.actuator_dyntype[index] in _NOT_INTEGRATED
        and model.actuator_gear[index, 0] == 1.0
    ):
        if model.actuator_ctrllimited[index]:
            attributes |= {
                "ctrllimited": "true",
                "ctrlrange": number(*model.actuator_ctrlrange[index]),
            }
    else:
        # MuJoCo 4 has actuators without control
        at = getattr(model, "actuator_ctrladr", range(model.nu))[index]
        mjcf.edit_keyframes("ctrl", lambda words, key: words.__setitem__(at, angles[key]))
    if (count := int(model.actuator_actnum[index])) > 0:
        own = int(model.actuator_actadr[index])
        first = own - sum(address < own for address in mjcf.dropped)
        mjcf.edit_keyframes("act", lambda words, _: words.__delitem__(slice(first, first + count)))
        mjcf.dropped += tuple(range(own, own + count))
    name = element.getAttribute("name") or joint
    element.parentNode.replaceChild(
        mjcf.element("general", name=name, joint=driven, **attributes), element
    )


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
        mjcf = Mjcf.read(RIG.format(dt=given.dt, inertia=inertia))
        write(mjcf, "joint", one_motor(values, motor))
        model = mujoco.MjModel.from_xml_string(mjcf.text())
        data = mujoco.MjData(model)
        targets = given.position_target[:, motor]
        data.qpos[:] = targets[0]
        for actuator, samples in enumerate(model.actuator_history[:, 0].tolist()):
            if samples:  # fill the delay line with a control that has never changed
                times = model.opt.timestep * np.arange(-samples, 0.0)
                mujoco.mj_initCtrlHistory(
                    model, data, actuator, times, np.full(samples, targets[0])
                )
        joint = data.joint("joint")
        for step, angle in enumerate(out):
            angle[motor] = joint.qpos[0]
            data.ctrl[0] = targets[step]
            load = (
                given.external_torque[step, motor]
                + given.load_stiffness[step, motor] * angle[motor]
            )
            joint.qfrc_applied[0] = load
            mujoco.mj_step(model, data)
    return out


def write_variants(request: Request, write: WriteMotor) -> list[Path]:
    """K variants of the user's MJCF, with copies of the files that it names, and motors.json.

    Files keep their positions relative to each other: of a model in scene/ with meshes in
    ../assets, both folders.
    """
    original = request.model
    assert original is not None and original.path is not None
    model, *others = model_files(original.path)
    root = Path(os.path.commonpath([file.parent for file in (model, *others)]))
    for file in others:
        target = request.out / file.relative_to(root)
        if target.resolve() != file:
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, target)
    variants = [
        replace(original, document=original.document.cloneNode(True))
        for _ in request.constants["kp"]
    ]
    require_uncoupled(
        original.compiled, [hinge(original.compiled, name) for name in request.joint_names]
    )
    for index, joint, values in request.motors():
        write(variants[index], joint, values)
    loss = described_loss(request.losses, request.not_expressed)
    motor = prior_of(request.source).motor
    # no -- in comments
    about = re.sub("-{2,}", "-", f"motors of {motor}, seed {request.seed}; {loss}")
    folder = request.out / model.parent.relative_to(root)
    files = [folder / f"{model.stem}_{index:03d}.xml" for index in range(len(variants))]
    for path, variant in zip(files, variants, strict=True):
        text = f"{variant.text()}\n<!-- {about} -->\n"
        write_text(path, text)
        Mjcf.read(text, path)  # raises ArtifactError if it cannot be compiled
    return [*files, *write_table(request)]


def write_table(request: Request) -> list[Path]:
    """Parameters of every sample and joint, their 5, 50 and 95 % quantiles, and correlations of their logarithms.

    Correlations are those between units: of the deviations from the mean of each joint.
    """
    # (K, J)
    found = {name: request.constants[constant] for name, (constant, _) in PARAMETERS.items()}
    positive = [name for name in found if name != "offset"]
    # (constants, K, J)
    logs = np.stack([np.log(np.maximum(found[name], 1e-12)) for name in positive])
    columns = (logs - logs.mean(axis=1, keepdims=True)).reshape(len(logs), -1)
    spread = columns.std(axis=1, keepdims=True)
    scaled = columns / np.where(spread > 0.0, spread, 1.0)
    matrix = (scaled @ scaled.T / scaled.shape[1]).tolist() if logs.shape[1] > 2 else None
    write_json(
        request.out / "motors.json",
        {
            **request.provenance(),
            "units": {name: unit for name, (_, unit) in PARAMETERS.items()},
            "samples": {name: value.tolist() for name, value in found.items()},
            "quantiles_5_50_95": {
                name: np.quantile(x, (0.05, 0.5, 0.95), axis=0).T.tolist()
                for name, x in found.items()
            },
            "correlation_of_logarithms": {"order": positive, "matrix": matrix},
        },
    )
    return [request.out / "motors.json"]


TABLE = Exporter("table", _NOT_EXPRESSED, write_table, partial(replayed, write=write_plain))
PLAIN = replace(
    TABLE, name="mjcf", write=partial(write_variants, write=write_plain), needs_model=True
)
