"""The gait, whose five parameters the policy modulates, and the arrays of a robot that walks.

Policies Modulating Trajectory Generators: Iscen et al., CoRL 2018, section 3. Differences here: the
foot's path is in metres, converted to angles by inverse kinematics, so that a foot in stance moves
at the speed of the ground, and the stride follows from the commanded speed and yaw rate.
`control_step.command_step` adds lead, support and levelling.
"""

import math
from typing import NamedTuple

import numpy as np

from motorprior.compiled import njit
from motorprior.robots.robot import Robot

# last entries of an action: frequency, stride scale, height, swing/stance ratio, turn
NUM_MODULATIONS = 5
# first entries of an observation: roll, pitch, rates about x, y and z; the joints follow
NUM_IMU_READINGS = 5
YAW_RATE = 4  # index of the rate about z in an observation
# last entries of an observation: drift, heading error, commanded speed and yaw rate, cosine and
# sine of the phase
NUM_COMMAND_OBSERVATIONS = 6
# Largest speed commanded in training over the robot's largest speed: policies fall at the edge of
# their training range.
MAX_COMMAND = 1.2
# Stiffness against pitch that a walking robot needs [weight · height]. The small robot has 14 by
# its motors alone; a robot of 15 kg with gains of 30 N·m/rad has 2 and falls; with 5 it walks.
MIN_PITCH_STIFFNESS = 5.0
# Share of a PD's lag kd/kp by which targets lead the gait. 1 is exact for a motor without delay and
# torque limit; on the fleets of the small robot 0.8 to 1 give the same walks.
LEAD_SHARE = 0.9
# maximum |cos(knee angle)|; positions beyond are out of reach and replaced by the nearest
_MAX_COSINE = 0.999


class WalkerArrays(NamedTuple):
    """Arrays of a robot with n joints and L legs, for compiled code.

    The values stem from `robots.robot.Robot`.
    """

    control_dt: float  # control period [s]
    nominal_pose: np.ndarray  # (n,) [rad]
    lower: np.ndarray  # (n,) lower joint limits [rad]
    upper: np.ndarray  # (n,) upper joint limits [rad]
    lead: np.ndarray  # (n,) time by which targets lead the gait [s], LEAD_SHARE · kd/kp
    compliance: np.ndarray  # (n,) compliance 1/kp [rad/(N·m)]
    weight: float  # weight of the robot [N]
    # share of an observed tilt that the legs compensate [-], see `_levelling_gain`
    levelling_gain: float
    legs: np.ndarray  # (L, 3) int64: joints of abduction, hip and knee
    lengths: np.ndarray  # (L, 2) thigh and shank [m]
    foot_radius: np.ndarray  # (L,) [m]
    # (L, 4) foot in the nominal pose [m]: forward and left of the base's origin, then forward of
    # and below the hip axis in the plane of the leg
    nominal_feet: np.ndarray
    phases: np.ndarray  # (L,) phases of the legs in the cycle of the gait, in [0, 1)
    frequency: float  # usual frequency of the gait [Hz]
    swing_height: float  # lift of a foot in swing [m]
    min_speed: float  # lowest commanded speed [m/s], 0 or negative
    max_speed: float  # highest commanded speed [m/s]
    max_yaw_rate: float  # highest commanded yaw rate [rad/s]
    max_residual: float  # largest correction of a target [rad]
    min_height: float  # base height of a fallen robot [m]
    max_height: float  # base height of a robot that has taken off [m]
    reference_torque: float  # unit of torque in the reward's penalty [N·m]


def walker_arrays(robot: Robot) -> WalkerArrays:
    """The arrays of a legged robot; ConfigError if it cannot walk."""
    gait = robot.require_gait()

    return WalkerArrays(
        control_dt=robot.control_dt,
        nominal_pose=robot.nominal_pose,
        lower=robot.lower,
        upper=robot.upper,
        lead=np.array([LEAD_SHARE * joint.kd / joint.kp for joint in robot.joints]),
        compliance=np.array([1.0 / joint.kp for joint in robot.joints]),
        weight=robot.weight,
        levelling_gain=_levelling_gain(robot),
        legs=np.array([leg.joints for leg in robot.legs], dtype=np.int64),
        lengths=np.array([(leg.thigh, leg.shank) for leg in robot.legs]),
        foot_radius=np.array([leg.foot_radius for leg in robot.legs]),
        nominal_feet=np.array([(*leg.rest, *leg.reach(robot.nominal_pose)) for leg in robot.legs]),
        phases=np.array([leg.phase for leg in robot.legs]),
        frequency=gait.frequency,
        swing_height=gait.swing_height,
        min_speed=gait.forward[0],
        max_speed=gait.forward[1],
        max_yaw_rate=gait.yaw_rate,
        max_residual=gait.residual,
        min_height=robot.min_base_height,
        max_height=robot.max_base_height,
        reference_torque=robot.reference_torque,
    )


