"""One control step, compiled: the parts before the physics and the part after it, with observation and reward.

A robot follows a speed along its own heading and a yaw rate. It observes its IMU, its joints, the
command, and the heading integrated from its gyroscope.

The compiled rollout, the Gymnasium environments and the deployment on a robot (without numba, on
numpy alone) call these functions in the same order, so simulations agree bit for bit:

    reset: begin_gait, observe, complete_observation
    step:  command_step(action)        targets of the present phase; the phase advances
           physics until the next control step
           evaluate_step               readings, reward, end of the episode
           complete_observation        sensor errors; command, heading and phase join the observation
"""

import math
from dataclasses import asdict, astuple, dataclass
from typing import NamedTuple

import numpy as np

from motorprior.bounds import require_number
from motorprior.compiled import njit
from motorprior.delay_line import fill_line, interpolated, write_line
from motorprior.locomotion import policy
from motorprior.locomotion.gait import (
    MAX_COMMAND,
    NUM_COMMAND_OBSERVATIONS,
    NUM_IMU_READINGS,
    WalkerArrays,
    action_size,
    add_support,
    advance_phase,
    gait_share,
    joint_targets,
    observation_size,
)
from motorprior.rotations import roll_pitch_below, roll_pitch_yaw

# [rad/s] of position targets, which jump where a swing begins; 30 to 60 give equal results
MAX_TARGET_SPEED = 40.0
LEVEL_RATE = 0.1  # [s] weight of the body's rate relative to its tilt in levelling
RAMP = 0.5  # [s] ramp of the command in force from standing to the largest speed or yaw rate
MAX_HEADING_ERROR = 0.5  # [rad] observed; a robot that was turned by hand does not spin back
# Maximum observed drift over the distance in a second at maximum speed; 2.3 standard deviations in
# trainings of 5 s. With 0.3, walks of 20 s drifted by 7 standard deviations, and linear policies
# amplified this until the robot fell.
MAX_DRIFT = 0.1
_PHASE = 0
_HEADING = 1
_DRIFT = 2
_COMMANDED_HEADING = 3
_FORWARD = 4
_LEFT = 5
_SPEED_ERRORS = 6


class RobotState(NamedTuple):
    """State of a simulated robot after a control step; compiled code takes it as it is."""

    base_pos: np.ndarray  # (3,) [m], world; x is the initial heading, z up
    base_quat: np.ndarray  # (4,) rotation_base_to_world (w, x, y, z)
    base_lin_vel: np.ndarray  # (3,) [m/s], world
    base_ang_vel: np.ndarray  # (3,) [rad/s], base frame
    measured_joint_pos: np.ndarray  # (joints,) [rad] at the encoders
    foot_pos: np.ndarray  # (legs, 3) centres of the feet [m], world; NaN if unknown
    # Σ over joints of torque², mean over the physics steps of the control step [(N·m)²]
    torque_squared_sum: float
    fault: int = 0  # 0, or the number of a fault that ended the episode


class GaitState(NamedTuple):
    """State and scratch memory of a gait."""

    observation: np.ndarray  # (observations,) the last one
    filtered: np.ndarray  # (actions,) low-passed action
    command: np.ndarray  # (actions,) scratch: the action in physical units
    target: np.ndarray  # (joints,) position targets of the last control step [rad]
    path: np.ndarray  # (2, joints) scratch: the gait now and one control step later [rad]
    velocity_command: np.ndarray  # (2,) command in force: speed [m/s], yaw rate [rad/s]
    # (7,) phase in [0, 1); heading error, integrated from the gyroscope [rad]; drift to the body's
    # left of the commanded path, integrated from it [m]; commanded heading [rad]; filtered speeds,
    # forward and left [m/s]; sum over the steps of |filtered forward speed - commanded speed| [m/s]
    scalars: np.ndarray
    # (legs, 4) centre [m] and shank angle about the body's y axis [rad] one control step ago
    feet: np.ndarray

    @property
    def phase(self) -> float:
        """In the cycle of the gait, in [0, 1)."""
        return float(self.scalars[_PHASE])

    @property
    def speed_errors(self) -> float:
        """Sum over the control steps so far of |filtered forward speed - commanded speed| [m/s]."""
        return float(self.scalars[_SPEED_ERRORS])


