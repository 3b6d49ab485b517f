"""The user's MJCF with rotor and play as joints of their own, for any simulator that reads MJCF version 4.

Per joint, next to the body that it moves:

    NAME_rotor   hinge with the armature, viscous damping and dry friction of the motor; its angle θ is the encoder's
    NAME_gear    tendon θ - joint with stiffness, damping, and the backlash as a dead band about the encoder zero

The actuator is a servo kp·(u - θ) with delay. A second one, a `dcmotor` without input, has the resistance 1/kd, the
torque constant 1 and the electric time constant of the velocity filter: its shorted winding brakes the rotor by
kd·filtered velocity. MuJoCo limits the sum of both to the torque limit (``actuatorfrcrange``), as our law does. A
damper outside of the actuators, such as a Maxwell element, would not be limited. An integrator that does not damp
tendons implicitly is changed to implicitfast.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from motorprior.exports.exporter import Constants, Exporter, Request
from motorprior.exports.mjcf_text import MjcfText
from motorprior.exports.plain_joint import drive, dry_friction, number, replayed, servo, write_variants

# integrators that damp tendons implicitly; Euler makes stiff gears on light links unstable
IMPLICIT = (mujoco.mjtIntegrator.mjINT_IMPLICIT, mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
_INERTIAL = '<inertial pos="0 0 0" mass="1e-6" diaginertia="1e-10 1e-10 1e-10"/>'
_FREE = 'limited="false" stiffness="0"'


def write_detailed(text: MjcfText, joint: str, values: Constants) -> None:
    """One motor at a joint."""
    v = {name: float(value) for name, value in values.items()}
    text.set(text.joint(joint), {"armature": "0", "damping": "0", "frictionloss": "0"})
    rotor = {
        "armature": v["armature"], "damping": v["viscous_damping"], "frictionloss": float(dry_friction(values)),
        "ref": v["encoder_zero"],
    }  # fmt: skip
    text.insert_before_body_of(text.joint(joint), [_hinge(text, joint, rotor, v["torque_limit"])])
    ends = " ".join(number(v["encoder_zero"] + side * 0.5 * v["backlash"]) for side in (-1.0, 1.0))
    gear = f'stiffness="{number(v["gear_stiffness"])}" damping="{number(v["gear_damping"])}" springlength="{ends}"'
    joints = f'<joint joint="{joint}_rotor" coef="1"/><joint joint="{joint}" coef="-1"/>'
    text.insert_in("tendon", [f'<fixed name="{joint}_gear" {gear}>{joints}</fixed>'])
    at_rotor = {**values, "encoder_zero": np.zeros(()), "torque_limit": np.inf}  # the sum is limited, not the servo
    drive(text, joint, f"{joint}_rotor", "general", servo(at_rotor, 0.0, text.timestep))
    brake = {"motorconst": "1", "resistance": number(1.0 / v["kd"]), "inductance": f"0 {number(v['velocity_filter'])}"}
    attributes = " ".join(f'{name}="{value}"' for name, value in brake.items())
    brake_tag = f'<dcmotor name="{joint}_brake" joint="{joint}_rotor" input="none" {attributes}/>'
    text.insert_in("actuator", [brake_tag], apart=True)  # after the others, whose indices stay
    if text.compiled.opt.integrator not in IMPLICIT:
        text.set_option("integrator", "implicitfast")


def _hinge(text: MjcfText, joint: str, attributes: dict[str, float], limit: float) -> str:
    """The rotor: a body with a hinge along the axis of a joint, in the frame of the body that the joint moves."""
    model = text.compiled
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint)
    body = model.jnt_bodyid[index]
    place = f'pos="{_numbers(model.body_pos[body])}" quat="{_numbers(model.body_quat[body])}"'
    axis = f'pos="{_numbers(model.jnt_pos[index])}" axis="{_numbers(model.jnt_axis[index])}"'
    given = " ".join(f'{name}="{number(value)}"' for name, value in attributes.items())
    force = f'actuatorfrclimited="true" actuatorfrcrange="{number(-limit)} {number(limit)}"'
    hinge = f'<joint name="{joint}_rotor" type="hinge" {axis} {given} {_FREE} {force}/>'
    return f'<body name="{joint}_rotor" {place}>{_INERTIAL}{hinge}</body>'


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:.9g}" for value in values)


def write(request: Request) -> list[Path]:
    """K variants of the model, and motors.json."""
    return write_variants(request, write_detailed)


EXPORTER = Exporter(
    "mjcf-detailed", "MJCF with rotor and play", ("stribeck_torque", "load_friction"), write,
    replay=lambda values, given: replayed(values, given, write_detailed), needs_model=True,
    mujoco=4,
)  # fmt: skip
