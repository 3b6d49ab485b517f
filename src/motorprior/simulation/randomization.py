"""Domain randomization of robot, sensors and surroundings. Off by default.

One `EpisodeConditions` is sampled per episode; both engines apply it without compiling the model
again. The motors of an episode are sampled by `DrawMotors` from another random stream, so that
enabling a range changes no motor.
"""

from dataclasses import dataclass, fields

import numpy as np

from motorprior.actuator.actuator import Factors
from motorprior.bounds import require_number, require_range
from motorprior.locomotion.body import NUM_IMU_READINGS
from motorprior.locomotion.control_step import SensorErrors, perfect_sensors
from motorprior.robots.robot import GRAVITY, Robot

MAX_DELAY = 0.2  # [s] of sensors and commands
_STREAM = 0xD12A
_SENSOR_STREAM = 0x5E50
_MOTOR_STREAM = 0x307A
Range = tuple[float, float]


@dataclass(frozen=True)
class Randomization:
    """Ranges of uniform distributions, sampled in every episode; the defaults change nothing.

    ConfigError for a range whose first number is larger, or a value out of bounds or of another
    type.
    """

    armature: Range = (0.0, 0.0)  # range of the reflected inertia added to each joint [kg·m²]
    damping: Range = (0.0, 0.0)  # range of the passive damping added to each joint [N·m·s/rad]
    # range of the factor on torque and damping of each motor, its friction included [-]
    strength: Range = (1.0, 1.0)
    kp: Range = (1.0, 1.0)  # range of the factor on kp of each motor [-]
    kd: Range = (1.0, 1.0)  # range of the factor on kd of each motor [-]
    torque_limit: Range = (1.0, 1.0)  # range of the factor on the torque limit of each motor [-]
    coulomb: Range = (1.0, 1.0)
    """Range of the factor on the dry friction of each motor, without its load-dependent part [-]."""
    friction: Range = (1.0, 1.0)  # range of the factor on the friction of the feet [-]
    mass: Range = (1.0, 1.0)  # range of the factor on mass and inertia of each link [-]
    com: float = 0.0  # largest shift of the chassis' centre of mass along each axis [m]
    gravity_tilt: float = 0.0
    """Largest angle between gravity and the normal of the ground [rad], equivalent to a slope. Roll and pitch are
    observed relative to gravity; reward and termination use them relative to the ground."""
    # largest error of each encoder's zero [rad]; it also acts in the motor's control loop
    encoder_offset: float = 0.0
    joint_noise: float = 0.0  # standard deviation of white noise on the observed joint angles [rad]
    # standard deviation of white noise on the observed roll and pitch [rad]
    tilt_noise: float = 0.0
    rate_noise: float = 0.0  # standard deviation of white noise on the observed rates [rad/s]
    gyro_bias: float = 0.0
    """Standard deviation of the constant error of each observed rate [rad/s]; the integrated heading drifts."""
    sensor_delay: Range = (0.0, 0.0)  # range of the age of the observations [s]
    sensor_jitter: float = 0.0  # largest additional age of a single reading [s]
    dropped: float = 0.0  # share of lost sensor frames; the policy uses the last one received [-]
    # range of the age of the motors' position targets [s], rounded to physics steps
    command_delay: Range = (0.0, 0.0)
    command_jitter: float = 0.0  # largest additional age of a single target [s]
    # largest horizontal impulse on the chassis [N·s], spread over one control step
    push: float = 0.0
    push_interval: float = 1.0  # time between two pushes [s]

    def __post_init__(self) -> None:
        lower = dict.fromkeys(("friction", "strength", "kp", "kd", "torque_limit"), 0.01)
        lower |= {"mass": 0.1, "push_interval": 1e-3}
        upper = dict.fromkeys(
            ("sensor_delay", "command_delay", "sensor_jitter", "command_jitter"), MAX_DELAY
        )
        upper |= {"gravity_tilt": 0.5, "com": 0.1, "dropped": 0.5}
        for field in fields(self):
            value = getattr(self, field.name)
            check = require_number
            if isinstance(field.default, tuple):
                # a list from JSON
                value = tuple(value) if isinstance(value, list) else value
                check = require_range
                object.__setattr__(self, field.name, value)
            check(
                f"randomization.{field.name}",
                value,
                lower.get(field.name, 0.0),
                upper.get(field.name, 1e3),
            )

    def conditions(self, robot: Robot, seed: int, episode_steps: int) -> "EpisodeConditions":
        """Sample the conditions of the robot and its surroundings in the episode of this seed."""
        rng = np.random.default_rng([_STREAM, seed])
        motors = np.random.default_rng([_MOTOR_STREAM, seed])
        joints = robot.num_joints
        up = self._up(rng)
        return EpisodeConditions(
            armature=rng.uniform(*self.armature, joints),
            damping=rng.uniform(*self.damping, joints),
            friction=float(rng.uniform(*self.friction)),
            mass=rng.uniform(*self.mass, robot.num_links),
            com=rng.uniform(-self.com, self.com, 3),
            gravity=-GRAVITY * up,
            encoder_offset=rng.uniform(-self.encoder_offset, self.encoder_offset, joints),
            command_delay=float(rng.uniform(*self.command_delay)),
            push=self._pushes(rng, robot.control_dt, episode_steps),
            command_jitter=rng.uniform(
                0.0, self.command_jitter, episode_steps if self.command_jitter else 0
            ),
            strength=motors.uniform(*self.strength, joints),
            factors=Factors(
                kp=motors.uniform(*self.kp, joints),
                kd=motors.uniform(*self.kd, joints),
                torque_limit=motors.uniform(*self.torque_limit, joints),
                coulomb=motors.uniform(*self.coulomb, joints),
            ),
        )

    def _up(self, rng: np.random.Generator) -> np.ndarray:
        """(3,) unit vector against gravity, from the first two random numbers of an episode's conditions."""
        tilt = self.gravity_tilt * np.sqrt(rng.uniform())
        bearing = rng.uniform(0.0, 2.0 * np.pi)
        across = np.sin(tilt)
        return np.array([-across * np.cos(bearing), -across * np.sin(bearing), np.cos(tilt)])

    def _pushes(
        self, rng: np.random.Generator, control_dt: float, episode_steps: int
    ) -> np.ndarray:
        """(episode_steps, 2) horizontal force [N] in every control step; no rows without pushes."""
        if self.push == 0.0:
            return np.zeros((0, 2))
        force = np.zeros((episode_steps, 2))
        every = max(1, round(self.push_interval / control_dt))
        for step in range(every, episode_steps, every):
            strength = rng.uniform(0.0, self.push)
            bearing = rng.uniform(0.0, 2.0 * np.pi)
            force[step] = strength / control_dt * np.array([np.cos(bearing), np.sin(bearing)])
        return force

    def sensors(self, robot: Robot, seed: int, episode_steps: int) -> SensorErrors:
        """Sample the sensor errors in the episode of this seed, on the slope of its `conditions`."""
        level = perfect_sensors()
        up = self._up(np.random.default_rng([_STREAM, seed]))
        late = self.sensor_delay[1] or self.sensor_jitter or self.dropped
        if not (late or self.joint_noise or self.tilt_noise or self.rate_noise or self.gyro_bias):
            return level._replace(up=up)
        count = NUM_IMU_READINGS + robot.num_joints
        deviation = np.full(count, self.joint_noise)
        deviation[:2] = self.tilt_noise
        deviation[2:NUM_IMU_READINGS] = self.rate_noise
        rng = np.random.default_rng([_SENSOR_STREAM, seed])
        delay = float(rng.uniform(*self.sensor_delay)) / robot.control_dt
        rows = episode_steps + 1 if deviation.any() or self.gyro_bias else 0
        noise = deviation * rng.standard_normal((rows, count))
        noise[:, 2:NUM_IMU_READINGS] += self.gyro_bias * rng.standard_normal(NUM_IMU_READINGS - 2)
        ages = delay + self._jitter(rng, robot.control_dt, episode_steps + 1)
        return SensorErrors(
            noise, ages, np.zeros((int(ages.max()) + 2 if ages.any() else 0, count)), up
        )

    def _jitter(self, rng: np.random.Generator, control_dt: float, observations: int) -> np.ndarray:
        """(observations,) additional ages [control steps] by jitter and lost frames; the first frame is never lost."""
        late = np.zeros(observations)
        if self.sensor_jitter:
            late += self.sensor_jitter / control_dt * rng.uniform(size=observations)
        if self.dropped:
            for lost in np.flatnonzero(rng.uniform(size=observations - 1) < self.dropped) + 1:
                late[lost] = late[lost - 1] + 1.0
        return late


