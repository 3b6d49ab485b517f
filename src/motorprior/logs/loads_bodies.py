"""Rigid bodies that the loads of a log come from, and the torque of gravity in any direction.

A log with loads by a robot's model keeps the bodies as an MJCF of joints and inertias. A fit can
therefore ask what the loads would be on a tilted base, or if the zero of a joint were another one.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs; it is imported where it is used, since a robot's own computer has
# none.
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from motorprior.logs.motor_log import MotorLog

# rows between two computed ones: a lever changes slowly
_STRIDE = 5


@dataclass(frozen=True)
class GravityLevers:
    """Torque of gravity on J joints in T rows: ``lever·g`` for the acceleration g (3,) [m/s²].

    Vectors are in the frame of the base.
    """

    lever: np.ndarray  # (T, J, 3) mass·(axis × arm) of what a joint carries [kg·m]
    slope: np.ndarray  # (T, J, 3) its derivative with respect to the joint's angle [kg·m/rad]
    axis: np.ndarray  # (T, J, 3) axis of the joint, 0 for a slide
    carries: np.ndarray  # (J, J) whether joint k carries joint j, [k, j]; a joint carries itself


def bodies_of(model: Any) -> str:
    """MJCF of the joints and inertias of a compiled model."""
    children: dict[int, list[int]] = {}
    for body in range(1, model.nbody):
        children.setdefault(int(model.body_parentid[body]), []).append(body)
    bodies = "".join(_body(model, body, children) for body in children.get(0, []))
    return f'<mujoco><compiler angle="radian"/><worldbody>{bodies}</worldbody></mujoco>'


def _body(model: Any, body: int, children: dict[int, list[int]]) -> str:
    """MJCF of a body and of all bodies that it carries."""
    elements = []
    if model.body_mass[body] > 0.0:
        inertia = (
            f'mass="{model.body_mass[body]:.9g}" {_vector("diaginertia", model.body_inertia[body])}'
        )
        pose = f"{_vector('pos', model.body_ipos[body])} {_vector('quat', model.body_iquat[body])}"
        elements.append(f"<inertial {pose} {inertia}/>")

    first = int(model.body_jntadr[body])
    for joint in range(first, first + int(model.body_jntnum[body])):
        joint_type = "slide" if model.jnt_type[joint] == 2 else "hinge"
        axis = _vector("axis", model.jnt_axis[joint])
        place = _vector("pos", model.jnt_pos[joint])
        name = quoteattr(model.joint(joint).name)
        elements.append(f'<joint name={name} type="{joint_type}" {axis} {place}/>')

    elements += [_body(model, child, children) for child in children.get(body, [])]
    pose = f"{_vector('pos', model.body_pos[body])} {_vector('quat', model.body_quat[body])}"
    return f"<body {pose}>{''.join(elements)}</body>"


def _vector(name: str, values: Sequence[float]) -> str:
    return f'{name}="{" ".join(f"{value:.9g}" for value in values)}"'


def gravity_levers(log: MotorLog) -> GravityLevers | None:
    """Levers of gravity at the recorded angles; None for loads that come from elsewhere."""
    if not log.bodies:
        return None
    import mujoco

    model = mujoco.MjModel.from_xml_string(log.bodies)
    data = mujoco.MjData(model)
    names = [model.joint(joint).name for joint in range(model.njnt)]
    if set(names) != set(log.joint_names):
        return None  # some joints were left out since the loads were computed

    order = [names.index(name) for name in log.joint_names]
    mass = model.body_subtreemass[model.jnt_bodyid][:, None]
    is_hinge = (model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE)[:, None]

    shape = (log.num_rows, log.num_joints, 3)
    rows = np.unique([*range(0, log.num_rows, _STRIDE), log.num_rows - 1])
    lever = np.empty((len(rows), *shape[1:]))
    slope = np.empty_like(lever)
    axis = np.empty_like(lever)
    for index, row in enumerate(rows):
        data.qpos[order] = log.joint_pos[row]
        mujoco.mj_fwdPosition(model, data)
        arm = data.subtree_com[model.jnt_bodyid] - data.xanchor
        hinge_lever = mass * np.cross(data.xaxis, arm)
        lever[index] = np.where(is_hinge, hinge_lever, mass * data.xaxis)[order]
        slope[index] = np.where(is_hinge, np.cross(data.xaxis, hinge_lever), 0.0)[order]
        axis[index] = np.where(is_hinge, data.xaxis, 0.0)[order]

    carries = np.zeros((len(order), len(order)), bool)
    for k, carrier in enumerate(order):
        for j, joint in enumerate(order):
            carries[k, j] = _is_ancestor(model, carrier, joint)
    every_row = np.arange(log.num_rows)
    nearest = np.clip(np.searchsorted(rows, every_row), 0, len(rows) - 1)
    return GravityLevers(lever[nearest], slope[nearest], axis[nearest], carries)


def _is_ancestor(model: Any, carrier: int, joint: int) -> bool:
    """Whether a joint's body is carried by the body of the joint ``carrier``, or is that body."""
    body = int(model.jnt_bodyid[joint])
    while body > 0:
        if body == model.jnt_bodyid[carrier]:
            return True
        body = int(model.body_parentid[body])
    return False
