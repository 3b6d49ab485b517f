"""A gait that follows a command, with five parameters that the policy modulates.

Policies Modulating Trajectory Generators: Iscen et al., CoRL 2018, section 3, whose generator is parameterised by
frequency, amplitude, height and the ratio of swing to stance. Differences here: the foot's path is in metres, converted
to angles by inverse kinematics, so that a foot in stance moves at the speed of the ground, and the stride follows from
the commanded speed and yaw rate. `control_step.command_step` adds lead, support and levelling.
"""

from __future__ import annotations

import math

import numpy as np

from motorprior.compiled import njit
from motorprior.locomotion.body import Body, leg_angles, lever_arms


@njit(cache=True)
def advance_phase(phase: float, frequency: float, control_dt: float) -> float:
    """Phase of the gait, in [0, 1), one control step later: (phase + frequency [Hz] · control_dt [s]) mod 1."""
    advanced = phase + frequency * control_dt
    return advanced - math.floor(advanced)


@njit(cache=True)
def foot_path(leg_phase: float, stance_share: float) -> tuple[float, float]:
    """Position of a foot: share of the stride ahead of the middle (-½..½), share of the lift (0..1).

    Stance, u < s: from ½ to -½ at constant speed. Swing, q = (u - s) / (1 - s): back to ½ on the cubic that begins and
    ends at the speed of stance, lifted by sin(π q).

    u is the phase of the leg in [0, 1), 0 at touch-down; s in (0, 1) is the share of the cycle in stance.
    """
    if leg_phase < stance_share:
        return 0.5 - leg_phase / stance_share, 0.0
    q = (leg_phase - stance_share) / (1.0 - stance_share)
    slope = -(1.0 - stance_share) / stance_share
    ahead = (3.0 - 2.0 * q) * q * q - 0.5 + slope * q * (2.0 * q - 1.0) * (q - 1.0)
    return ahead, math.sin(math.pi * q)


@njit(cache=True)
def gait_share(body: Body, forward: float, yaw_rate: float) -> float:
    """Share of the full gait for a command: 0 standing, 1 from a tenth of the highest speed or yaw rate."""
    return min(1.0, 10.0 * (abs(forward) / body.max_speed + abs(yaw_rate) / body.max_yaw_rate))


@njit(cache=True)
def joint_targets(
    body: Body,
    phase: float,
    forward: float,
    yaw_rate: float,
    frequency: float,
    height: float,
    rise: tuple[float, float],
    swing_stance_ratio: float,
    lift: float,
    out: np.ndarray,
) -> None:
    """Joint angles of a gait, each leg at its own phase of the cycle.

    With stance share s = 1 / (1 + ratio), the ground under the foot at rest (x, y) moves by (v - ω y, ω x) s / f in
    a stance, which is the stride. The foot is displaced from rest by a share of it (`foot_path`): the abduction turns
    the leg's plane by the sideways part, hip and knee follow from `leg_angles`.

    Args:
        body: of the robot.
        phase: gait phase in [0, 1); 0 is where legs of phase 0 touch down.
        forward: v [m/s].
        yaw_rate: ω [rad/s], to the left.
        frequency: f, steps per leg and second [Hz], > 0.
        height: of the body above the nominal pose [m].
        rise: additional slope of the legs' extension, forward and to the left of the origin [m/m].
        swing_stance_ratio: time in swing over time in stance, > 0.
        lift: height of a foot in the middle of its swing [m].
        out: shape (joints,) [rad], overwritten.
    """
    out[:] = body.nominal_pose
    stance_share = 1.0 / (1.0 + swing_stance_ratio)
    stance_time = stance_share / frequency
    for leg in range(body.phases.shape[0]):
        leg_phase = phase + body.phases[leg]
        ahead, lifted = foot_path(leg_phase - math.floor(leg_phase), stance_share)
        x, y, rest_forward, rest_below = body.nominal_feet[leg]
        along = rest_forward + ahead * (forward - yaw_rate * y) * stance_time
        aside = ahead * yaw_rate * x * stance_time
        below = rest_below + height + rise[0] * x + rise[1] * y - lift * lifted
        abduction, hip, knee = body.legs[leg]
        side = 1.0 if body.nominal_pose[knee] > 0.0 else -1.0
        out[hip], out[knee] = leg_angles(body.lengths[leg, 0], body.lengths[leg, 1], along, below, side)
        out[abduction] += math.atan2(aside, rest_below)


@njit(cache=True)
def add_support(
    body: Body, phase: float, swing_stance_ratio: float, share: float, pose: np.ndarray, out: np.ndarray
) -> None:
    """Add to targets a PD's deflection under the robot's weight: torque / kp at every hip and knee.

    Legs in stance share the weight; all legs carry a standing robot (``share`` 0 of the full gait, see `gait_share`).
    See `lever_arms` for the torques of a force on the foot, at the (joints,) angles ``pose`` [rad] of the gait.
    Abductions get none: the small robot's gears hold them by friction. ``out`` (joints,) [rad] is added to in place.
    """
    stance_share, legs = 1.0 / (1.0 + swing_stance_ratio), body.phases.shape[0]
    carrying = 0
    for leg in range(legs):
        leg_phase = phase + body.phases[leg]
        carrying += 1 if leg_phase - math.floor(leg_phase) < stance_share else 0
    for leg in range(legs):
        leg_phase = phase + body.phases[leg]
        force = (1.0 - share) * body.weight / legs
        if leg_phase - math.floor(leg_phase) < stance_share:
            force += share * body.weight / carrying
        _, hip, knee = body.legs[leg]
        thigh, shank = body.lengths[leg]
        by_hip, by_knee = lever_arms(thigh, shank, float(pose[hip]), float(pose[knee]))
        out[hip] += force * by_hip * body.compliance[hip]
        out[knee] += force * by_knee * body.compliance[knee]


def open_loop_gait(
    body: Body, steps: int, forward: float, frequency: float, height: float, ratio: float, control_dt: float
) -> np.ndarray:
    """(steps, joints) angles [rad] of a gait without modulation or lead, from phase 0; see `joint_targets`."""
    targets, phase = np.zeros((steps, len(body.nominal_pose))), 0.0
    for row in targets:
        joint_targets(body, phase, forward, 0.0, frequency, height, (0.0, 0.0), ratio, body.swing_height, row)
        phase = advance_phase(phase, frequency, control_dt)
    return targets
