"""One control step, compiled: targets before the physics, observation and reward after it.

A robot follows a speed along its own heading and a yaw rate. It observes its IMU, its joints, the
command, and the heading integrated from its gyroscope.

The compiled rollout, the Gymnasium environments and the deployment on a robot (without numba, on
numpy alone) call these functions in the same order, so simulations agree bit for bit:

    reset: begin_gait, observe, complete_observation
    step:  command_step(action)        targets of the present phase; the phase advances
           physics until the next control step
           evaluate_step               readings, reward, end of the episode
           complete_observation        sensor errors; command, heading, phase join the observation
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

# Maximum rate of position targets, which jump where a swing begins [rad/s]; 30 to 60 give equal
# results.
MAX_TARGET_SPEED = 40.0
LEVEL_RATE = 0.1  # weight of the body's rate relative to its tilt in levelling [s]
# time in which the command in force rises from standing to the largest speed or yaw rate [s]
RAMP = 0.5
# maximum observed heading error [rad]; a robot that was turned by hand does not spin back
MAX_HEADING_ERROR = 0.5
# Maximum observed drift, as a share of the distance that the robot walks in one second at its
# maximum speed. It is 2.3 standard deviations of the drift in trainings of 5 s. With a share of
# 0.3, walks of 20 s drifted by 7 standard deviations, and linear policies amplified this until the
# robot fell.
MAX_DRIFT = 0.1

# indices of `GaitState.scalars`
_PHASE = 0
_HEADING = 1
_DRIFT = 2
_COMMANDED_HEADING = 3
_FORWARD = 4
_LEFT = 5
_SPEED_ERRORS = 6


class RobotState(NamedTuple):
    """State of a simulated robot after a control step, for compiled code and for Python."""

    base_pos: np.ndarray  # (3,) position of the base in the world: x initial heading, z up [m]
    base_quat: np.ndarray  # (4,) rotation_base_to_world (w, x, y, z)
    base_lin_vel: np.ndarray  # (3,) linear velocity of the base in the world [m/s]
    base_ang_vel: np.ndarray  # (3,) angular velocity of the base in the base's frame [rad/s]
    measured_joint_pos: np.ndarray  # (joints,) joint angles at the encoders [rad]
    foot_pos: np.ndarray  # (legs, 3) centres of the feet in the world [m]; NaN if unknown
    # Σ over joints of torque², mean over the physics steps of the control step [(N·m)²]
    torque_squared_sum: float
    fault: int = 0  # 0, or the number of a fault that ended the episode


class GaitState(NamedTuple):
    """State and scratch memory of a gait."""

    observation: np.ndarray  # (observations,) the last observation
    filtered: np.ndarray  # (actions,) low-passed action
    scaled_action: np.ndarray  # (actions,) scratch: residuals [rad] and modulation of the gait
    target: np.ndarray  # (joints,) position targets of the last control step [rad]
    # (2, joints) scratch: joint angles of the gait, now and one control step later [rad]
    gait_pos: np.ndarray
    velocity_command: np.ndarray  # (2,) command in force: speed [m/s], yaw rate [rad/s]
    # (7,) phase of the gait in [0, 1); heading error, integrated from the gyroscope [rad]; drift to
    # the body's left of the commanded path, integrated from the heading error [m]; commanded
    # heading [rad]; filtered forward speed and filtered speed to the left [m/s]; sum over the steps
    # of |filtered forward speed - commanded speed| [m/s]
    scalars: np.ndarray
    # (legs, 4) one control step ago: centre of each foot [m], and angle of its shank about the
    # body's y axis [rad]
    feet: np.ndarray

    @property
    def phase(self) -> float:
        """Phase in the cycle of the gait, in [0, 1)."""
        return float(self.scalars[_PHASE])

    @property
    def speed_errors(self) -> float:
        """Sum over the control steps so far of |filtered forward speed - commanded speed| [m/s]."""
        return float(self.scalars[_SPEED_ERRORS])


def new_gait(walker: WalkerArrays) -> GaitState:
    """Memory of a robot's gait, at the beginning of an episode."""
    joints = len(walker.nominal_pose)
    actions = action_size(joints)
    gait = GaitState(
        observation=np.zeros(observation_size(joints)),
        filtered=np.zeros(actions),
        scaled_action=np.zeros(actions),
        target=np.zeros(joints),
        gait_pos=np.zeros((2, joints)),
        velocity_command=np.zeros(2),
        scalars=np.zeros(7),
        feet=np.zeros((len(walker.legs), 4)),
    )
    begin_gait(walker, gait)
    return gait


