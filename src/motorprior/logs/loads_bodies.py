"""Rigid bodies that the loads of a log come from, and the torque of gravity in any direction.

A log with loads by a robot's model keeps the bodies as an MJCF of joints and inertias. A fit can
therefore ask what the loads would be on a tilted base, if the zero of a joint were another one, or
if a link had a part that the model lacks.
"""

# MuJoCo is imported where it is used, since a robot's own computer has none.
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from motorprior.logs.loads_dynamics import BodyDynamics, gravity_in_base, make_inertia_constant
from motorprior.logs.motor_log import MotorLog
from motorprior.robots.robot import GRAVITY

# rows between two computed ones: a lever changes slowly
_STRIDE = 5
# angles at which the loads of a turned joint are interpolated [rad]
_TURNS = np.array([-0.5, -0.25, 0.25, 0.5])
TURN_POWERS = len(_TURNS)
_MIN_DISTANCE = 1e-3  # of the centre of mass of a link from its joint [m]


@dataclass(frozen=True)
class GravityLevers:
    """Torque of gravity on J joints in T rows: ``lever·g`` for the acceleration g (3,) [m/s²].

    Vectors are in the frame of the base.
    """

    lever: np.ndarray  # (T, J, 3) mass·(axis × arm) of what a joint carries [kg·m]
    slope: np.ndarray  # (T, J, 3) its derivative with respect to the joint's angle [kg·m/rad]
    carries: np.ndarray  # (J, J) whether joint k carries joint j, [k, j]; a joint carries itself


@dataclass(frozen=True)
class LinkMass:
    """Loads of a point mass on the link of one joint, on J joints in T rows.

    The mass is μ·``mass``, at the distance d·``reach`` from the joint, in the direction of the
    link's centre of mass. Each load is μ·(c₀ + c₁·d + c₂·d²), with the definitions of `loads`.
    """

    mass: float  # of what the joint carries [kg]
    reach: float  # twice the distance of the link's centre of mass from the joint [m]
    inertia: np.ndarray  # (T, J, 3) coefficients c of load_inertia [kg·m²]
    external: np.ndarray  # (T, J, 3) of external_torque [N·m]
    stiffness: np.ndarray  # (T, J, 3) of load_stiffness [N·m/rad]


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
    compiled = _compiled(log)
    if compiled is None:
        return None
    import mujoco

    model, order = compiled
    data = mujoco.MjData(model)
    mass = model.body_subtreemass[model.jnt_bodyid][:, None]
    is_hinge = (model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE)[:, None]

    shape = (log.num_rows, log.num_joints, 3)
    rows = np.unique([*range(0, log.num_rows, _STRIDE), log.num_rows - 1])
    lever = np.empty((len(rows), *shape[1:]))
    slope = np.empty_like(lever)
    for index, row in enumerate(rows):
        data.qpos[order] = log.joint_pos[row]
        mujoco.mj_fwdPosition(model, data)
        arm = data.subtree_com[model.jnt_bodyid] - data.xanchor
        hinge_lever = mass * np.cross(data.xaxis, arm)
        lever[index] = np.where(is_hinge, hinge_lever, mass * data.xaxis)[order]
        slope[index] = np.where(is_hinge, np.cross(data.xaxis, hinge_lever), 0.0)[order]

    carries = np.zeros((len(order), len(order)), bool)
    for k, carrier in enumerate(order):
        for j, joint in enumerate(order):
            carries[k, j] = _is_ancestor(model, carrier, joint)
    every_row = np.arange(log.num_rows)
    nearest = np.clip(np.searchsorted(rows, every_row), 0, len(rows) - 1)
    return GravityLevers(lever[nearest], slope[nearest], carries)


def _compiled(log: MotorLog) -> tuple[Any, list[int]] | None:
    """Compiled bodies of a log, and the index in them of each of its joints; None if unknown."""
    if not log.bodies:
        return None
    import mujoco

    model = mujoco.MjModel.from_xml_string(log.bodies)
    names = [model.joint(joint).name for joint in range(model.njnt)]
    if set(names) != set(log.joint_names):
        return None  # some joints were left out since the loads were computed
    return model, [names.index(name) for name in log.joint_names]


def link_masses(
    log: MotorLog, segments: Sequence[slice], carries: np.ndarray
) -> list[LinkMass | None]:
    """Loads of a point mass on the link of each joint, in these segments; 0 in other rows.

    ``carries`` (J, J) is that of `GravityLevers`. None stands for a link without mass, or whose
    centre of mass is on its joint.
    """
    compiled = _compiled(log)
    assert compiled is not None
    assert log.joint_vel is not None
    model, order = compiled
    bodies = model.jnt_bodyid[order]
    centers = model.body_ipos[bodies] - model.jnt_pos[order]  # (J, 3)
    distances = np.linalg.norm(centers, axis=1)

    masses: list[LinkMass | None] = [None] * len(order)
    poses = [_poses(model, order, log.joint_pos[segment]) for segment in segments]
    for link, distance in enumerate(distances.tolist()):
        if distance < _MIN_DISTANCE or model.body_mass[bodies[link]] == 0.0:
            continue
        mass = float(model.body_subtreemass[bodies[link]])
        arm = 2.0 * centers[link]
        loads = np.zeros((3, log.num_rows, len(order), 3))
        for segment, pose in zip(segments, poses, strict=True):
            loads[:, segment] = mass * _loads_of_mass(log, segment, pose, arm, link, carries)

        make_inertia_constant(log, segments, loads)
        masses[link] = LinkMass(mass, 2.0 * distance, *loads)
    return masses