def _levelling_gain(robot: Robot) -> float:
    """Share of an observed tilt that the legs compensate [-].

    The gain is max(0, MIN_PITCH_STIFFNESS · m·g·h / stiffness against pitch - 1). Two legs carry
    the robot. Each has the stiffness k = 1 / Σ arm² / kp at the foot, with the `lever_arms` of hip
    and knee. With the feet at ±x fore and aft the stiffness against pitch is 2 k x².
    """
    stiffness = 0.0
    for leg in robot.legs:
        hip = leg.joints[1]
        knee = leg.joints[2]
        by_hip, by_knee = lever_arms(leg.thigh, leg.shank, robot.nominal[hip], robot.nominal[knee])
        compliance = by_hip**2 / robot.joints[hip].kp + by_knee**2 / robot.joints[knee].kp
        stiffness += 2.0 * leg.rest[0] ** 2 / max(compliance, 1e-9) / len(robot.legs)

    required_stiffness = MIN_PITCH_STIFFNESS * robot.weight * robot.standing_height
    return float(max(0.0, required_stiffness / max(stiffness, 1e-9) - 1.0))


def observation_size(num_joints: int) -> int:
    """Length of an observation: sensor readings, then drift, heading error, command and phase."""
    return NUM_IMU_READINGS + num_joints + NUM_COMMAND_OBSERVATIONS


def action_size(num_joints: int) -> int:
    """Length of an action: one residual per joint, then the modulation of the gait."""
    return num_joints + NUM_MODULATIONS


@njit(cache=True)
def leg_angles(
    thigh: float, shank: float, forward: float, below: float, knee_side: float
) -> tuple[float, float]:
    """Hip q₁ and knee q₂ [rad], about +y, for a position of the foot's centre.

    The foot's centre is ``forward`` of and ``below`` the hip axis [m]. With thigh l₁ and shank l₂
    [m], forward = -(l₁ sin q₁ + l₂ sin(q₁ + q₂)) and below = l₁ cos q₁ + l₂ cos(q₁ + q₂). The law
    of cosines gives q₂, whose sign is ``knee_side`` (-1 bends it backward); then q₁ is the angle
    between the foot and (l₁ + l₂ cos q₂, l₂ sin q₂). A position out of reach is replaced by the
    nearest.
    """
    squares = forward * forward + below * below - thigh * thigh - shank * shank
    cosine = squares / (2.0 * thigh * shank)
    knee = knee_side * math.acos(min(_MAX_COSINE, max(-_MAX_COSINE, cosine)))
    along = thigh + shank * math.cos(knee)
    across = shank * math.sin(knee)
    hip = math.atan2(-forward * along - below * across, below * along - forward * across)
    return hip, knee


@njit(cache=True)
def lever_arms(thigh: float, shank: float, hip: float, knee: float) -> tuple[float, float]:
    """Lever arms of hip and knee against a vertical force: ∂below/∂hip and ∂below/∂knee [m].

    A force F needs F times these torques at the joints. The arms are -(l₁ sin q₁ + l₂ sin(q₁ + q₂))
    and -l₂ sin(q₁ + q₂), see `leg_angles`.
    """
    by_knee = -shank * math.sin(hip + knee)
    return by_knee - thigh * math.sin(hip), by_knee


@njit(cache=True)
def advance_phase(phase: float, frequency: float, control_dt: float) -> float:
    """Phase of the gait one control step later, in [0, 1).

    The result is (phase + frequency [Hz] · control_dt [s]) mod 1.
    """
    advanced = phase + frequency * control_dt
    return advanced - math.floor(advanced)


@njit(cache=True)
def foot_path(leg_phase: float, stance_share: float) -> tuple[float, float]:
    """Position of a foot: share of the stride ahead of the middle (-½ to ½), share of the lift.

    u is the phase of the leg in [0, 1), 0 at touch-down; s in (0, 1) is the share of the cycle in
    stance. In stance, u < s, the foot moves from ½ to -½ at constant speed. In swing, with q =
    (u - s) / (1 - s), it moves back to ½ on the cubic that begins and ends at the speed of stance,
    lifted by sin(π q).
    """
    if leg_phase < stance_share:
        return 0.5 - leg_phase / stance_share, 0.0

    q = (leg_phase - stance_share) / (1.0 - stance_share)
    slope = -(1.0 - stance_share) / stance_share
    ahead = (3.0 - 2.0 * q) * q * q - 0.5 + slope * q * (2.0 * q - 1.0) * (q - 1.0)
    return ahead, math.sin(math.pi * q)


