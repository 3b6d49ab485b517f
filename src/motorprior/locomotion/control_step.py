"""One control step, compiled: the part before the physics and the part after it.

The Gymnasium env (by its `GaitController`) and the compiled rollout call these two and nothing else, so they agree bit
for bit:

    reset: phase = 0, filter_state = 0, observe
    step:  new_phase = command_step(action, filter_state, phase, ...)     targets are those of the OLD phase
           physics until the next control step
           evaluate_step(new state, x before the step, new_phase, ...)    observation holds the NEW phase
"""

from __future__ import annotations

import numpy as np

from motorprior.compiled import njit
from motorprior.locomotion.body import Body
from motorprior.locomotion.policy import (
    FREQUENCY,
    HEIGHT,
    INTENSITY,
    SWING_STANCE_RATIO,
    action_to_command,
    low_pass,
)
from motorprior.locomotion.task import fallen, observe, reward
from motorprior.locomotion.trajectory_generator import advance_phase, joint_targets
from motorprior.rotations import roll_pitch_yaw


@njit(cache=True)
def command_step(
    body: Body,
    action: np.ndarray,
    filter_state: np.ndarray,
    phase: float,
    control_dt: float,
    command: np.ndarray,
    target: np.ndarray,
) -> float:
    """From an action to position targets: low-pass, scale, trot at ``phase`` + residual, clip to limits.

    Args:
        body: of the robot.
        action: shape (actions,), clipped to [-1, 1].
        filter_state: shape (actions,), updated in place.
        phase: gait phase in [0, 1) that the targets are computed at.
        control_dt: control period [s].
        command: shape (actions,), scratch; afterwards the command in units, see `action_to_command`.
        target: shape (joints,), position targets [rad], overwritten.

    Returns:
        The phase after this control step.
    """
    low_pass(action, control_dt, filter_state)
    action_to_command(filter_state, body.residual, command)
    joints: int = target.shape[0]
    intensity, height = command[joints + INTENSITY], command[joints + HEIGHT]
    joint_targets(body, phase, intensity, height, command[joints + SWING_STANCE_RATIO], target)
    for joint in range(joints):
        wanted = target[joint] + command[joint]
        target[joint] = min(body.upper[joint], max(body.lower[joint], wanted))
    return advance_phase(phase, command[joints + FREQUENCY], control_dt)


@njit(cache=True)
def evaluate_step(
    body: Body,
    base_pos: np.ndarray,
    base_quat: np.ndarray,
    base_lin_vel: np.ndarray,
    base_ang_vel: np.ndarray,
    measured_joint_pos: np.ndarray,
    sum_torque_squared: float,
    fault: int,
    previous_x: float,
    phase: float,
    control_dt: float,
    weights: np.ndarray,
    observation: np.ndarray,
) -> tuple[float, bool]:
    """From the state after the physics to observation, reward and the end of the episode.

    A fault of the backend ends the episode with reward 0 and leaves ``observation`` as it was, since the
    state means nothing then.

    Args:
        body: of the robot.
        base_pos: shape (3,) [m], world.
        base_quat: shape (4,), (w, x, y, z), base to world.
        base_lin_vel: shape (3,) [m/s], world.
        base_ang_vel: shape (3,) [rad/s], body frame.
        measured_joint_pos: shape (joints,) [rad].
        sum_torque_squared: over joints, mean over the physics steps [(N·m)²].
        fault: the backend's, 0 for none.
        previous_x: base_pos[0] before the physics [m].
        phase: phase after this control step, what `command_step` returned.
        control_dt: control period [s].
        weights: shape (6,), `TaskWeights.array()`.
        observation: shape (observations,), overwritten.

    Returns:
        Reward [m], and whether the robot fell or the backend failed.
    """
    if fault != 0:
        return 0.0, True
    observe(base_quat, base_ang_vel, measured_joint_pos, phase, body.nominal_pose, observation)
    roll, pitch, yaw = roll_pitch_yaw(base_quat)
    down = fallen(roll, pitch, base_pos[2], body.lowest, body.highest)
    forward = base_pos[0] - previous_x
    effort = sum_torque_squared / (body.reference_torque * body.reference_torque)
    earned = reward(forward, base_lin_vel[1], base_ang_vel[2], yaw, effort, not down, control_dt, weights)
    return earned, down


@njit(cache=True)
def accumulate_moments(observation: np.ndarray, count: int, mean: np.ndarray, m2: np.ndarray) -> int:
    """Add one observation to the statistics of an episode (Welford 1962).

    d = x - mean, mean += d / n, M2 += d (x - mean) with the new mean.

    Args:
        observation: x, shape (observations,).
        count: observations so far.
        mean: shape (observations,), updated in place.
        m2: Σ (x - mean)², shape (observations,), updated in place.

    Returns:
        n = count + 1.
    """
    count += 1
    for i in range(observation.shape[0]):
        shift = observation[i] - mean[i]
        mean[i] += shift / count
        m2[i] += shift * (observation[i] - mean[i])
    return count