def new_gait(walker: WalkerArrays) -> GaitState:
    """Memory of a robot's gait, at the beginning of an episode."""
    joints = len(walker.nominal_pose)
    actions = action_size(joints)
    shapes = (
        observation_size(joints),
        actions,
        actions,
        joints,
        (2, joints),
        2,
        7,
        (len(walker.legs), 4),
    )
    gait = GaitState(*(np.zeros(shape) for shape in shapes))
    begin_gait(walker, gait)
    return gait


@njit(cache=True)
def begin_gait(walker: WalkerArrays, gait: GaitState) -> None:
    """Nominal pose, phase 0, no speed, no heading error and no drift."""
    gait.filtered[:] = 0.0
    gait.velocity_command[:] = 0.0
    gait.scalars[:] = 0.0
    gait.target[:] = walker.nominal_pose
    gait.feet[:] = np.nan


@njit(cache=True)
def complete_observation(
    walker: WalkerArrays,
    gait: GaitState,
    sensors: "SensorErrors",
    schedule: np.ndarray,
    step: int,
    base_quat: np.ndarray,
) -> None:
    """Apply sensor errors and the command to the true readings in the observation of control step ``step``.

    ``schedule`` (steps, 2) is the commanded speed [m/s] and yaw rate [rad/s], whose last row stays
    in force; ``base_quat`` (4,) is rotation_base_to_world.
    """
    apply_sensor_errors(sensors, step, base_quat, gait.observation)
    row = min(step, schedule.shape[0] - 1)
    follow_command(walker, gait, schedule[row, 0], schedule[row, 1])


@njit(cache=True)
def follow_command(walker: WalkerArrays, gait: GaitState, forward: float, yaw_rate: float) -> None:
    """Complete an observation after its readings: drift, heading error, command in force, phase.

    The command in force follows the given speed ``forward`` [m/s] and ``yaw_rate`` [rad/s], to the
    left, at a bounded rate and within the robot's range, up to MAX_COMMAND times its highest speed.
    The heading error ψ integrates the observed heading rate less the commanded one. The drift
    integrates v sin ψ at the commanded speed v; without it a robot that pulls to one side would
    walk on at a small constant error. All except the command fade out as the robot stops.
    """
    observation = gait.observation
    velocity = gait.velocity_command
    step = walker.control_dt / RAMP
    forward = min(MAX_COMMAND * walker.max_speed, max(walker.min_speed, forward))
    yaw_rate = min(walker.max_yaw_rate, max(-walker.max_yaw_rate, yaw_rate))
    velocity[0] += min(
        step * walker.max_speed, max(-step * walker.max_speed, forward - velocity[0])
    )
    velocity[1] += min(
        step * walker.max_yaw_rate, max(-step * walker.max_yaw_rate, yaw_rate - velocity[1])
    )
    share = gait_share(walker, velocity[0], velocity[1])
    angle = 2.0 * math.pi * gait.scalars[_PHASE]
    gait.scalars[_COMMANDED_HEADING] += walker.control_dt * velocity[1]
    if share > 0.0:  # a standing robot would integrate its gyroscope's bias
        gait.scalars[_HEADING] += walker.control_dt * (heading_rate(observation) - velocity[1])
    gait.scalars[_HEADING] = min(MAX_HEADING_ERROR, max(-MAX_HEADING_ERROR, gait.scalars[_HEADING]))
    drift = gait.scalars[_DRIFT] + walker.control_dt * velocity[0] * math.sin(
        gait.scalars[_HEADING]
    )
    # The drift fades out below a tenth of the highest speed: after a turn on the spot the path has
    # changed.
    max_drift = MAX_DRIFT * walker.max_speed
    along = gait_share(walker, velocity[0], 0.0)
    gait.scalars[_DRIFT] = along * min(max_drift, max(-max_drift, drift))
    first = observation.shape[0] - NUM_COMMAND_OBSERVATIONS
    # Positive to the left of the direction of motion, so that the same turn corrects it forward and
    # backward.
    observation[first] = math.copysign(1.0, velocity[0]) * gait.scalars[_DRIFT]
    observation[first + 1] = share * gait.scalars[_HEADING]
    observation[first + 2] = velocity[0]
    observation[first + 3] = velocity[1]
    observation[first + 4] = share * math.cos(angle)
    observation[first + 5] = share * math.sin(angle)


