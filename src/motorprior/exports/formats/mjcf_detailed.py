"""The user's MJCF with rotor and play as joints of their own, for any simulator that reads MJCF version 4.

Per joint, next to the body that it moves:

    NAME_rotor   hinge with the armature, viscous damping and dry friction of the motor; its angle θ is the encoder's
    NAME_gear    tendon θ - joint with stiffness, damping, and the backlash as a dead band about the encoder zero

The actuator is a servo kp·(u - θ) with delay. A second one, a `dcmotor` without input, has the resistance 1/kd, the
torque constant 1 and the electric time constant of the velocity filter: its shorted winding brakes the rotor by
kd·filtered velocity. MuJoCo limits the sum of both to the torque limit (``actuatorfrcrange``), as our law does. A
damper outside of the actuators, such as a Maxwell element, would not be limited. An integrator that does not damp
tendons implicitly is changed to implicitfast. A motor whose gear is too stiff for the timestep becomes a plain joint,
as of the format mjcf.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial

import mujoco
import numpy as np

from motorprior.exports.exporter import Exporter
from motorprior.exports.mjcf_text import MjcfText, attribute_text
from motorprior.exports.plain_joint import drive, dry_friction, number, replayed, servo, write_plain, write_variants

# integrators that damp tendons implicitly; Euler makes stiff gears on light links unstable
IMPLICIT = (mujoco.mjtIntegrator.mjINT_IMPLICIT, mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
# of gear_stiffness·h²/armature: MuJoCo's explicit spring of a stiffer gear would be unstable on a light link
MAX_STIFFNESS = 0.25
_INERTIAL = '<inertial pos="0 0 0" mass="1e-6" diaginertia="1e-10 1e-10 1e-10"/>'


def write_detailed(text: MjcfText, joint: str, values: Mapping[str, float]) -> None:
    """One motor at a joint."""
    if values["gear_stiffness"] * text.compiled.opt.timestep**2 > MAX_STIFFNESS * values["armature"]:
        write_plain(text, joint, values)
        return
    text.set(text.joint(joint), {"armature": "0", "damping": "0", "frictionloss": "0"})
    text.insert_before_body_of(text.joint(joint), _rotor(text, joint, values))
    ends = " ".join(number(values["encoder_zero"] + side * 0.5 * values["backlash"]) for side in (-1.0, 1.0))
    stiffness, damping = number(values["gear_stiffness"]), number(values["gear_damping"])
    gear = f'stiffness="{stiffness}" damping="{damping}" springlength="{ends}"'
    joints = f'<joint joint="{joint}_rotor" coef="1"/><joint joint="{joint}" coef="-1"/>'
    text.insert_in("tendon", f'<fixed name="{joint}_gear" {gear}>{joints}</fixed>')
    at_rotor = {**values, "encoder_zero": 0.0, "torque_limit": math.inf}  # the sum is limited, not the servo
    drive(text, joint, f"{joint}_rotor", servo(at_rotor, 0.0, text.compiled.opt.timestep))
    winding = {"resistance": number(1.0 / values["kd"]), "inductance": f"0 {number(values['velocity_filter'])}"}
    brake = f'<dcmotor name="{joint}_brake" joint="{joint}_rotor" input="none" motorconst="1"'
    text.insert_in("actuator", f"{brake} {attribute_text(winding)}/>", apart=True)  # last: the indices of others stay
    if text.compiled.opt.integrator not in IMPLICIT:
        text.set_option("integrator", "implicitfast")


def _rotor(text: MjcfText, joint: str, values: Mapping[str, float]) -> str:
    """A body with a hinge along the axis of a joint, in the frame of the body that the joint moves."""
    found = text.compiled.joint(joint)
    body, limit = text.compiled.body(int(found.bodyid[0])), number(values["torque_limit"])
    own = {
        "pos": _numbers(found.pos), "axis": _numbers(found.axis), "armature": number(values["armature"]),
        "damping": number(values["viscous_damping"]), "frictionloss": number(dry_friction(values)),
        "ref": number(values["encoder_zero"]), "limited": "false", "stiffness": "0",
        "actuatorfrclimited": "true", "actuatorfrcrange": f"-{limit} {limit}",
    }  # fmt: skip
    hinge = f'<joint name="{joint}_rotor" type="hinge" {attribute_text(own)}/>'
    place = attribute_text({"pos": _numbers(body.pos), "quat": _numbers(body.quat)})
    return f'<body name="{joint}_rotor" {place}>{_INERTIAL}{hinge}</body>'


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:.9g}" for value in values)


EXPORTER = Exporter(
    "mjcf-detailed", ("stribeck_torque", "load_friction"), partial(write_variants, write=write_detailed),
    partial(replayed, write=write_detailed), needs_model=True, mujoco=4,
)  # fmt: skip