@dataclass(frozen=True, eq=False)
class EpisodeConditions:
    """One sample of the ranges, in the order of the robot's joints and of its model's links."""

    armature: np.ndarray  # (joints,) added [kg·m²]
    damping: np.ndarray  # (joints,) added, passive [N·m·s/rad]
    friction: float  # factor
    mass: np.ndarray  # (links,) factors on mass and inertia
    com: np.ndarray  # (3,) shift of the chassis' centre of mass [m]
    gravity: np.ndarray  # (3,) [m/s²]
    encoder_offset: np.ndarray  # (joints,) reading at true zero [rad]
    command_delay: float  # [s]
    # (steps, 2) horizontal force on the chassis' origin in every control step [N], or (0, 2)
    push: np.ndarray
    # (steps,) additional age of the targets in every control step [s], or (0,)
    command_jitter: np.ndarray
    strength: np.ndarray  # (joints,) factors on torque and damping of the motors
    factors: Factors  # on constants of the motors

    def delay_steps(self, physics_dt: float) -> np.ndarray:
        """(steps,) or (1,) age of the position targets in every control step [physics steps of ``physics_dt`` s]."""
        late = self.command_jitter if len(self.command_jitter) else np.zeros(1)
        return np.round((self.command_delay + late) / physics_dt).astype(np.int64)


def nominal_conditions(robot: Robot) -> EpisodeConditions:
    """Conditions without randomization."""
    return Randomization().conditions(robot, 0, 0)


# For a robot with uncertain floor, load and sensors; the ranges are assumptions.
ROBUST = Randomization(
    friction=(0.7, 1.6), mass=(0.85, 1.15), com=0.01, gravity_tilt=0.05, joint_noise=0.001, tilt_noise=0.002,
    rate_noise=0.01, gyro_bias=0.002, sensor_delay=(0.0, 0.02), push=0.3, push_interval=1.5,
)  # fmt: skip
