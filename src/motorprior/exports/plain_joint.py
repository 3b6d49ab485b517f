"""A motor as what every engine has: armature, damping, friction and a delayed servo.

A servo follows position targets; with kp 0 velocity targets; with kp and kd 0 it is a torque.
"""

import math
from collections.abc import Callable, Mapping

import mujoco
import numpy as np

from motorprior.bench.dynamometer import Trial
from motorprior.exports.exporter import ConstantArrays, one_motor
from motorprior.exports.mjcf_document import Element, Mjcf, number

# constants that a plain joint cannot express
NOT_EXPRESSED = (
    "velocity_filter",
    "stribeck_torque",
    "load_friction",
    "gear_stiffness",
    "backlash",
    "gear_damping",
)
# parameter of a plain joint -> constant of a motor and its unit
PARAMETERS = {
    "armature": ("armature", "kg·m²"),
    "damping": ("viscous_damping", "N·m·s/rad"),
    "frictionloss": ("friction", "N·m"),
    "kp": ("kp", "N·m/rad"),
    "kv": ("kd", "N·m·s/rad"),
    "forcerange": ("torque_limit", "N·m"),
    "delay": ("delay", "s"),
    "offset": ("encoder_zero", "rad"),
}
PASSIVE = ("armature", "damping", "frictionloss")  # attributes of a joint that a motor determines

MIN_STEP = 0.0005  # shortest physics step for which the delay lines are long enough [s]
# integers, since an enumeration of MuJoCo 4 does not equal a numpy integer
_NOT_INTEGRATED = [
    int(getattr(mujoco.mjtDyn, f"mjDYN_{name}")) for name in ("NONE", "FILTER", "FILTEREXACT")
]
# writes one motor, given by its constants by name, at a joint
WriteMotor = Callable[[Mjcf, str, Mapping[str, float]], None]


def write_plain(mjcf: Mjcf, joint: str, values: Mapping[str, float]) -> None:
    """Write one motor as attributes of its joint and a position actuator."""
    element = mjcf.joint(joint)
    for attribute in PASSIVE:
        constant, _ = PARAMETERS[attribute]
        element.setAttribute(attribute, number(values[constant]))

    attributes = servo(values, values["kd"], mjcf.compiled.opt.timestep)
    drive(mjcf, joint, joint, attributes)


def servo(values: Mapping[str, float], kv: float, timestep: float) -> dict[str, str]:
    """Attributes of an actuator that is a delayed servo.

    Its force for the control u is clip(F, ±torque_limit) with

        F = kp·(u - q - encoder_zero) - kv·dq    for position targets
        F = kd·u - kv·dq                         for velocity targets, if kp is 0
        F = u                                    for torques, if kp and kd are 0

    A ``position`` actuator is the first without the encoder zero.
    """
    kp = values["kp"]
    gain = kp or values["kd"] or 1.0
    control_law = {
        "dyntype": "none",
        "gaintype": "fixed",
        "gainprm": number(gain),
        "biastype": "affine",
        "biasprm": number(-kp * values["encoder_zero"], -kp, -kv),
        "ctrllimited": "false",
        "gear": "1",
    }

    limit = values["torque_limit"]
    if math.isfinite(limit):
        force_limits = {"forcelimited": "true", "forcerange": number(-limit, limit)}
    else:  # also if the model's defaults limit forces
        force_limits = {"forcelimited": "false"}

    # our targets are means from half a step before to half a step after now; MuJoCo's minimum delay
    # is one step
    delay = max(values["delay"] + 0.5 * timestep, timestep)
    # linear interpolation reads the sample before, too
    samples = math.ceil(delay / min(timestep, MIN_STEP)) + 2
    delay_line = {"nsample": str(samples), "interp": "linear", "delay": number(delay)}
    return control_law | force_limits | delay_line


def drive(mjcf: Mjcf, joint: str, driven: str, attributes: dict[str, str]) -> None:
    """Replace the actuator of ``joint`` by a servo of the joint ``driven``, or add a servo.

    The servo gets the name of the actuator that it replaces. It keeps the range and the controls of
    a position servo; other controls in keyframes become the joint's angle, or 0 if the servo
    follows velocities or torques.
    """
    model = mjcf.compiled
    joint_address = model.joint(joint).qposadr[0]
    follows_angles = follows_positions(attributes)
    angles = [number(angle * follows_angles) for angle in model.key_qpos[:, joint_address]]

    old_actuator = mjcf.actuator_of(joint)
    if old_actuator is None:
        section = mjcf.section("actuator")
        mjcf.add(section, "general", name=joint, joint=driven, **attributes)
        mjcf.edit_keyframes("ctrl", lambda words, key: words.append(angles[key]))
        return

    element, index = old_actuator
    if follows_angles and _is_position_servo(model, index):
        if model.actuator_ctrllimited[index]:
            attributes["ctrllimited"] = "true"
            attributes["ctrlrange"] = number(*model.actuator_ctrlrange[index])
    else:
        # MuJoCo 4 has actuators without control
        addresses = getattr(model, "actuator_ctrladr", range(model.nu))
        address = addresses[index]
        mjcf.edit_keyframes("ctrl", lambda words, key: words.__setitem__(address, angles[key]))

    _drop_activations(mjcf, index)
    _replace(mjcf, element, element.getAttribute("name") or joint, driven, attributes)


