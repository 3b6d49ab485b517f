"""One control step around the physics, compiled: what comes before it and what comes after it.

The Gymnasium env and the compiled rollout call these two and nothing else, so they agree bit for bit:

    reset: phase = 0, filter_state = 0, observe
    step:  new_phase = command_step(action, filter_state, phase, ...)     targets are those of the OLD phase
           physics until the next control step
           evaluate_step(new state, x before the step, new_phase, ...)    observation holds the NEW phase
"""

from __future__ import annotations

import numpy as np

from motorprior.compiled import njit
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
from motorprior.robots.pupper_v2.spec import JOINT_LOWER, JOINT_UPPER
from motorprior.rotations import roll_pitch_yaw


@njit(cache=True)
def command_step(
    action: np.ndarray,
    filter_state: np.ndarray,
    phase: float,
    control_dt: float,
    command: np.ndarray,
    target: np.ndarray,
) -> float:
    """From an action to position targets: low-pass, scale, trot at ``phase`` + residual, clip to limits.

    Args:
        action: shape (16,), clipped to [-1, 1].
        filter_state: shape (16,), updated in place.
        phase: gait phase in [0, 1) that the targets are computed at.
        control_dt: control period [s].
        command: shape (16,), scratch; afterwards the command in units, see `action_to_command`.
        target: shape (12,), position targets [rad], overwritten.

    Returns:
        The phase after this control step.
    """
    low_pass(action, control_dt, filter_state)
    action_to_command(filter_state, command)
    joint_targets(phase, command[INTENSITY], command[HEIGHT], command[SWING_STANCE_RATIO], target)
    for joint in range(12):
        wanted = target[joint] + command[joint]
        target[joint] = min(JOINT_UPPER[joint], max(JOINT_LOWER[joint], wanted))
    return advance_phase(phase, command[FREQUENCY], control_dt)


@njit(cache=True)
def evaluate_step(
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
        base_pos: shape (3,) [m], world.
        base_quat: shape (4,), (w, x, y, z), base to world.
        base_lin_vel: shape (3,) [m/s], world.
        base_ang_vel: shape (3,) [rad/s], body frame.
        measured_joint_pos: shape (12,) [rad].
        sum_torque_squared: over joints, mean over the physics steps [(N·m)²].
        fault: the backend's, 0 for none.
        previous_x: base_pos[0] before the physics [m].
        phase: phase after this control step, what `command_step` returned.
        control_dt: control period [s].
        weights: shape (6,), `TaskWeights.array()`.
        observation: shape (18,), overwritten.

    Returns:
        Reward [m], and whether the robot fell or the backend failed.
    """
    if fault != 0:
        return 0.0, True
    observe(base_quat, base_ang_vel, measured_joint_pos, phase, observation)
    roll, pitch, yaw = roll_pitch_yaw(base_quat)
    down = fallen(roll, pitch, base_pos[2])
    forward = base_pos[0] - previous_x
    earned = reward(forward, base_lin_vel[1], base_ang_vel[2], yaw, sum_torque_squared, not down, control_dt, weights)
    return earned, down


@njit(cache=True)
def accumulate_moments(observation: np.ndarray, count: int, mean: np.ndarray, m2: np.ndarray) -> int:
    """Add one observation to the statistics of an episode (Welford 1962).

    d = x - mean, mean += d / n, M2 += d (x - mean) with the new mean.

    Args:
        observation: x, shape (18,).
        count: observations so far.
        mean: shape (18,), updated in place.
        m2: Σ (x - mean)², shape (18,), updated in place.

    Returns:
        n = count + 1.
    """
    count += 1
    for i in range(observation.shape[0]):
        shift = observation[i] - mean[i]
        mean[i] += shift / count
        m2[i] += shift * (observation[i] - mean[i])
    return count
