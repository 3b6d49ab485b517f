"""MuJoCo behind the `Backend` contract: one Python call per control step."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs.
from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.torque_law import measure_joint_pos, step_actuator
from motorprior.backend import BackendState
from motorprior.exceptions import ConfigError
from motorprior.robots.pupper_v2.spec import NUM_JOINTS
from motorprior.simulation.world import World, WorldConfig

DrawMotors = Callable[[np.random.Generator], Actuator]
"""Draws the 12 motors of one episode."""


class MujocoBackend:
    """A simulated Pupper with other motors in every episode.

    Args:
        draw_motors: called at every reset with a generator seeded by the reset's seed.
        config: physics; the chassis must be free.
    """

    def __init__(self, draw_motors: DrawMotors, config: WorldConfig | None = None):
        self._world = World(config or WorldConfig())
        if self._world.config.hung:
            raise ConfigError("a hung robot cannot walk", remedy="use hung=False")
        self._draw = draw_motors
        self._motors = self._world.reset(draw_motors(np.random.default_rng(0)))

    def reset(self, seed: int) -> BackendState:
        """Stand in the nominal pose on newly drawn motors."""
        self._motors = self._world.reset(self._draw(np.random.default_rng(seed)))
        return self._state(0.0)

    def step(self, position_target: np.ndarray) -> BackendState:
        """Hold (12,) targets [rad] for one control step."""
        world, arrays, total = self._world, self._world.arrays, 0.0
        target = np.ascontiguousarray(position_target, dtype=np.float64)
        q, dq = world.data.qpos[-NUM_JOINTS:], world.data.qvel[-NUM_JOINTS:]
        torque = np.zeros(NUM_JOINTS)
        for _ in range(arrays.substeps):
            step_actuator(self._motors, arrays.physics_dt, target, q, dq, torque)
            world.data.qfrc_applied[-NUM_JOINTS:] = torque
            arrays.damping[:] = self._motors.damping
            mujoco.mj_step(world.model, world.data)
            squared = 0.0
            for motor in torque - arrays.damping * dq:
                squared += float(motor) * float(motor)
            total += squared
        return self._state(total / arrays.substeps)

    def close(self) -> None:
        """Nothing to give back."""

    def _state(self, torque_squared_sum: float) -> BackendState:
        data, measured = self._world.data, np.zeros(NUM_JOINTS)
        measure_joint_pos(self._motors, data.qpos[-NUM_JOINTS:], measured)
        return BackendState(
            base_pos=data.qpos[:3].copy(),
            base_quat=data.qpos[3:7].copy(),
            base_lin_vel=data.qvel[:3].copy(),
            base_ang_vel=data.qvel[3:6].copy(),
            measured_joint_pos=measured,
            torque_squared_sum=torque_squared_sum,
            fault=self._world.fault(),
        )