@njit(cache=True)
def begin_gait(walker: WalkerArrays, gait: GaitState) -> None:
    """Reset to the nominal pose and phase 0, without speed, heading error and drift."""
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
    """Apply sensor errors and the command to the true readings in an observation.

    ``step`` is the number of the control step. ``schedule`` (steps, 2) is the commanded speed [m/s]
    and yaw rate [rad/s], whose last row stays in force; ``base_quat`` (4,) is
    rotation_base_to_world.
    """
    apply_sensor_errors(sensors, step, base_quat, gait.observation)
    row = min(step, schedule.shape[0] - 1)
    follow_command(walker, gait, schedule[row, 0], schedule[row, 1])


@njit(cache=True)
def follow_command(walker: WalkerArrays, gait: GaitState, forward: float, yaw_rate: float) -> None:
    """Complete an observation after its readings: drift, heading error, command in force, phase.

    The command in force follows the given speed ``forward`` [m/s] and ``yaw_rate`` [rad/s], to the
    left, at a bounded rate and within the robot's range, up to MAX_COMMAND times its highest speed.
    The heading error ψ is the integral of the observed heading rate minus the commanded yaw rate.
    The drift is the integral of v sin ψ with the commanded speed v. Without the observed drift, a
    robot that pulls to one side would keep a small constant heading error, and leave the path. The
    observed drift, heading error and phase fade to 0 as the robot stops.
    """
    observation = gait.observation
    velocity = gait.velocity_command

    forward = min(MAX_COMMAND * walker.max_speed, max(walker.min_speed, forward))
    yaw_rate = min(walker.max_yaw_rate, max(-walker.max_yaw_rate, yaw_rate))
    ramp_share = walker.control_dt / RAMP  # share of the ramp in a control step
    max_speed_step = ramp_share * walker.max_speed
    max_yaw_step = ramp_share * walker.max_yaw_rate
    speed_step = forward - velocity[0]
    yaw_step = yaw_rate - velocity[1]
    velocity[0] += min(max_speed_step, max(-max_speed_step, speed_step))
    velocity[1] += min(max_yaw_step, max(-max_yaw_step, yaw_step))

    moving_share = gait_share(walker, velocity[0], velocity[1])
    gait.scalars[_COMMANDED_HEADING] += walker.control_dt * velocity[1]
    if moving_share > 0.0:  # a standing robot would integrate its gyroscope's bias
        gait.scalars[_HEADING] += walker.control_dt * (heading_rate(observation) - velocity[1])
    heading = min(MAX_HEADING_ERROR, max(-MAX_HEADING_ERROR, gait.scalars[_HEADING]))
    gait.scalars[_HEADING] = heading

    # The drift fades out below a tenth of the highest speed: a robot that has turned on the spot
    # begins a new path.
    drift = gait.scalars[_DRIFT] + walker.control_dt * velocity[0] * math.sin(heading)
    max_drift = MAX_DRIFT * walker.max_speed
    speed_share = gait_share(walker, velocity[0], 0.0)
    gait.scalars[_DRIFT] = speed_share * min(max_drift, max(-max_drift, drift))

    # The observed drift is positive to the left of the direction of motion, not of the body. So the
    # same turn corrects it in forward and in backward motion.
    direction = math.copysign(1.0, velocity[0])
    first = observation.shape[0] - NUM_COMMAND_OBSERVATIONS
    observation[first] = direction * gait.scalars[_DRIFT]
    observation[first + 1] = moving_share * gait.scalars[_HEADING]
    observation[first + 2] = velocity[0]
    observation[first + 3] = velocity[1]
    phase_angle = 2.0 * math.pi * gait.scalars[_PHASE]
    observation[first + 4] = moving_share * math.cos(phase_angle)
    observation[first + 5] = moving_share * math.sin(phase_angle)


@njit(cache=True)
def levelling(walker: WalkerArrays, observation: np.ndarray) -> tuple[float, float]:
    """Slope of the legs' extension, forward and to the left [m/m].

    It is the extension of a leg per distance of its foot from the origin: levelling_gain · (tilt +
    LEVEL_RATE · rate of the tilt). The legs on the low side of a tilted robot extend, which
    stiffens a robot on soft motors against tilt.
    """
    forward = observation[1] + LEVEL_RATE * observation[3]
    left = -observation[0] - LEVEL_RATE * observation[2]
    return walker.levelling_gain * forward, walker.levelling_gain * left


