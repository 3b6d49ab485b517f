"""A simulated robot for the virtual firmware: physical motors, steps of 1 ms, gains that change while it moves."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from motorprior.actuator.actuator import ActuatorArrays
from motorprior.actuator.physical import FILTERED_VEL, MotorParameters, PhysicalActuator
from motorprior.compiled import njit
from motorprior.robots.build_model import FLOOR
from motorprior.robots.robot import Robot
from motorprior.rotations import roll_pitch_yaw
from motorprior.simulation.world import World
from motorprior.simulation.world_step import WorldArrays, physics_step, read_joints

# Standard deviations of the noise on attitude [rad] and rates [rad/s], assumed for a MEMS sensor at 100 Hz
IMU_NOISE = (0.002, 0.01)


@dataclass(frozen=True)
class SimulatedState:
    """Sensor readings."""

    joint_pos: np.ndarray  # (joints,) [rad]
    joint_vel: np.ndarray  # (joints,) [rad/s]
    attitude: np.ndarray  # (3,) roll, pitch, yaw [rad]
    rates: np.ndarray  # (3,) [rad/s]


@njit(cache=True, nogil=True)
def _advance(world: WorldArrays, motors: ActuatorArrays, target: np.ndarray, steps: int) -> None:
    for _ in range(steps):
        physics_step(world, motors, target)


class SimulatedRobot:
    """A simulated robot, lying with folded legs at first, or suspended.

    Unlike in training, the chassis collides with the floor, so that a robot without current lies on it.

    The motors' gains and torque limits are those at the wire's own gains and current limit; ``rng`` is the IMU's noise.
    """

    def __init__(self, robot: Robot, motors: MotorParameters, suspended: bool, rng: np.random.Generator):
        self._robot, self._wire = robot, robot.require_wire()
        self._world = World(robot, robot.twin_physics_dt, suspended)
        self._motors, self._rng, self._suspended = motors, rng, suspended
        model = self._world.model
        floor, base = model.geom(FLOOR).id, model.body(1)
        model.geom_contype[floor] = model.body_contype[0] = 1
        model.geom_conaffinity[base.geomadr[0]] = model.body_conaffinity[base.id] = 1
        folded = self._wire.folded_pose
        self._arrays = self._world.reset(PhysicalActuator(motors), folded)
        if not suspended:
            self._world.data.qpos[2] = max(leg.hip_height(folded) for leg in robot.legs)
        self.advance(0, folded)  # compile, or load compiled code, before real time starts

    def set_gains(self, kp: np.ndarray, kd: np.ndarray, max_current: float) -> None:
        """Set gains (joints,) [A/rad], [A·s/rad] and current limit [A]; each motor keeps its torque per ampere."""
        motors = replace(
            self._motors,
            kp=self._motors.kp * kp / self._wire.kp,
            kd=self._motors.kd * kd / self._wire.kd,
            torque_limit=self._motors.torque_limit * (max_current / self._wire.max_current),
        )
        self._arrays.parameters[:] = PhysicalActuator(motors).arrays(self._robot.twin_physics_dt).parameters

    def advance(self, milliseconds: int, target: np.ndarray) -> None:
        """Simulate under (joints,) targets [rad]."""
        _advance(self._world.arrays, self._arrays, np.ascontiguousarray(target, dtype=np.float64), milliseconds)

    def position(self) -> np.ndarray:
        """(2,) horizontal position of the base [m]."""
        return np.zeros(2) if self._suspended else self._world.data.qpos[:2].copy()

    def state(self) -> SimulatedState:
        """The present state."""
        data, measured = self._world.data, np.zeros(self._robot.num_joints)
        read_joints(self._world.arrays, self._arrays, measured)
        noise = self._rng.standard_normal(6)
        attitude, rates = np.zeros(3), np.zeros(3)
        if not self._suspended:
            attitude, rates = np.array(roll_pitch_yaw(data.qpos[3:7])), data.qvel[3:6]
        count = 2.0 * np.pi / self._wire.encoder_counts
        return SimulatedState(
            joint_pos=count * np.round(measured / count),
            joint_vel=self._arrays.memory[FILTERED_VEL].copy(),
            attitude=attitude + IMU_NOISE[0] * noise[:3],
            rates=rates + IMU_NOISE[1] * noise[3:],
        )