def turned_loads(log: MotorLog, segments: Sequence[slice]) -> list[np.ndarray]:
    """(3, T, J, TURN_POWERS) coefficients c of loads with a joint at another angle, for each joint.

    With the joint at its logged angle plus Δ [rad], and the same velocities, inertia, external
    torque and stiffness change by Σ_n c_n·Δⁿ, n from 1. Rows outside of the segments have 0.
    """
    compiled = _compiled(log)
    assert compiled is not None
    dynamics = BodyDynamics(*compiled)

    def loads_at(joint_pos: np.ndarray) -> np.ndarray:
        loads = dynamics.loads(log, segments, joint_pos)
        make_inertia_constant(log, segments, loads)
        return loads

    at_log = loads_at(log.joint_pos)
    inverse_powers = np.linalg.inv(_TURNS[:, None] ** np.arange(1, 1 + TURN_POWERS))
    coefficients = []
    for direction in np.eye(log.num_joints):
        changes = [loads_at(log.joint_pos + turn * direction) - at_log for turn in _TURNS]
        coefficients.append(np.einsum("nk,kctj->ctjn", inverse_powers, np.stack(changes)))
    return coefficients


@dataclass(frozen=True)
class _Poses:
    """Joints of a robot in N rows."""

    anchor: np.ndarray  # (N, J, 3) a point on the axis [m]
    axis: np.ndarray  # (N, J, 3)
    rotation: np.ndarray  # (N, J, 3, 3) of the link
    is_hinge: np.ndarray  # (J, 1)


def _poses(model: Any, order: list[int], joint_pos: np.ndarray) -> _Poses:
    import mujoco

    data = mujoco.MjData(model)
    bodies = model.jnt_bodyid[order]
    anchor = np.empty((*joint_pos.shape, 3))
    axis = np.empty_like(anchor)
    rotation = np.empty((*joint_pos.shape, 3, 3))
    for row, angles in enumerate(joint_pos):
        data.qpos[order] = angles
        mujoco.mj_kinematics(model, data)
        anchor[row] = data.xanchor[order]
        axis[row] = data.xaxis[order]
        rotation[row] = data.xmat[bodies].reshape(-1, 3, 3)
    is_hinge = (model.jnt_type[order] == mujoco.mjtJoint.mjJNT_HINGE)[:, None]
    return _Poses(anchor, axis, rotation, is_hinge)


def _loads_of_mass(
    log: MotorLog,
    segment: slice,
    poses: _Poses,
    arm: np.ndarray,
    link: int,
    carries: np.ndarray,
) -> np.ndarray:
    """(3, N, J, 3) coefficients of inertia, torque and stiffness of 1 kg at d·``arm`` of a link.

    With the velocity dp = Σ_j J_j·dq_j of the mass, its inertia about joint j is J_j², and its
    torque on it is -J_j·(d²p - g) + J_j²·d²q_j.
    """
    # J and the acceleration are linear in the distance d of the mass from the joint
    assert log.joint_vel is not None
    turned_arm = poses.rotation[:, link] @ arm
    relative = poses.anchor[:, [link]] - poses.anchor
    jacobian = np.where(poses.is_hinge, np.cross(poses.axis, relative), poses.axis)
    jacobian_slope = np.where(poses.is_hinge, np.cross(poses.axis, turned_arm[:, None]), 0.0)
    jacobian = jacobian * carries[:, [link]]  # (N, J, 3)
    jacobian_slope = jacobian_slope * carries[:, [link]]

    gravity = np.array([0.0, 0.0, -GRAVITY])
    if log.base_orientation is not None:
        gravity = gravity_in_base(log.base_orientation[segment], GRAVITY)[:, None]
    dq = log.joint_vel[segment]
    time = log.time[segment]
    velocity = np.einsum("njd,nj->nd", jacobian, dq)
    velocity_slope = np.einsum("njd,nj->nd", jacobian_slope, dq)
    acceleration = np.gradient(velocity, time, axis=0)[:, None] - gravity
    acceleration_slope = np.gradient(velocity_slope, time, axis=0)[:, None]

    def product(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        return np.sum(first * second, axis=-1)

    inertia = [
        product(jacobian, jacobian),
        2.0 * product(jacobian, jacobian_slope),
        product(jacobian_slope, jacobian_slope),
    ]
    whole_torque = [
        -product(jacobian, acceleration),
        -product(jacobian, acceleration_slope) - product(jacobian_slope, acceleration),
        -product(jacobian_slope, acceleration_slope),
    ]
    ddq = np.gradient(dq, time, axis=0)
    external = [
        torque + own_inertia * ddq
        for torque, own_inertia in zip(whole_torque, inertia, strict=True)
    ]
    stiffness = []
    for part in (jacobian, jacobian_slope):
        turning = np.where(poses.is_hinge, np.cross(poses.axis, part), 0.0)
        stiffness.append(product(turning, gravity))
    stiffness.append(np.zeros_like(stiffness[0]))
    return np.stack([np.stack(load, axis=-1) for load in (inertia, external, stiffness)])


def _is_ancestor(model: Any, carrier: int, joint: int) -> bool:
    """Whether a joint's body is carried by the body of the joint ``carrier``, or is that body."""
    body = int(model.jnt_bodyid[joint])
    while body > 0:
        if body == model.jnt_bodyid[carrier]:
            return True
        body = int(model.body_parentid[body])
    return False