@njit(cache=True)
def gait_share(walker: WalkerArrays, forward: float, yaw_rate: float) -> float:
    """Share of the full gait for a command.

    The share is 0 for a standing robot, and 1 from a tenth of the highest speed or yaw rate on.
    """
    command_share = abs(forward) / walker.max_speed + abs(yaw_rate) / walker.max_yaw_rate
    return min(1.0, 10.0 * command_share)


@njit(cache=True)
def joint_targets(
    walker: WalkerArrays,
    phase: float,
    forward: float,
    yaw_rate: float,
    frequency: float,
    height: float,
    slope: tuple[float, float],
    swing_stance_ratio: float,
    lift: float,
    out: np.ndarray,
) -> None:
    """Write the joint angles of a gait to ``out`` (joints,) [rad], each leg at its own phase.

    With stance share s = 1 / (1 + ratio), the ground under the foot at rest (x, y) moves by (v - ω
    y, ω x) s / f in a stance, which is the stride: ``forward`` v [m/s], ``yaw_rate`` ω to the left
    [rad/s], ``frequency`` f > 0 [Hz], ratio of the times in swing and stance > 0. The foot is
    displaced from rest by a share of the stride (`foot_path`): the abduction turns the leg's plane
    by the sideways part, hip and knee follow from `leg_angles`.

    At ``phase`` 0 of [0, 1) legs of phase 0 touch down. ``height`` is the height of the base above
    the nominal pose [m], ``lift`` the height of a foot in the middle of its swing [m], ``slope`` an
    additional extension of the legs per distance of their feet forward, and to the left, of the
    origin [m/m] (`control_step.levelling`).
    """
    out[:] = walker.nominal_pose
    stance_share = 1.0 / (1.0 + swing_stance_ratio)
    stance_time = stance_share / frequency
    for leg in range(walker.phases.shape[0]):
        leg_phase = phase + walker.phases[leg]
        ahead, lifted = foot_path(leg_phase - math.floor(leg_phase), stance_share)

        x, y, rest_forward, rest_below = walker.nominal_feet[leg]
        along = rest_forward + ahead * (forward - yaw_rate * y) * stance_time
        aside = ahead * yaw_rate * x * stance_time
        below = rest_below + height + slope[0] * x + slope[1] * y - lift * lifted

        abduction, hip, knee = walker.legs[leg]
        side = 1.0 if walker.nominal_pose[knee] > 0.0 else -1.0
        out[hip], out[knee] = leg_angles(
            walker.lengths[leg, 0], walker.lengths[leg, 1], along, below, side
        )
        out[abduction] += math.atan2(aside, rest_below)


@njit(cache=True)
def add_support(
    walker: WalkerArrays,
    phase: float,
    swing_stance_ratio: float,
    share: float,
    pose: np.ndarray,
    out: np.ndarray,
) -> None:
    """Add to targets a PD's deflection under the robot's weight: torque / kp at every hip and knee.

    Legs in stance share the weight; all legs carry a standing robot (``share`` 0 of the full gait,
    see `gait_share`). See `lever_arms` for the torques of a force on the foot, at the (joints,)
    angles ``pose`` [rad] of the gait. Abductions get none: the small robot's gears hold them by
    friction. ``out`` (joints,) [rad] is added to in place.
    """
    stance_share = 1.0 / (1.0 + swing_stance_ratio)
    legs = walker.phases.shape[0]

    legs_in_stance = 0
    for leg in range(legs):
        leg_phase = phase + walker.phases[leg]
        legs_in_stance += 1 if leg_phase - math.floor(leg_phase) < stance_share else 0

    for leg in range(legs):
        leg_phase = phase + walker.phases[leg]
        force = (1.0 - share) * walker.weight / legs
        if leg_phase - math.floor(leg_phase) < stance_share:
            force += share * walker.weight / legs_in_stance

        _, hip, knee = walker.legs[leg]
        thigh, shank = walker.lengths[leg]
        by_hip, by_knee = lever_arms(thigh, shank, float(pose[hip]), float(pose[knee]))
        out[hip] += force * by_hip * walker.compliance[hip]
        out[knee] += force * by_knee * walker.compliance[knee]


def open_loop_gait(
    walker: WalkerArrays, steps: int, forward: float, frequency: float, height: float, ratio: float
) -> np.ndarray:
    """(steps, joints) angles [rad] of a gait without modulation or lead, from phase 0.

    See `joint_targets`.
    """
    targets = np.zeros((steps, len(walker.nominal_pose)))
    phase = 0.0
    for row in targets:
        joint_targets(
            walker,
            phase,
            forward,
            0.0,
            frequency,
            height,
            (0.0, 0.0),
            ratio,
            walker.swing_height,
            row,
        )
        phase = advance_phase(phase, frequency, walker.control_dt)
    return targets
