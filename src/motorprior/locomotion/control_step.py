"""One control step, compiled: the parts before the physics and the part after it.

The Gymnasium env (by its `GaitController`) and the compiled rollout call these and nothing else, so they agree bit for
bit:

    reset: begin_gait, observe, sense, follow_command
    step:  command_step(action)        targets of the present phase; the phase advances
           physics until the next control step
           evaluate_step               readings, reward, end of the episode
           sense, follow_command       errors of the sensors; then command, heading and phase join the observation
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from motorprior.compiled import njit
from motorprior.locomotion.body import BEYOND, FOLLOWED, Body, action_size
from motorprior.locomotion.foot_slip import sliding
from motorprior.locomotion.policy import (
    FREQUENCY,
    HEIGHT,
    INTENSITY,
    SWING_STANCE_RATIO,
    TURN,
    action_to_command,
    low_pass,
)
from motorprior.locomotion.task import SPEED_FILTER, fallen, heading_rate, observe, reward, wrapped
from motorprior.locomotion.trajectory_generator import add_support, advance_phase, how_much, joint_targets
from motorprior.rotations import roll_pitch_yaw

TARGET_SPEED = 40.0
"""Fastest change of a position target [rad/s]; a swing would begin with a jump. 30 rad/s walk as well, 60 no better."""
LEVEL_RATE = 0.1
"""Weight of the body's rate beside its tilt in levelling [s]."""
RAMP = 0.5
"""Time in which the command in force goes from standing to the fastest speed or turn [s]."""
FURTHEST_HEADING = 0.5
"""Largest observed heading error [rad]; a robot that was turned by hand does not spin back."""
FURTHEST_DRIFT = 0.1
"""Largest drift, as a share of the way in a second at the fastest speed [-]: 2.3 standard deviations of what trainings
of 5 s saw. With a share of 0.3, walks of 20 s met seven, which a linear policy multiplied until the robot fell."""
_PHASE, _HEADING, _DRIFT, _GOAL, _FORWARD, _LEFT, _OFF = 0, 1, 2, 3, 4, 5, 6


class GaitState(NamedTuple):
    """Memory and scratch of a gait."""

    filtered: np.ndarray
    """(actions,) low-passed action"""
    command: np.ndarray
    """(actions,) scratch: the action in units"""
    target: np.ndarray
    """(joints,) position targets of the last control step [rad]"""
    path: np.ndarray
    """(2, joints) scratch: the gait now and one control step later [rad]"""
    twist: np.ndarray
    """(2,) command in force: speed [m/s], yaw rate [rad/s]"""
    scalars: np.ndarray
    """(7,) phase in [0, 1); heading error that the gyroscope adds up [rad]; drift to the body's left of the commanded
    path that follows from it [m]; heading that the commands lead to [rad]; filtered speeds, forward and left [m/s]; sum
    over the steps of |filtered forward speed - commanded speed| [m/s]"""

    feet: np.ndarray
    """(legs, 4) centre of each foot [m] and angle of its shank about the body's y axis [rad] one control step ago"""

    @property
    def phase(self) -> float:
        """In the cycle of the gait, in [0, 1)."""
        return float(self.scalars[_PHASE])

    @property
    def speed_errors(self) -> float:
        """Sum over the control steps so far of |filtered forward speed - commanded speed| [m/s]."""
        return float(self.scalars[_OFF])


def new_gait(num_joints: int, num_legs: int) -> GaitState:
    """Memory of a robot's gait; `begin_gait` fills it."""
    actions = action_size(num_joints)
    shapes = (actions, actions, num_joints, (2, num_joints), 2, 7, (num_legs, 4))
    return GaitState(*(np.zeros(shape) for shape in shapes))


@njit(cache=True)
def begin_gait(body: Body, gait: GaitState) -> None:
    """Stand in the nominal pose, at rest, at phase 0, on the commanded heading and way."""
    gait.filtered[:] = 0.0
    gait.twist[:] = 0.0
    gait.scalars[:] = 0.0
    gait.target[:] = body.nominal_pose
    gait.feet[:] = np.nan