@njit(cache=True)
def levelling(walker: WalkerArrays, observation: np.ndarray) -> tuple[float, float]:
    """Slope of the legs' extension, forward and to the left [m/m]: level · (tilt + LEVEL_RATE · its rate).

    Legs on the low side extend further, which stiffens a body on soft motors against tilt.
    """
    forward = observation[1] + LEVEL_RATE * observation[3]
    left = -observation[0] - LEVEL_RATE * observation[2]
    return walker.levelling_gain * forward, walker.levelling_gain * left


@njit(cache=True)
def command_step(walker: WalkerArrays, gait: GaitState, action: np.ndarray) -> None:
    """Convert an action to the position targets ``gait.target``, and advance the phase.

    Low-pass and scale the (actions,) action, which is clipped to [-1, 1]; targets = gait + lead ·
    its rate + support + residual, with a rate up to MAX_TARGET_SPEED, within the joint limits. The
    support compensates the PD's deflection under the weight. The lead compensates its damping,
    which acts on joint_vel and not on the velocity error: an error of kd/kp times the speed.
    """
    policy.low_pass(action, walker.control_dt, gait.filtered)
    policy.action_to_command(walker, gait.filtered, gait.command)
    joints = gait.target.shape[0]
    command = gait.command
    share = gait_share(walker, gait.velocity_command[0], gait.velocity_command[1])
    frequency = float(command[joints + policy.FREQUENCY])
    ratio = float(command[joints + policy.SWING_STANCE_RATIO])
    height = float(command[joints + policy.HEIGHT])
    forward = command[joints + policy.STRIDE_SCALE] * gait.velocity_command[0]
    yaw_rate = (
        command[joints + policy.STRIDE_SCALE] * gait.velocity_command[1]
        + share * command[joints + policy.TURN]
    )
    lift = share * walker.swing_height
    phase = float(gait.scalars[_PHASE])
    rise = levelling(walker, gait.observation)
    later = advance_phase(phase, frequency, walker.control_dt)
    joint_targets(
        walker, phase, forward, yaw_rate, frequency, height, rise, ratio, lift, gait.path[0]
    )
    joint_targets(
        walker, later, forward, yaw_rate, frequency, height, rise, ratio, lift, gait.path[1]
    )
    for joint in range(joints):
        command[joint] += (
            walker.lead[joint] * (gait.path[1, joint] - gait.path[0, joint]) / walker.control_dt
        )
    add_support(walker, phase, ratio, share, gait.path[0], command)
    max_change = MAX_TARGET_SPEED * walker.control_dt
    for joint in range(joints):
        change = gait.path[0, joint] + command[joint] - gait.target[joint]
        target = gait.target[joint] + min(max_change, max(-max_change, change))
        gait.target[joint] = min(walker.upper[joint], max(walker.lower[joint], target))
    gait.scalars[_PHASE] = later


