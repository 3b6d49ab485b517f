"""A simulated robot for the virtual firmware.

It has physical motors, steps of 1 ms, and gains that change while it moves.
"""

from dataclasses import replace

import numpy as np

from motorprior.actuator.arrays import ActuatorArrays
from motorprior.actuator.families import require_geared
from motorprior.actuator.fleet import Fleet
from motorprior.actuator.physical import FILTERED_VEL, PhysicalActuator, PhysicalMotors
from motorprior.compiled import njit
from motorprior.robots.build_model import FLOOR
from motorprior.robots.robot import MotorCommand, Robot, SensorReadings
from motorprior.rotations import roll_pitch_yaw
from motorprior.simulation.physics import WorldArrays, physics_step, read_joints
from motorprior.simulation.world import World

# Standard deviations of the IMU's noise, assumed for a MEMS sensor at 100 Hz
ATTITUDE_NOISE = 0.002  # [rad]
RATE_NOISE = 0.01  # [rad/s]
# separates the motors of virtual robots from those of benches, training and transfer studies
_STREAM = 0x7710


def draw_motors(robot: Robot, fleet: Fleet, seed: int) -> PhysicalMotors:
    """The motors of virtual robot number ``seed``, whose firmware sets their gains.

    ConfigError if the motors of the fleet are not geared.
    """
    rng = np.random.default_rng([_STREAM, seed])
    return require_geared(fleet.sample(robot.num_joints, rng))


@njit(cache=True, nogil=True)
def _advance(world: WorldArrays, motors: ActuatorArrays, target: np.ndarray, steps: int) -> None:
    for _ in range(steps):
        physics_step(world, motors, target)


class SimulatedRobot:
    """`RobotMechanics` of a virtual robot, on its belly with folded legs at first, or suspended.

    Unlike in training, the chassis collides with the floor, so that a robot without current lies on
    it.

    Args:
        robot: a robot with a wire.
        motors: motors whose gains and torque limits are those at the wire's own gains and current
            limit.
        suspended: suspend the robot in the air.
        seed: seed of the IMU's noise.
    """

    def __init__(self, robot: Robot, motors: PhysicalMotors, suspended: bool, seed: int):
        self._wire = robot.require_wire()
        self._physical_motors = motors
        self._suspended = suspended
        self._signs = self._wire.joint_signs
        self._dt = robot.twin_physics_dt
        self._rng = np.random.default_rng([_STREAM, seed, 1])
        self._command: MotorCommand | None = None

        self._world = World(robot, self._dt, suspended)
        model = self._world.model
        floor = model.geom(FLOOR).id
        base = model.body(1)
        model.geom_contype[floor] = 1
        model.body_contype[0] = 1
        model.geom_conaffinity[base.geomadr[0]] = 1
        model.body_conaffinity[base.id] = 1

        folded = self._wire.folded_pose
        self._simulation = self._world.reset(PhysicalActuator(motors), folded)
        if not suspended:
            self._world.data.qpos[2] = max(leg.hip_height(folded) for leg in robot.legs)
        # compile before real time starts
        _advance(self._simulation.arrays, self._simulation.motors, folded, 0)

    def advance(self, milliseconds: int, command: MotorCommand) -> None:
        """Simulate under a constant command; each motor keeps its torque per ampere."""
        motors = self._physical_motors
        wire = self._wire
        motors_at_command = replace(
            motors,
            kp=motors.kp * command.kp / wire.kp,
            kd=motors.kd * command.kd / wire.kd,
            torque_limit=motors.torque_limit * (command.max_current / wire.max_current),
        )
        parameters = PhysicalActuator(motors_at_command).arrays(self._dt).parameters
        self._simulation.motors.parameters[:] = parameters

        self._command = command
        target = np.ascontiguousarray(self._signs * command.target)
        _advance(self._simulation.arrays, self._simulation.motors, target, milliseconds)

    def sense(self) -> SensorReadings:
        """The present readings; the current is that of the control law at the present target."""
        data = self._world.data
        measured = np.zeros(len(self._signs))
        read_joints(self._simulation.arrays, self._simulation.motors, measured)

        noise = self._rng.standard_normal(6)
        attitude = np.zeros(3)
        rates = np.zeros(3)
        if not self._suspended:
            attitude = np.array(roll_pitch_yaw(data.qpos[3:7]))
            rates = data.qvel[3:6]

        count = 2.0 * np.pi / self._wire.encoder_counts
        pos = self._signs * (count * np.round(measured / count))
        vel = self._signs * self._simulation.motors.memory[FILTERED_VEL]
        current = np.zeros_like(pos) if self._command is None else self._command.current(pos, vel)
        return SensorReadings(
            pos,
            vel,
            current,
            attitude + ATTITUDE_NOISE * noise[:3],
            rates + RATE_NOISE * noise[3:],
        )

    def position(self) -> np.ndarray:
        """(2,) horizontal position of the base [m]."""
        return np.zeros(2) if self._suspended else self._world.data.qpos[:2].copy()