@njit(cache=True)
def command_step(walker: WalkerArrays, gait: GaitState, action: np.ndarray) -> None:
    """Convert an action to the position targets ``gait.target``, and advance the phase.

    The (actions,) action is clipped to [-1, 1], low-passed and scaled. Targets are gait + lead ·
    rate of the gait + support + residual. Their rate is at most MAX_TARGET_SPEED, and they stay
    within the joint limits. The support compensates the PD's deflection under the weight. The lead
    [s] compensates the PD's damping: it acts on joint_vel and not on the velocity error, so that a
    moving joint lags its target by kd/kp times its speed.
    """
    policy.low_pass(action, walker.control_dt, gait.filtered)
    policy.scale_action(walker, gait.filtered, gait.scaled_action)
    joints = gait.target.shape[0]
    modulation = gait.scaled_action[joints:]

    moving_share = gait_share(walker, gait.velocity_command[0], gait.velocity_command[1])
    frequency = float(modulation[policy.FREQUENCY])
    ratio = float(modulation[policy.SWING_STANCE_RATIO])
    height = float(modulation[policy.HEIGHT])
    stride_scale = modulation[policy.STRIDE_SCALE]
    forward = stride_scale * gait.velocity_command[0]
    turn = moving_share * modulation[policy.TURN]
    yaw_rate = stride_scale * gait.velocity_command[1] + turn
    lift = moving_share * walker.swing_height
    slope = levelling(walker, gait.observation)

    # joint angles of the gait, now and one control step later
    gait_now = gait.gait_pos[0]
    gait_later = gait.gait_pos[1]
    phase = float(gait.scalars[_PHASE])
    next_phase = advance_phase(phase, frequency, walker.control_dt)
    joint_targets(walker, phase, forward, yaw_rate, frequency, height, slope, ratio, lift, gait_now)
    joint_targets(
        walker, next_phase, forward, yaw_rate, frequency, height, slope, ratio, lift, gait_later
    )

    # what the targets add to the gait: residual, lead and support
    addition = gait.scaled_action
    for joint in range(joints):
        advance = gait_later[joint] - gait_now[joint]
        addition[joint] += walker.lead[joint] * advance / walker.control_dt
    add_support(walker, phase, ratio, moving_share, gait_now, addition)

    max_change = MAX_TARGET_SPEED * walker.control_dt
    for joint in range(joints):
        change = gait_now[joint] + addition[joint] - gait.target[joint]
        target = gait.target[joint] + min(max_change, max(-max_change, change))
        gait.target[joint] = min(walker.upper[joint], max(walker.lower[joint], target))

    gait.scalars[_PHASE] = next_phase


@njit(cache=True)
def evaluate_step(
    walker: WalkerArrays, gait: GaitState, state: RobotState, weights: np.ndarray
) -> tuple[float, bool]:
    """Write readings from the state after the physics; returns reward [m] and end of the episode.

    The episode ends if the robot fell or the engine had a fault. After a fault the reward is 0 and
    the observation stays as it was, since the state is invalid. ``weights`` (8,) are
    `TaskWeights.array()`.
    """
    if state.fault != 0:
        return 0.0, True

    observe(walker, state, gait.observation)
    roll, pitch, yaw = roll_pitch_yaw(state.base_quat)
    has_fallen = fallen(roll, pitch, state.base_pos[2], walker.min_height, walker.max_height)

    # low-passed speeds along the robot's own heading
    scalars = gait.scalars
    cosine = math.cos(yaw)
    sine = math.sin(yaw)
    velocity = state.base_lin_vel
    filter_weight = 1.0 - math.exp(-walker.control_dt / SPEED_FILTER)
    forward_change = cosine * velocity[0] + sine * velocity[1] - scalars[_FORWARD]
    left_change = cosine * velocity[1] - sine * velocity[0] - scalars[_LEFT]
    scalars[_FORWARD] += filter_weight * forward_change
    scalars[_LEFT] += filter_weight * left_change

    speed_error = scalars[_FORWARD] - gait.velocity_command[0]
    scalars[_SPEED_ERRORS] += abs(speed_error)
    heading_error = wrapped(yaw - scalars[_COMMANDED_HEADING])
    yaw_rate_error = state.base_ang_vel[2] - gait.velocity_command[1]
    effort = state.torque_squared_sum / (walker.reference_torque * walker.reference_torque)
    slip = sliding(walker, gait.feet, state, pitch, yaw)

    reward = weights[0] if not has_fallen else 0.0
    reward -= weights[1] * abs(speed_error) + weights[2] * abs(scalars[_LEFT])
    reward -= weights[3] * abs(heading_error) + weights[4] * abs(yaw_rate_error)
    reward -= weights[5] * (abs(roll) + abs(pitch))
    reward -= weights[6] * effort
    reward -= weights[7] * slip
    return walker.control_dt * reward, has_fallen


