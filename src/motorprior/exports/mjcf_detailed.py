"""The user's MJCF with rotor and play as joints of their own, for any simulator that reads MJCF version 4.

Per joint, next to the body that it moves:

    NAME_rotor   hinge with the armature, viscous damping and dry friction of the motor; its angle θ is the encoder's
    NAME_gear    tendon θ - joint with stiffness, damping, and the backlash as a dead band about the encoder zero

The actuator is a servo kp·(u - θ) with delay. A second one, a `dcmotor` without input, has the
resistance 1/kd, the torque constant 1 and the electric time constant of the velocity filter: its
shorted winding brakes the rotor by kd·filtered velocity. MuJoCo limits the sum of both to the
torque limit (``actuatorfrcrange``), as our control law does. A damper outside of the actuators,
such as a Maxwell element, would not be limited. An integrator that does not damp tendons implicitly
is changed to implicitfast. A motor whose gear is too stiff for the timestep becomes a plain joint,
as in the format mjcf.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
import math
from collections.abc import Mapping
from functools import partial
from typing import Any

import mujoco
import numpy as np

from motorprior.exports.exporter import Exporter
from motorprior.exports.mjcf import Mjcf, number
from motorprior.exports.plain_joint import (
    PASSIVE,
    drive,
    replayed,
    servo,
    write_plain,
    write_variants,
)

# integrators that damp tendons implicitly; Euler makes stiff gears on light links unstable
IMPLICIT = (mujoco.mjtIntegrator.mjINT_IMPLICIT, mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
# maximum gear_stiffness·h²/armature: MuJoCo's explicit spring of a stiffer gear is unstable on a
# light link
MAX_STIFFNESS = 0.25


def too_stiff(values: Mapping[str, Any], timestep: float) -> Any:
    """Whether gears are too stiff for a timestep [s]; such motors become plain joints."""
    return values["gear_stiffness"] * timestep**2 > MAX_STIFFNESS * values["armature"]


def write_detailed(mjcf: Mjcf, joint: str, values: Mapping[str, float]) -> None:
    """One motor at a joint."""
    option = mjcf.compiled.opt
    if too_stiff(values, option.timestep):
        write_plain(mjcf, joint, values)
        return
    rotor = f"{joint}_rotor"
    for name in PASSIVE:
        mjcf.joint(joint).setAttribute(name, "0")
    _add_rotor(mjcf, joint, rotor, values)
    ends = (values["encoder_zero"] + side * 0.5 * values["backlash"] for side in (-1.0, 1.0))
    gear = mjcf.add(
        mjcf.section("tendon"),
        "fixed",
        name=f"{joint}_gear",
        stiffness=number(values["gear_stiffness"]),
        damping=number(values["gear_damping"]),
        springlength=number(*ends),
    )
    mjcf.add(gear, "joint", joint=rotor, coef="1")
    mjcf.add(gear, "joint", joint=joint, coef="-1")
    # the sum is limited, not the servo
    at_rotor = {**values, "encoder_zero": 0.0, "torque_limit": math.inf}
    drive(mjcf, joint, rotor, servo(at_rotor, 0.0, option.timestep))
    last = mjcf.add(mjcf.document.documentElement, "actuator")  # the indices of others stay
    mjcf.add(
        last,
        "dcmotor",
        name=f"{joint}_brake",
        joint=rotor,
        input="none",
        motorconst="1",
        resistance=number(1.0 / values["kd"]),
        inductance=number(0.0, values["velocity_filter"]),
    )
    # of the brake, the last actuator
    mjcf.edit_keyframes("act", lambda words, _: words.append("0"))
    if option.integrator not in IMPLICIT:
        mjcf.section("option").setAttribute("integrator", "implicitfast")


def _add_rotor(mjcf: Mjcf, joint: str, rotor: str, values: Mapping[str, float]) -> None:
    """Add a body with a hinge along the axis of a joint, in the frame of the body that the joint moves."""
    model = mjcf.compiled
    moved = mjcf.joint(joint).parentNode
    found = model.joint(joint)
    while moved.nodeName != "body":  # a joint may stand in a <frame>, as may its body
        moved = moved.parentNode
    while moved.parentNode.nodeName == "frame":
        moved = moved.parentNode
    frame = model.body(int(found.bodyid[0]))
    body = mjcf.add(
        moved.parentNode,
        "body",
        moved,
        name=rotor,
        pos=number(*frame.pos),
        quat=number(*frame.quat),
    )
    start = float(model.qpos0[found.qposadr[0]]) + values["encoder_zero"]
    mjcf.add(body, "inertial", pos="0 0 0", mass="1e-6", diaginertia="1e-10 1e-10 1e-10")
    mjcf.add(
        body,
        "joint",
        name=rotor,
        type="hinge",
        pos=number(*found.pos),
        axis=number(*found.axis),
        armature=number(values["armature"]),
        damping=number(values["viscous_damping"]),
        frictionloss=number(values["friction"]),
        ref=number(math.degrees(start) if mjcf.in_degrees else start),
        limited="false",
        stiffness="0",
        actuatorfrclimited="true",
        actuatorfrcrange=number(-values["torque_limit"], values["torque_limit"]),
    )
    # the joints before which the rotor stands: of its own body, or of the first one in the frame
    name = next((each.getAttribute("name") for each in moved.getElementsByTagName("body")), "")
    body_id = model.body(name).id if moved.nodeName == "frame" and name else found.bodyid[0]
    first = int(np.searchsorted(model.jnt_bodyid, body_id))
    # rotors of the same body stand in the order of their writing
    before = sum(other <= first for other in mjcf.rotors)
    angles = [
        number(angle + values["encoder_zero"]) for angle in model.key_qpos[:, found.qposadr[0]]
    ]
    at_pos, at_vel = (int(each[first]) + before for each in (model.jnt_qposadr, model.jnt_dofadr))
    mjcf.edit_keyframes("qpos", lambda words, key: words.insert(at_pos, angles[key]))
    mjcf.edit_keyframes("qvel", lambda words, _: words.insert(at_vel, "0"))
    mjcf.rotors += (first,)


DETAILED = Exporter(
    "mjcf-detailed", ("stribeck_torque", "load_friction"), partial(write_variants, write=write_detailed),
    partial(replayed, write=write_detailed), needs_model=True, mujoco=4, becomes_plain=too_stiff,
)  # fmt: skip
