"""A gait that follows a command, shaped by five numbers that the policy modulates.

Policies Modulating Trajectory Generators: Iscen et al., CoRL 2018, section 3, whose generator is parameterised by
frequency, amplitude, height and the ratio of swing to stance. Ours differs: the foot's path is drawn in metres and
turned into angles by the leg's kinematics, so that a foot in stance moves at the speed of the ground; the stride
follows from the commanded speed and yaw rate; targets lead the path by the lag of the motors' PD, and are raised by
what the PD yields under the weight; and legs on the low side of a body that its motors carry softly reach further.
"""

from __future__ import annotations

import math

import numpy as np

from motorprior.compiled import njit
from motorprior.locomotion.body import Body
from motorprior.locomotion.leg_kinematics import leg_angles, lever_arms


@njit(cache=True)
def advance_phase(phase: float, frequency: float, control_dt: float) -> float:
    """Phase of the gait one control step later: (phase + frequency · control_dt) mod 1.

    Args:
        phase: gait phase in [0, 1).
        frequency: steps per leg and second [Hz], not negative.
        control_dt: control period [s].
    """
    advanced = phase + frequency * control_dt
    return advanced - math.floor(advanced)


@njit(cache=True)
def foot_path(leg_phase: float, stance_share: float) -> tuple[float, float]:
    """Where a foot is on its way: share of the stride ahead of the middle (-½..½), share of the lift (0..1).

    Stance, u < s: from ½ to -½ at constant speed, as the ground moves. Swing, q = (u - s) / (1 - s): back to ½ on the
    cubic that begins and ends at the speed of stance, lifted by sin(π q).

    Args:
        leg_phase: u, phase of the leg in [0, 1); 0 is touch-down.
        stance_share: s, share of the cycle in stance, in (0, 1).
    """
    if leg_phase < stance_share:
        return 0.5 - leg_phase / stance_share, 0.0
    q = (leg_phase - stance_share) / (1.0 - stance_share)
    slope = -(1.0 - stance_share) / stance_share
    ahead = (3.0 - 2.0 * q) * q * q - 0.5 + slope * q * (2.0 * q - 1.0) * (q - 1.0)
    return ahead, math.sin(math.pi * q)


@njit(cache=True)
def how_much(body: Body, forward: float, yaw_rate: float) -> float:
    """Share of the full gait that a command asks for: 0 standing, 1 from a tenth of the fastest speed or turn on."""
    return min(1.0, 10.0 * (abs(forward) / body.fastest + abs(yaw_rate) / body.yaw_rate))


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
    a stance: that is the stride. The foot is ``ahead`` of its rest place by a share of it (`foot_path`), the leg's
    plane turns about the hip's height by the sideways part, and hip and knee follow from `leg_angles`.

    Args:
        body: of the robot.
        phase: gait phase in [0, 1); 0 is where legs of phase 0 touch down.
        forward: v [m/s].
        yaw_rate: ω [rad/s], to the left.
        frequency: f, steps per leg and second [Hz], > 0.
        height: by which the body stands higher than in the nominal pose [m].
        rise: by which it stands higher still, forward and to the left of its origin [m/m].
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
        x, y, rest_forward, rest_below = body.rest[leg]
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
    """Add to targets what a PD yields under the robot's weight: torque / kp at every hip and knee.

    Legs in stance share the weight; the robot that stands (``share`` 0) is carried by all. See `lever_arms` for the
    torques of a force on the foot. The abductions get none: the small robot's gears hold them by friction, and with it
    it rolls more.

    Args:
        body: of the robot.
        phase: gait phase in [0, 1).
        swing_stance_ratio: time in swing over time in stance, > 0.
        share: of the full gait, see `how_much`.
        pose: (joints,) angles of the gait [rad].
        out: (joints,) targets [rad], added to in place.
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
        out[hip] += force * by_hip * body.yielding[hip]
        out[knee] += force * by_knee * body.yielding[knee]


def open_loop_gait(
    body: Body,
    steps: int,
    forward: float,
    frequency: float,
    height: float,
    swing_stance_ratio: float,
    control_dt: float,
) -> np.ndarray:
    """(steps, joints) angles [rad] of a gait without modulation or lead, from phase 0; see `joint_targets`."""
    targets, phase = np.zeros((steps, len(body.nominal_pose))), 0.0
    for row in targets:
        joint_targets(
            body, phase, forward, 0.0, frequency, height, (0.0, 0.0), swing_stance_ratio, body.swing_height, row
        )
        phase = advance_phase(phase, frequency, control_dt)
    return targets
