"""Format mjcf-detailed: the user's MJCF with rotor and play as joints of their own.

Any simulator that reads MJCF version 4 can read it. Per joint, next to the link that it moves:

    NAME_rotor   hinge with the armature, viscous damping and dry friction of the motor; its angle θ
                 is the encoder's
    NAME_gear    tendon θ - joint with stiffness, damping, and the backlash as a dead band about the
                 encoder zero

The actuator is a servo kp·(u - θ) with delay. A second one, a `dcmotor` without input, has the
resistance 1/kd, the torque constant 1 and the electric time constant of the velocity filter: its
shorted winding brakes the rotor by kd·filtered velocity. MuJoCo limits the sum of both to the
torque limit (``actuatorfrcrange``), as our control law does. A damper outside of the actuators,
such as a Maxwell element, would not be limited.

An integrator that does not damp tendons implicitly is changed to implicitfast, and the damping of
a gear is limited, since MuJoCo turns it into inertia. A motor whose gear
is too stiff for the timestep becomes a plain joint, as in the format mjcf.
"""

import math
from collections.abc import Mapping
from functools import partial
from typing import Any

import mujoco
import numpy as np

from motorprior.exports.exporter import Exporter
from motorprior.exports.mjcf import write_variants
from motorprior.exports.mjcf_document import Element, Mjcf, number
from motorprior.exports.plain_joint import PASSIVE, drive, replayed, servo, write_plain

