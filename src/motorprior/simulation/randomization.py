"""Domain randomization of robot, sensors and surroundings. Off by default.

One `Domain` is sampled per episode; both engines apply it without compiling the model again. The
motors of an episode are sampled by `DrawMotors` from another random stream, so that enabling a
range changes no motor.
"""

from dataclasses import Field, dataclass, fields

import numpy as np

from motorprior.actuator.actuator import ConstantFactors
from motorprior.bounds import require_number, require_range
from motorprior.locomotion.control_step import SensorErrors, perfect_sensors
from motorprior.locomotion.gait import NUM_IMU_READINGS
from motorprior.robots.robot import GRAVITY, Robot

MAX_DELAY = 0.2  # maximum delay of sensors and of commands [s]
# tags of random streams: of the robot and its surroundings, of sensors, and of motors
_DOMAIN_STREAM = 0xD12A
_SENSOR_STREAM = 0x5E50
_MOTOR_STREAM = 0x307A
# lower and upper bounds of the values in `Randomization`; 0 and 1000 for values that are not here
_MIN_VALUES = {
    "friction": 0.01,
    "strength": 0.01,
    "kp": 0.01,
    "kd": 0.01,
    "torque_limit": 0.01,
    "mass": 0.1,
    "push_interval": 1e-3,
}
_MAX_VALUES = {
    "sensor_delay": MAX_DELAY,
    "command_delay": MAX_DELAY,
    "sensor_jitter": MAX_DELAY,
    "command_jitter": MAX_DELAY,
    "gravity_tilt": 0.5,
    "com": 0.1,
    "dropped": 0.5,
}

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
    """Range of the factor on each motor's dry friction without its load-dependent part [-]."""
    friction: Range = (1.0, 1.0)  # range of the factor on the friction of the feet [-]
    mass: Range = (1.0, 1.0)  # range of the factor on mass and inertia of each link [-]
    com: float = 0.0  # largest shift of the chassis' centre of mass along each axis [m]
    gravity_tilt: float = 0.0
    """Largest angle between gravity and the normal of the ground [rad], equivalent to a slope. Roll
    and pitch are observed relative to gravity; reward and termination use them relative to the
    ground."""
    # largest error of each encoder's zero [rad]; it also acts in the motor's control loop
    encoder_offset: float = 0.0
    joint_noise: float = 0.0  # standard deviation of white noise on the observed joint angles [rad]
    # standard deviation of white noise on the observed roll and pitch [rad]
    tilt_noise: float = 0.0
    rate_noise: float = 0.0  # standard deviation of white noise on the observed rates [rad/s]
    gyro_bias: float = 0.0
    """Standard deviation of the constant error of each observed rate [rad/s]; the integrated
    heading drifts."""
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
        for field in fields(self):
            self._require_valid(field)

    def _require_valid(self, field: Field) -> None:
        name = f"randomization.{field.name}"
        value = getattr(self, field.name)
        minimum = _MIN_VALUES.get(field.name, 0.0)
        maximum = _MAX_VALUES.get(field.name, 1e3)
        if not isinstance(field.default, tuple):
            require_number(name, value, minimum, maximum)
            return

        if isinstance(value, list):  # from JSON
            value = tuple(value)
        object.__setattr__(self, field.name, value)
        require_range(name, value, minimum, maximum)

    def domain(self, robot: Robot, seed: int, episode_steps: int) -> "Domain":
        """Sample the robot and its surroundings in the episode of this seed."""
        rng = np.random.default_rng([_DOMAIN_STREAM, seed])
        motor_rng = np.random.default_rng([_MOTOR_STREAM, seed])
        joints = robot.num_joints
        jitter_steps = episode_steps if self.command_jitter else 0
        up = self._up(rng)

        return Domain(
            armature=rng.uniform(*self.armature, joints),
            damping=rng.uniform(*self.damping, joints),
            friction=float(rng.uniform(*self.friction)),
            mass=rng.uniform(*self.mass, robot.num_links),
            com=rng.uniform(-self.com, self.com, 3),
            gravity=-GRAVITY * up,
            encoder_offset=rng.uniform(-self.encoder_offset, self.encoder_offset, joints),
            command_delay=float(rng.uniform(*self.command_delay)),
            push=self._pushes(rng, robot.control_dt, episode_steps),
            command_jitter=rng.uniform(0.0, self.command_jitter, jitter_steps),
            strength=motor_rng.uniform(*self.strength, joints),
            factors=ConstantFactors(
                kp=motor_rng.uniform(*self.kp, joints),
                kd=motor_rng.uniform(*self.kd, joints),
                torque_limit=motor_rng.uniform(*self.torque_limit, joints),
                coulomb=motor_rng.uniform(*self.coulomb, joints),
            ),
        )

    def _up(self, rng: np.random.Generator) -> np.ndarray:
        """(3,) unit vector against gravity.

        ``rng`` is the domain's generator before its first random number: `domain` and `sensors` get
        the same vector for the same seed.
        """
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
        interval = max(1, round(self.push_interval / control_dt))
        for step in range(interval, episode_steps, interval):
            impulse = rng.uniform(0.0, self.push)
            bearing = rng.uniform(0.0, 2.0 * np.pi)
            direction = np.array([np.cos(bearing), np.sin(bearing)])
            force[step] = impulse / control_dt * direction
        return force

    def sensors(self, robot: Robot, seed: int, episode_steps: int) -> SensorErrors:
        """Sample the sensor errors in the episode of this seed, on the slope of its `domain`."""
        up = self._up(np.random.default_rng([_DOMAIN_STREAM, seed]))
        sensors_on_slope = perfect_sensors()._replace(up=up)
        has_delay = bool(self.sensor_delay[1] or self.sensor_jitter or self.dropped)
        has_noise = bool(self.joint_noise or self.tilt_noise or self.rate_noise)
        if not (has_delay or has_noise or self.gyro_bias):
            return sensors_on_slope

        readings = NUM_IMU_READINGS + robot.num_joints
        deviation = np.full(readings, self.joint_noise)
        deviation[:2] = self.tilt_noise
        deviation[2:NUM_IMU_READINGS] = self.rate_noise

        rng = np.random.default_rng([_SENSOR_STREAM, seed])
        delay = float(rng.uniform(*self.sensor_delay)) / robot.control_dt

        noise_rows = episode_steps + 1 if deviation.any() or self.gyro_bias else 0
        noise = deviation * rng.standard_normal((noise_rows, readings))
        bias = self.gyro_bias * rng.standard_normal(NUM_IMU_READINGS - 2)
        noise[:, 2:NUM_IMU_READINGS] += bias

        ages = delay + self._jitter(rng, robot.control_dt, episode_steps + 1)
        # rows of the delay line: the oldest reading lies between two of them
        delay_rows = 0
        if ages.any():
            delay_rows = int(ages.max()) + 2
        past = np.zeros((delay_rows, readings))
        return sensors_on_slope._replace(noise=noise, ages=ages, past=past)

    def _jitter(self, rng: np.random.Generator, control_dt: float, observations: int) -> np.ndarray:
        """(observations,) additional ages by jitter and lost frames [control steps].

        The first frame is never lost.
        """
        ages = np.zeros(observations)
        if self.sensor_jitter:
            ages += self.sensor_jitter / control_dt * rng.uniform(size=observations)
        if self.dropped:
            is_lost = rng.uniform(size=observations - 1) < self.dropped
            for frame in np.flatnonzero(is_lost) + 1:
                ages[frame] = ages[frame - 1] + 1.0
        return ages


