"""A simulated robot for the virtual firmware: physical motors, steps of 1 ms, gains that change while it moves."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
from dataclasses import replace

import numpy as np

from motorprior.actuator.actuator import ActuatorArrays
from motorprior.actuator.physical import FILTERED_VEL, PhysicalActuator, PhysicalMotors
from motorprior.bench.families import require_geared
from motorprior.bench.fleet import Fleet
from motorprior.compiled import njit
from motorprior.robots.build_model import FLOOR
from motorprior.robots.robot import MotorCommand, Robot, SensorReadings
from motorprior.rotations import roll_pitch_yaw
from motorprior.simulation.world import World, WorldArrays, physics_step, read_joints

# Standard deviations of the noise on attitude [rad] and rates [rad/s], assumed for a MEMS sensor at
# 100 Hz
IMU_NOISE = (0.002, 0.01)
# separates the motors of virtual robots from those of benches, training and transfer studies
_STREAM = 0x7710


def draw_motors(robot: Robot, fleet: Fleet, seed: int) -> PhysicalMotors:
    """The motors of virtual robot number ``seed``, whose firmware sets their gains; ConfigError unless geared."""
    return require_geared(fleet.sample(robot.num_joints, np.random.default_rng([_STREAM, seed])))


@njit(cache=True, nogil=True)
def _advance(world: WorldArrays, motors: ActuatorArrays, target: np.ndarray, steps: int) -> None:
    for _ in range(steps):
        physics_step(world, motors, target)


class SimulatedRobot:
    """A `hardware.virtual_robot.RobotBody`, on its belly with folded legs at first, or suspended.

    Unlike in training, the chassis collides with the floor, so that a robot without current lies on
    it. The gains and torque limits of ``motors`` are those at the wire's own gains and current
    limit; ``seed`` is of the IMU's noise.
    """

    def __init__(self, robot: Robot, motors: PhysicalMotors, suspended: bool, seed: int):
        self._wire = robot.require_wire()
        self._motors = motors
        self._suspended = suspended
        self._signs = self._wire.joint_signs
        self._dt = robot.twin_physics_dt
        self._rng = np.random.default_rng([_STREAM, seed, 1])
        self._command = None
        self._world = World(robot, self._dt, suspended)
        model = self._world.model
        floor = model.geom(FLOOR).id
        base = model.body(1)
        model.geom_contype[floor] = model.body_contype[0] = 1
        model.geom_conaffinity[base.geomadr[0]] = model.body_conaffinity[base.id] = 1
        folded = self._wire.folded_pose
        self._arrays = self._world.reset(PhysicalActuator(motors), folded)
        if not suspended:
            self._world.data.qpos[2] = max(leg.hip_height(folded) for leg in robot.legs)
        _advance(self._world.arrays, self._arrays, folded, 0)  # compile before real time starts

    def advance(self, milliseconds: int, command: MotorCommand) -> None:
        """Simulate under a constant command; each motor keeps its torque per ampere."""
        motors = self._motors
        wire = self._wire
        scaled = replace(
            motors,
            kp=motors.kp * command.kp / wire.kp,
            kd=motors.kd * command.kd / wire.kd,
            torque_limit=motors.torque_limit * (command.max_current / wire.max_current),
        )
        self._arrays.parameters[:] = PhysicalActuator(scaled).arrays(self._dt).parameters
        self._command = command
        _advance(
            self._world.arrays,
            self._arrays,
            np.ascontiguousarray(self._signs * command.target),
            milliseconds,
        )

    def sense(self) -> SensorReadings:
        """The present readings; the current is that of the control law at the present target."""
        data = self._world.data
        measured = np.zeros(len(self._signs))
        read_joints(self._world.arrays, self._arrays, measured)
        noise = self._rng.standard_normal(6)
        attitude = np.zeros(3)
        rates = np.zeros(3)
        if not self._suspended:
            attitude = np.array(roll_pitch_yaw(data.qpos[3:7]))
            rates = data.qvel[3:6]
        count = 2.0 * np.pi / self._wire.encoder_counts
        pos = self._signs * (count * np.round(measured / count))
        vel = self._signs * self._arrays.memory[FILTERED_VEL]
        current = np.zeros_like(pos) if self._command is None else self._command.current(pos, vel)
        return SensorReadings(
            pos, vel, current, attitude + IMU_NOISE[0] * noise[:3], rates + IMU_NOISE[1] * noise[3:]
        )

    def position(self) -> np.ndarray:
        """(2,) horizontal position of the base [m]."""
        return np.zeros(2) if self._suspended else self._world.data.qpos[:2].copy()