# integrators that damp tendons implicitly; Euler makes stiff gears on light links unstable
IMPLICIT = (mujoco.mjtIntegrator.mjINT_IMPLICIT, mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
# maximum gear_stiffness·h²/armature: MuJoCo's explicit spring of a stiffer gear is unstable on a
# light link
MAX_STIFFNESS = 0.25
# maximum gear_damping/(gear_stiffness·h): MuJoCo treats a tendon's damping implicitly, but without
# the coupling of rotor and link, which adds h·gear_damping to the inertia of both
MAX_DAMPING = 0.25


def write_detailed(mjcf: Mjcf, joint: str, values: Mapping[str, float]) -> None:
    """Write one motor at a joint."""
    option = mjcf.compiled.opt
    if too_stiff(values, option.timestep):
        write_plain(mjcf, joint, values)
        return

    element = mjcf.joint(joint)
    for attribute in PASSIVE:
        element.setAttribute(attribute, "0")
    rotor = f"{joint}_rotor"
    _add_rotor(mjcf, joint, rotor, values)
    _add_gear(mjcf, joint, rotor, values, option.timestep)

    # the sum of servo and brake is limited, not the servo
    at_rotor = {**values, "encoder_zero": 0.0, "torque_limit": math.inf}
    drive(mjcf, joint, rotor, servo(at_rotor, 0.0, option.timestep))
    if values["kd"]:
        _add_brake(mjcf, joint, rotor, values)

    if option.integrator not in IMPLICIT:
        mjcf.section("option").setAttribute("integrator", "implicitfast")


def too_stiff(values: Mapping[str, Any], timestep: float) -> Any:
    """Whether gears are too stiff for a timestep [s]; such motors become plain joints."""
    return values["gear_stiffness"] * timestep**2 > MAX_STIFFNESS * values["armature"]


def _add_gear(
    mjcf: Mjcf, joint: str, rotor: str, values: Mapping[str, float], timestep: float
) -> None:
    """Add the tendon between rotor and joint, whose dead band is the backlash."""
    stiffness = values["gear_stiffness"]
    damping = min(values["gear_damping"], MAX_DAMPING * stiffness * timestep)
    low = values["encoder_zero"] - 0.5 * values["backlash"]
    high = values["encoder_zero"] + 0.5 * values["backlash"]
    gear = mjcf.add(
        mjcf.section("tendon"),
        "fixed",
        name=f"{joint}_gear",
        stiffness=number(stiffness),
        damping=number(damping),
        springlength=number(low, high),
    )
    mjcf.add(gear, "joint", joint=rotor, coef="1")
    mjcf.add(gear, "joint", joint=joint, coef="-1")


def _add_brake(mjcf: Mjcf, joint: str, rotor: str, values: Mapping[str, float]) -> None:
    """Add the shorted winding that brakes the rotor, after all other actuators."""
    # in a section of its own at the end, so that the indices of other actuators stay
    section = mjcf.add(mjcf.document.documentElement, "actuator")
    mjcf.add(
        section,
        "dcmotor",
        name=f"{joint}_brake",
        joint=rotor,
        input="none",
        motorconst="1",
        resistance=number(1.0 / values["kd"]),
        inductance=number(0.0, values["velocity_filter"]),
    )
    # its activation, the current, is the last one
    mjcf.edit_keyframes("act", lambda words, _: words.append("0"))


def _add_rotor(mjcf: Mjcf, joint_name: str, rotor: str, values: Mapping[str, float]) -> None:
    """Add a rotor with a hinge along the axis of a joint, in the frame of the link that moves."""
    model = mjcf.compiled
    joint = model.joint(joint_name)
    link = model.body(int(joint.bodyid[0]))
    link_element = _outermost_element(mjcf.joint(joint_name))
    rotor_element = mjcf.add(
        link_element.parentNode,
        "body",
        link_element,
        name=rotor,
        pos=number(*link.pos),
        quat=number(*link.quat),
    )
    mjcf.add(rotor_element, "inertial", pos="0 0 0", mass="1e-6", diaginertia="1e-10 1e-10 1e-10")

    start = float(model.qpos0[joint.qposadr[0]]) + values["encoder_zero"]
    limit = values["torque_limit"]
    mjcf.add(
        rotor_element,
        "joint",
        name=rotor,
        type="hinge",
        pos=number(*joint.pos),
        axis=number(*joint.axis),
        armature=number(values["armature"]),
        damping=number(values["viscous_damping"]),
        frictionloss=number(values["friction"]),
        ref=number(math.degrees(start) if mjcf.in_degrees else start),
        limited="false",
        stiffness="0",
        actuatorfrclimited="true",
        actuatorfrcrange=number(-limit, limit),
    )
    _add_to_keyframes(mjcf, joint, link_element, values["encoder_zero"])


def _outermost_element(joint_element: Element) -> Element:
    """The link of a joint, or the outermost <frame> around the link."""
    element = joint_element.parentNode
    while element.nodeName != "body":  # a joint may stand in a <frame>
        element = element.parentNode
    while element.parentNode.nodeName == "frame":  # as may its link
        element = element.parentNode
    return element


def _add_to_keyframes(mjcf: Mjcf, joint: Any, link_element: Element, encoder_zero: float) -> None:
    """Insert angle and velocity of a new rotor into the keyframes."""
    model = mjcf.compiled

    # the rotor stands before the joints of its link, or of the first link in the frame
    link_id = joint.bodyid[0]
    if link_element.nodeName == "frame":
        links = link_element.getElementsByTagName("body")
        first_name = links[0].getAttribute("name") if links else ""
        if first_name:
            link_id = model.body(first_name).id
    first_joint = int(np.searchsorted(model.jnt_bodyid, link_id))

    # rotors of the same link stand in the order of their writing
    earlier_rotors = sum(joint <= first_joint for joint in mjcf.rotors)
    at_pos = int(model.jnt_qposadr[first_joint]) + earlier_rotors
    at_vel = int(model.jnt_dofadr[first_joint]) + earlier_rotors

    joint_angles = model.key_qpos[:, joint.qposadr[0]]
    rotor_angles = [number(angle + encoder_zero) for angle in joint_angles]
    mjcf.edit_keyframes("qpos", lambda words, key: words.insert(at_pos, rotor_angles[key]))
    mjcf.edit_keyframes("qvel", lambda words, _: words.insert(at_vel, "0"))
    mjcf.rotors += (first_joint,)


DETAILED = Exporter(
    name="mjcf-detailed",
    not_expressed=("stribeck_torque", "load_friction"),
    write=partial(write_variants, write=write_detailed),
    replay=partial(replayed, write=write_detailed),
    needs_model=True,
    min_mujoco=4,
    is_written_as_plain_joint=too_stiff,
)