@dataclass(frozen=True, eq=False)
class Domain:
    """Robot and surroundings of one episode: a sample of the ranges of `Randomization`.

    Arrays are in the order of the robot's joints and of its model's links.
    """

    armature: np.ndarray  # (joints,) added reflected inertia [kg·m²]
    damping: np.ndarray  # (joints,) added passive damping [N·m·s/rad]
    friction: float  # factor on the friction of the feet
    mass: np.ndarray  # (links,) factors on mass and inertia
    com: np.ndarray  # (3,) shift of the chassis' centre of mass [m]
    gravity: np.ndarray  # (3,) [m/s²]
    encoder_offset: np.ndarray  # (joints,) reading at true zero [rad]
    command_delay: float  # age of the position targets [s]
    # (steps, 2) horizontal force on the chassis' origin in every control step [N], or (0, 2)
    push: np.ndarray
    # (steps,) additional age of the targets in every control step [s], or (0,)
    command_jitter: np.ndarray
    strength: np.ndarray  # (joints,) factors on torque and damping of the motors
    factors: ConstantFactors  # factors on constants of the motors

    def delay_steps(self, physics_dt: float) -> np.ndarray:
        """(steps,) or (1,) age of the position targets in every control step.

        The unit is a physics step of ``physics_dt`` s.
        """
        jitter = self.command_jitter if len(self.command_jitter) else np.zeros(1)
        return np.round((self.command_delay + jitter) / physics_dt).astype(np.int64)


def nominal_domain(robot: Robot) -> Domain:
    """The robot and its surroundings without randomization."""
    return Randomization().domain(robot, 0, 0)


# For a robot with uncertain floor, load and sensors; the ranges are assumptions.
ROBUST = Randomization(
    friction=(0.7, 1.6),
    mass=(0.85, 1.15),
    com=0.01,
    gravity_tilt=0.05,
    joint_noise=0.001,
    tilt_noise=0.002,
    rate_noise=0.01,
    gyro_bias=0.002,
    sensor_delay=(0.0, 0.02),
    push=0.3,
    push_interval=1.5,
)