@njit(cache=True)
def evaluate_step(
    walker: WalkerArrays, gait: GaitState, state: RobotState, weights: np.ndarray
) -> tuple[float, bool]:
    """Readings from the state after the physics; returns reward [m], and whether the robot fell or the engine failed.

    A fault of the engine ends the episode with reward 0 and leaves the observation as it was: the
    state is invalid. ``weights`` (8,) are `TaskWeights.array()`.
    """
    if state.fault != 0:
        return 0.0, True
    observe(walker, state, gait.observation)
    roll, pitch, yaw = roll_pitch_yaw(state.base_quat)
    down = fallen(roll, pitch, state.base_pos[2], walker.min_height, walker.max_height)
    cosine = math.cos(yaw)
    sine = math.sin(yaw)
    velocity = state.base_lin_vel
    share = 1.0 - math.exp(-walker.control_dt / SPEED_FILTER)
    scalars = gait.scalars
    scalars[_FORWARD] += share * (cosine * velocity[0] + sine * velocity[1] - scalars[_FORWARD])
    scalars[_LEFT] += share * (cosine * velocity[1] - sine * velocity[0] - scalars[_LEFT])
    speed_error = scalars[_FORWARD] - gait.velocity_command[0]
    scalars[_SPEED_ERRORS] += abs(speed_error)
    earned = weights[0] if not down else 0.0
    earned -= weights[1] * abs(speed_error) + weights[2] * abs(scalars[_LEFT])
    heading_error = wrapped(yaw - scalars[_COMMANDED_HEADING])
    yaw_rate_error = state.base_ang_vel[2] - gait.velocity_command[1]
    earned -= weights[3] * abs(heading_error) + weights[4] * abs(yaw_rate_error)
    effort = state.torque_squared_sum / (walker.reference_torque * walker.reference_torque)
    slip = sliding(walker, gait.feet, state, pitch, yaw)
    earned = (
        earned - weights[5] * (abs(roll) + abs(pitch)) - weights[6] * effort - weights[7] * slip
    )
    return walker.control_dt * earned, down


MAX_TILT = 0.4  # [rad] of roll or pitch
# [s] time constant of the filtered speed, about a step of a leg: speed varies within a step
SPEED_FILTER = 0.3
REWARD_CONTACT_HEIGHT = 0.002  # [m] a foot whose lowest point is lower is on the ground


@dataclass(frozen=True)
class TaskWeights:
    """Weights of the reward of a control step, control_dt (alive - Σ weight · |error|) [m]; at least 0."""

    alive: float = 1.0  # reward per second upright [m/s]
    speed: float = 2.0  # weight of |filtered forward speed - commanded speed| [m/s per m/s]
    lateral: float = 1.0  # weight of |filtered sideways speed| [m/s per m/s]
    heading: float = 1.0  # weight of |heading error| [m/s per rad]
    yaw_rate: float = 0.02  # weight of |yaw rate - commanded yaw rate| [m/s per rad/s]
    tilt: float = 0.2  # weight of |roll| + |pitch| [m/s per rad]
    torque: float = 0.003  # weight of Σ (torque/reference_torque)² over the joints [m/s]
    slip: float = 0.5  # weight of Σ sliding speed over the feet on the ground [m/s per m/s]

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            require_number(f"task.{name}", value)

    def array(self) -> np.ndarray:
        """Shape (8,), in the order of the attributes."""
        return np.array(astuple(self), dtype=np.float64)


@njit(cache=True)
def write_readings(
    walker: WalkerArrays,
    roll: float,
    pitch: float,
    rates: np.ndarray,
    joint_pos: np.ndarray,
    observation: np.ndarray,
) -> None:
    """Write the first 5 + joints of an observation: roll, pitch [rad], the three body rates [rad/s], joint angles.

    Joint angles are relative to the nominal pose [rad].
    """
    observation[0] = roll
    observation[1] = pitch
    for axis in range(3):
        observation[2 + axis] = rates[axis]
    for joint in range(walker.nominal_pose.shape[0]):
        observation[NUM_IMU_READINGS + joint] = joint_pos[joint] - walker.nominal_pose[joint]


@njit(cache=True)
def observe(walker: WalkerArrays, state: RobotState, observation: np.ndarray) -> None:
    """`write_readings` of a state."""
    roll, pitch, _ = roll_pitch_yaw(state.base_quat)
    write_readings(walker, roll, pitch, state.base_ang_vel, state.measured_joint_pos, observation)