@njit(cache=True)
def follow_command(
    body: Body, gait: GaitState, forward: float, yaw_rate: float, control_dt: float, observation: np.ndarray
) -> None:
    """Complete an observation whose readings are there: drift, heading error, command in force, phase.

    The command in force follows the given one at a bounded rate. The heading error ψ adds up the observed rate less the
    commanded one, the drift adds up v sin ψ at the commanded speed v: without it a robot that pulls to one side walks
    straight on at a small constant error. The observed drift is to the left of the way that the robot goes, backward
    that is to the body's right: a turn against it brings the robot back on either way, where one against the drift to
    the body's left would lead it further aside backward. It fades out, within a few steps, below a tenth of the fastest
    speed: after a turn on the spot the line is another one. Standing, neither adds up anything: the constant error of a
    gyroscope would turn the robot at its next step. All but the command fade out as the robot comes to a stand.

    Args:
        body: of the robot.
        gait: command and heading are updated in place.
        forward: commanded speed [m/s]; at least the robot's slowest, at most BEYOND times its fastest.
        yaw_rate: commanded yaw rate [rad/s], to the left; at most the robot's.
        control_dt: control period [s].
        observation: shape (observations,), its last six are overwritten.
    """
    step = control_dt / RAMP
    forward = min(BEYOND * body.fastest, max(body.slowest, forward))
    yaw_rate = min(body.yaw_rate, max(-body.yaw_rate, yaw_rate))
    gait.twist[0] += min(step * body.fastest, max(-step * body.fastest, forward - gait.twist[0]))
    gait.twist[1] += min(step * body.yaw_rate, max(-step * body.yaw_rate, yaw_rate - gait.twist[1]))
    share, angle = how_much(body, gait.twist[0], gait.twist[1]), 2.0 * math.pi * gait.scalars[_PHASE]
    gait.scalars[_GOAL] += control_dt * gait.twist[1]
    if share > 0.0:
        gait.scalars[_HEADING] += control_dt * (heading_rate(observation) - gait.twist[1])
    gait.scalars[_HEADING] = min(FURTHEST_HEADING, max(-FURTHEST_HEADING, gait.scalars[_HEADING]))
    drift = gait.scalars[_DRIFT] + control_dt * gait.twist[0] * math.sin(gait.scalars[_HEADING])
    farthest, along = FURTHEST_DRIFT * body.fastest, how_much(body, gait.twist[0], 0.0)
    gait.scalars[_DRIFT] = along * min(farthest, max(-farthest, drift))
    first = observation.shape[0] - FOLLOWED
    observation[first] = math.copysign(1.0, gait.twist[0]) * gait.scalars[_DRIFT]
    observation[first + 1] = share * gait.scalars[_HEADING]
    observation[first + 2], observation[first + 3] = gait.twist[0], gait.twist[1]
    observation[first + 4], observation[first + 5] = share * math.cos(angle), share * math.sin(angle)


@njit(cache=True)
def levelling(body: Body, observation: np.ndarray) -> tuple[float, float]:
    """Rise of the legs, forward and to the left [m/m], against the tilt: level · (tilt + LEVEL_RATE · its rate).

    Legs on the low side reach further, which makes a body that its motors carry softly stiffer against tilt.

    Args:
        body: of the robot, see its ``level``.
        observation: shape (observations,), roll and pitch [rad] and their rates [rad/s] come first.
    """
    forward = observation[1] + LEVEL_RATE * observation[3]
    left = -observation[0] - LEVEL_RATE * observation[2]
    return body.level * forward, body.level * left