MAX_TILT = 0.4  # roll or pitch of a robot that has not fallen [rad]
# time constant of the filtered speed [s], about a step of a leg: speed varies within a step
SPEED_FILTER = 0.3
# a foot is on the ground if its lowest point is below this height [m]
REWARD_CONTACT_HEIGHT = 0.002


@dataclass(frozen=True)
class TaskWeights:
    """Weights of the reward of a control step, at least 0.

    The reward is control_dt · (alive - Σ weight · |error|) [m].
    """

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
    """Write the first 5 + joints entries of an observation.

    They are roll and pitch [rad], the three body rates [rad/s], and the joint angles relative to
    the nominal pose [rad].
    """
    observation[0] = roll
    observation[1] = pitch
    for axis in range(3):
        observation[2 + axis] = rates[axis]
    for joint in range(walker.nominal_pose.shape[0]):
        observation[NUM_IMU_READINGS + joint] = joint_pos[joint] - walker.nominal_pose[joint]


@njit(cache=True)
def observe(walker: WalkerArrays, state: RobotState, observation: np.ndarray) -> None:
    """Write the readings of a state to an observation; see `write_readings`."""
    roll, pitch, _ = roll_pitch_yaw(state.base_quat)
    write_readings(walker, roll, pitch, state.base_ang_vel, state.measured_joint_pos, observation)


@njit(cache=True)
def heading_rate(observation: np.ndarray) -> float:
    """Rate of the heading from observed attitude and rates [rad/s].

    The rate is (ω_y sin φ + ω_z cos φ) / cos θ with roll φ and pitch θ.
    """
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
    """Sum over the feet on the ground of their sliding speed [m/s].

    The sliding of a foot is the displacement of its centre less its rolling, which is radius times
    rotation of the shank. A foot of unknown position (NaN) counts as 0. ``feet`` (legs, 4) is
    `GaitState.feet` of one control step ago, and gets the present values. ``pitch`` and ``yaw`` are
    angles of the robot's base [rad].
    """
    total = 0.0
    cosine = math.cos(yaw)
    sine = math.sin(yaw)
    joint_pos = state.measured_joint_pos

    for leg in range(walker.legs.shape[0]):
        hip = walker.legs[leg, 1]
        knee = walker.legs[leg, 2]
        shank_angle = pitch + joint_pos[hip] + joint_pos[knee]
        radius = walker.foot_radius[leg]
        max_height = radius + REWARD_CONTACT_HEIGHT
        last_foot = feet[leg]
        foot = state.foot_pos[leg]

        # a comparison with NaN, an unknown position, is false
        if foot[2] < max_height and last_foot[2] < max_height:
            rolled = radius * (shank_angle - last_foot[3])
            x = foot[0] - last_foot[0] - rolled * cosine
            y = foot[1] - last_foot[1] - rolled * sine
            total += math.sqrt(x * x + y * y) / walker.control_dt

        last_foot[:3] = foot
        last_foot[3] = shank_angle
    return total


@njit(cache=True)
def fallen(roll: float, pitch: float, height: float, lowest: float, highest: float) -> bool:
    """Whether the robot has fallen or taken off.

    This is so if |roll| or |pitch| exceeds MAX_TILT, if the height [m] is outside [lowest,
    highest], or if one of them is NaN.
    """
    upright = abs(roll) <= MAX_TILT and abs(pitch) <= MAX_TILT
    return not (upright and lowest <= height <= highest)


class SensorErrors(NamedTuple):
    """Sensor errors of one episode, for compiled code."""

    # (observations, readings) noise that is added to each observation; no rows without noise
    noise: np.ndarray
    ages: np.ndarray  # (observations,) age of the readings in each observation [control steps]
    # (rows, readings) delay line of true readings, which each observation changes; no rows without
    # delay
    past: np.ndarray
    # (3,) unit vector against gravity in the world; on a slope it is not the normal of the ground
    up: np.ndarray


def perfect_sensors() -> SensorErrors:
    """Sensors without noise and delay, on level ground."""
    return SensorErrors(np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0)), np.array([0.0, 0.0, 1.0]))


@njit(cache=True, nogil=True)
def apply_sensor_errors(
    sensors: SensorErrors, count: int, base_quat: np.ndarray, observation: np.ndarray
) -> None:
    """Replace the true readings of an observation by the measured ones.

    True roll and pitch are relative to the ground, measured roll and pitch relative to gravity. An
    age between two control steps interpolates linearly between their readings. Readings from before
    the reset equal the readings at the reset. ``count`` is the number of earlier observations since
    the reset; ``base_quat`` (4,) is rotation_base_to_world.
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