@njit(cache=True)
def heading_rate(observation: np.ndarray) -> float:
    """Rate of the heading [rad/s] from observed attitude and rates: (ω_y sin φ + ω_z cos φ) / cos θ."""
    roll = observation[0]
    pitch = observation[1]
    return (observation[3] * math.sin(roll) + observation[4] * math.cos(roll)) / math.cos(pitch)


@njit(cache=True)
def wrapped(angle: float) -> float:
    """The same angle in [-π, π) [rad]."""
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


@njit(cache=True)
def sliding(
    walker: WalkerArrays, feet: np.ndarray, state: RobotState, pitch: float, yaw: float
) -> float:
    """Sum over the feet on the ground of their sliding speed [m/s]; stores their positions in ``feet``.

    Sliding is the displacement of the foot's centre less its rolling, radius times rotation of the
    shank. Feet of unknown position (NaN) count as 0. ``feet`` (legs, 4) are those of
    `control_step.GaitState` one control step ago, ``pitch`` and ``yaw`` of the body [rad].
    """
    total = 0.0
    cosine = math.cos(yaw)
    sine = math.sin(yaw)
    joint_pos = state.measured_joint_pos
    for leg in range(walker.legs.shape[0]):
        angle = pitch + joint_pos[walker.legs[leg, 1]] + joint_pos[walker.legs[leg, 2]]
        radius = walker.foot_radius[leg]
        before = feet[leg]
        foot = state.foot_pos[leg]
        # false for NaN
        if foot[2] < radius + REWARD_CONTACT_HEIGHT and before[2] < radius + REWARD_CONTACT_HEIGHT:
            rolled = radius * (angle - before[3])
            x = foot[0] - before[0] - rolled * cosine
            y = foot[1] - before[1] - rolled * sine
            total += math.sqrt(x * x + y * y) / walker.control_dt
        before[:3] = foot
        before[3] = angle
    return total


@njit(cache=True)
def fallen(roll: float, pitch: float, height: float, lowest: float, highest: float) -> bool:
    """Whether the episode ends: |roll| or |pitch| > 0.4 rad, height [m] not in [lowest, highest], or any is NaN."""
    upright = abs(roll) <= MAX_TILT and abs(pitch) <= MAX_TILT
    return not (upright and lowest <= height <= highest)


class SensorErrors(NamedTuple):
    """Sensor errors of one episode, for compiled code."""

    noise: np.ndarray  # (observations, readings) added to each observation; no rows without noise
    ages: np.ndarray  # (observations,) age of the reading in each observation [control steps]
    past: np.ndarray  # (rows, readings) true readings, a delay line; no rows without delay; state
    # (3,) unit vector against gravity, in the world; on a slope not the normal of the ground
    up: np.ndarray


def perfect_sensors() -> SensorErrors:
    """Neither noise nor delay, on level ground."""
    return SensorErrors(np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0)), np.array([0.0, 0.0, 1.0]))


@njit(cache=True, nogil=True)
def apply_sensor_errors(
    sensors: SensorErrors, count: int, base_quat: np.ndarray, observation: np.ndarray
) -> None:
    """Replace the true readings of an observation by the measured ones.

    Roll and pitch relative to the ground become those relative to gravity. A delay between two
    control steps interpolates linearly between their readings; readings before the reset are those
    of the reset. ``count`` is the number of observations since the reset before this one,
    ``base_quat`` (4,) rotation_base_to_world.
    """
    if sensors.up[2] < 1.0:
        observation[0], observation[1] = roll_pitch_below(sensors.up, base_quat)
    rows, readings = sensors.past.shape
    if rows > 0:
        if count == 0:
            fill_line(sensors.past, 0, observation[:readings])
        newest = write_line(sensors.past, 0, count, observation[:readings])
        for i in range(readings):
            observation[i] = interpolated(sensors.past, 0, newest, sensors.ages[count], i)
    if sensors.noise.shape[0] > 0:
        for i in range(sensors.noise.shape[1]):
            observation[i] += sensors.noise[count, i]