@njit(cache=True)
def command_step(body: Body, action: np.ndarray, observation: np.ndarray, gait: GaitState, control_dt: float) -> None:
    """From an action to the position targets ``gait.target``; the phase advances.

    Low-pass and scale the action; targets = gait + lead · its rate + support + residual, changed by at most
    TARGET_SPEED, within the joints' limits. The support is what a PD yields under the weight. The lead is what a PD
    lags behind that does not know the target's speed: its damping kd pulls towards rest, which an error of kd/kp times
    the speed makes up for.

    Args:
        body: of the robot.
        action: shape (actions,), clipped to [-1, 1].
        observation: shape (observations,), the one that the action answers.
        gait: updated in place.
        control_dt: control period [s].
    """
    low_pass(action, control_dt, gait.filtered)
    action_to_command(body, gait.filtered, gait.command)
    joints, command = gait.target.shape[0], gait.command
    share = how_much(body, gait.twist[0], gait.twist[1])
    frequency, ratio = float(command[joints + FREQUENCY]), float(command[joints + SWING_STANCE_RATIO])
    height = float(command[joints + HEIGHT])
    forward = command[joints + INTENSITY] * gait.twist[0]
    yaw_rate = command[joints + INTENSITY] * gait.twist[1] + share * command[joints + TURN]
    lift, phase = share * body.swing_height, float(gait.scalars[_PHASE])
    rise = levelling(body, observation)
    later = advance_phase(phase, frequency, control_dt)
    joint_targets(body, phase, forward, yaw_rate, frequency, height, rise, ratio, lift, gait.path[0])
    joint_targets(body, later, forward, yaw_rate, frequency, height, rise, ratio, lift, gait.path[1])
    for joint in range(joints):
        command[joint] += body.lead[joint] * (gait.path[1, joint] - gait.path[0, joint]) / control_dt
    add_support(body, phase, ratio, share, gait.path[0], command)
    furthest = TARGET_SPEED * control_dt
    for joint in range(joints):
        change = gait.path[0, joint] + command[joint] - gait.target[joint]
        target = gait.target[joint] + min(furthest, max(-furthest, change))
        gait.target[joint] = min(body.upper[joint], max(body.lower[joint], target))
    gait.scalars[_PHASE] = later


@njit(cache=True)
def evaluate_step(
    body: Body,
    base_pos: np.ndarray,
    base_quat: np.ndarray,
    base_lin_vel: np.ndarray,
    base_ang_vel: np.ndarray,
    measured_joint_pos: np.ndarray,
    foot_pos: np.ndarray,
    sum_torque_squared: float,
    fault: int,
    gait: GaitState,
    control_dt: float,
    weights: np.ndarray,
    observation: np.ndarray,
) -> tuple[float, bool]:
    """From the state after the physics to readings, reward and the end of the episode.

    A fault of the backend ends the episode with reward 0 and leaves ``observation`` as it was, since the
    state means nothing then.

    Args:
        body: of the robot.
        base_pos: shape (3,) [m], world.
        base_quat: shape (4,), (w, x, y, z), base to world.
        base_lin_vel: shape (3,) [m/s], world.
        base_ang_vel: shape (3,) [rad/s], body frame.
        measured_joint_pos: shape (joints,) [rad].
        foot_pos: shape (legs, 3), centres of the feet [m], world; NaN where they are not known.
        sum_torque_squared: over joints, mean over the physics steps [(N·m)²].
        fault: the backend's, 0 for none.
        gait: its filtered speeds, its sum of speed errors and its feet are updated in place.
        control_dt: control period [s].
        weights: shape (8,), `TaskWeights.array()`.
        observation: shape (observations,), its readings are overwritten.

    Returns:
        Reward [m], and whether the robot fell or the backend failed.
    """
    if fault != 0:
        return 0.0, True
    observe(base_quat, base_ang_vel, measured_joint_pos, body.nominal_pose, observation)
    roll, pitch, yaw = roll_pitch_yaw(base_quat)
    down = fallen(roll, pitch, base_pos[2], body.lowest, body.highest)
    cosine, sine = math.cos(yaw), math.sin(yaw)
    share, scalars = 1.0 - math.exp(-control_dt / SPEED_FILTER), gait.scalars
    scalars[_FORWARD] += share * (cosine * base_lin_vel[0] + sine * base_lin_vel[1] - scalars[_FORWARD])
    scalars[_LEFT] += share * (cosine * base_lin_vel[1] - sine * base_lin_vel[0] - scalars[_LEFT])
    speed_error = scalars[_FORWARD] - gait.twist[0]
    scalars[_OFF] += abs(speed_error)
    slip = sliding(body, gait.feet, foot_pos, measured_joint_pos, pitch, yaw, control_dt)
    effort = sum_torque_squared / (body.reference_torque * body.reference_torque)
    earned = reward(
        speed_error, scalars[_LEFT], wrapped(yaw - scalars[_GOAL]),
        base_ang_vel[2] - gait.twist[1], abs(roll) + abs(pitch), effort, slip, not down, control_dt, weights,
    )  # fmt: skip
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
