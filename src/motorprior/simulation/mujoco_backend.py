"""MuJoCo as a `Backend`: one Python call per control step."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from motorprior.actuator.actuator import Actuator, ActuatorArrays
from motorprior.backend import BackendState
from motorprior.bounds import require_finite
from motorprior.exceptions import ConfigError
from motorprior.simulation.randomization import Randomization
from motorprior.simulation.world import World
from motorprior.simulation.world_config import WorldConfig
from motorprior.simulation.world_step import hold_target, read_joints

DrawMotors = Callable[[np.random.Generator], Actuator]  # draws the motors of one episode, one per joint


class MujocoBackend:
    """A simulated robot with new motors in every episode.

    Args:
        draw_motors: called at every reset with a generator seeded by the reset's seed.
        config: robot and physics; the base must be free.
        randomization: of each episode, in addition to the motors.
        episode_steps: control steps for which pushes are drawn.
    """

    def __init__(
        self,
        draw_motors: DrawMotors,
        config: WorldConfig,
        randomization: Randomization | None = None,
        episode_steps: int = 500,
    ):
        if config.is_fixed:
            raise ConfigError("a robot with a fixed base cannot walk", remedy="use a free robot and suspended=False")
        self._world, self._robot = World(config), config.robot
        self._draw, self._episode_steps = draw_motors, episode_steps
        self._randomization = randomization or Randomization()
        self._motors: ActuatorArrays | None = None

    def reset(self, seed: int) -> BackendState:
        """Stand in the nominal pose on newly drawn motors, in newly drawn conditions."""
        conditions = self._randomization.conditions(self._robot, seed, self._episode_steps)
        self._motors = self._world.reset(self._draw(np.random.default_rng(seed)), conditions=conditions)
        return self._state(self._motors, 0.0)

    def step(self, position_target: np.ndarray) -> BackendState:
        """Hold (joints,) targets [rad] for one control step.

        Raises:
            ConfigError: no reset before; another shape, or a target that is not finite.
        """
        if self._motors is None:
            raise ConfigError("step() outside an episode", remedy="call reset() first")
        target = require_finite("position_target", position_target, (self._robot.num_joints,))
        return self._state(self._motors, hold_target(self._world.arrays, self._motors, target))

    def close(self) -> None:
        """Nothing to close."""

    def _state(self, motors: ActuatorArrays, torque_squared_sum: float) -> BackendState:
        data, measured = self._world.data, np.zeros(self._robot.num_joints)
        read_joints(self._world.arrays, motors, measured)
        return BackendState(
            base_pos=data.qpos[:3].copy(),
            base_quat=data.qpos[3:7].copy(),
            base_lin_vel=data.qvel[:3].copy(),
            base_ang_vel=data.qvel[3:6].copy(),
            measured_joint_pos=measured,
            foot_pos=data.geom_xpos[self._world.arrays.feet],
            torque_squared_sum=torque_squared_sum,
            fault=self._world.fault(),
        )