def follows_positions(attributes: Mapping[str, str]) -> bool:
    """Whether the control of a `servo` is an angle."""
    return float(attributes["biasprm"].split()[1]) != 0.0


def _is_position_servo(model: mujoco.MjModel, index: int) -> bool:
    """Whether the control of an actuator is an angle of its joint."""
    is_affine = model.actuator_gainprm[index, 0] == -model.actuator_biasprm[index, 1] != 0.0
    is_direct = model.actuator_dyntype[index] in _NOT_INTEGRATED
    has_unit_gear = model.actuator_gear[index, 0] == 1.0
    return bool(is_affine and is_direct and has_unit_gear)


def _drop_activations(mjcf: Mjcf, index: int) -> None:
    """Remove the activations of an actuator from the keyframes."""
    count = int(mjcf.compiled.actuator_actnum[index])
    if count <= 0:
        return
    address = int(mjcf.compiled.actuator_actadr[index])
    # activations of other actuators may be gone already
    first = address - sum(dropped < address for dropped in mjcf.dropped)
    mjcf.edit_keyframes("act", lambda words, _: words.__delitem__(slice(first, first + count)))
    mjcf.dropped += tuple(range(address, address + count))


def _replace(
    mjcf: Mjcf, element: Element, name: str, driven: str, attributes: dict[str, str]
) -> None:
    actuator = mjcf.element("general", name=name, joint=driven, **attributes)
    element.parentNode.replaceChild(actuator, element)


RIG = """<mujoco>
  <compiler angle="radian"/>
  <option timestep="{dt!r}" integrator="implicitfast" gravity="0 0 0"/>
  <worldbody>
    <body name="link">
      <inertial pos="0 0 0" mass="1" diaginertia="{inertia!r} {inertia!r} {inertia!r}"/>
      <joint name="joint" axis="0 1 0"/>
    </body>
  </worldbody>
</mujoco>
"""


def replayed(values: ConstantArrays, trial: Trial, write: WriteMotor) -> np.ndarray:
    """(steps, n) joint angles [rad] of motors that ``write`` has written into RIG."""
    angles = np.zeros_like(trial.position_target)
    for motor in range(len(trial.load_inertia)):
        angles[:, motor] = _replayed_motor(one_motor(values, motor), trial, motor, write)
    return angles


def _replayed_motor(
    values: Mapping[str, float], trial: Trial, motor: int, write: WriteMotor
) -> np.ndarray:
    """(steps,) joint angles [rad] of one motor of a trial."""
    assert trial.load_stiffness is not None
    mjcf = Mjcf.read(RIG.format(dt=trial.dt, inertia=float(trial.load_inertia[motor])))
    write(mjcf, "joint", values)
    model = mujoco.MjModel.from_xml_string(mjcf.text())
    data = mujoco.MjData(model)

    data.qpos[:] = trial.position_target[0, motor]
    commands = _commands(values, trial)[:, motor]
    for actuator in range(len(model.actuator_history)):
        fill_delay_line(model, data, actuator, commands[0])

    joint = data.joint("joint")
    angles = np.zeros(len(commands))
    for step, command in enumerate(commands):
        angle = joint.qpos[0]
        angles[step] = angle
        data.ctrl[0] = command
        external = trial.external_torque[step, motor]
        joint.qfrc_applied[0] = external + trial.load_stiffness[step, motor] * angle
        mujoco.mj_step(model, data)
    return angles


def _commands(values: Mapping[str, float], trial: Trial) -> np.ndarray:
    """(steps, n) controls of the `servo` of a motor."""
    if values["kp"]:
        return trial.position_target
    assert trial.frames is not None
    commands = trial.frames.velocity_target if values["kd"] else trial.frames.torque_feedforward
    return np.broadcast_to(commands, trial.position_target.shape)


def fill_delay_line(
    model: mujoco.MjModel, data: mujoco.MjData, actuator: int, target: float
) -> None:
    """Fill the delay line of an actuator, if it has one, with a control that has never changed."""
    samples = int(model.actuator_history[actuator, 0])
    if samples:
        times = model.opt.timestep * np.arange(-samples, 0.0)
        mujoco.mj_initCtrlHistory(model, data, actuator, times, np.full(samples, target))
