"""PyBullet as a `Backend`: the paper's engine, one Python call per physics step."""

from __future__ import annotations

import numpy as np

from motorprior.actuator.actuator import ActuatorArrays
from motorprior.backend import BackendState
from motorprior.bounds import require_finite
from motorprior.exceptions import ConfigError
from motorprior.simulation.bullet_world import BulletWorld
from motorprior.simulation.mujoco_backend import DrawMotors
from motorprior.simulation.randomization import Conditions, Randomization, nominal_conditions
from motorprior.simulation.terrain import Terrain
from motorprior.simulation.world_config import WorldConfig
from motorprior.simulation.world_step import control_steps_late, has_diverged


class PybulletBackend:
    """A simulated robot with new motors in every episode; see `bullet_world` for the physics.

    Args:
        draw_motors: called at every reset with a generator seeded by the reset's seed.
        config: robot and physics; the base must be free.
        randomization: of each episode, in addition to the motors.
        terrain: the ground; new bumps in every episode.
        episode_steps: control steps for which pushes are drawn.

    Raises:
        ConfigError: PyBullet is not installed, the base is fixed, or the robot has no URDF.
    """

    def __init__(
        self,
        draw_motors: DrawMotors,
        config: WorldConfig,
        randomization: Randomization | None = None,
        terrain: Terrain | None = None,
        episode_steps: int = 500,
    ):
        self._config, self._robot = config, config.robot
        if config.is_fixed:
            raise ConfigError("a robot with a fixed base cannot walk", remedy="use a free robot and suspended=False")
        self._world = BulletWorld(self._config, terrain)
        self._draw, self._episode_steps = draw_motors, episode_steps
        self._randomization = randomization or Randomization()
        self._conditions: Conditions = nominal_conditions(self._robot)
        self._motors: ActuatorArrays | None = None

    def reset(self, seed: int) -> BackendState:
        """Stand in the nominal pose on newly drawn motors."""
        self._conditions = self._randomization.conditions(self._robot, seed, self._episode_steps)
        motors = self._draw(np.random.default_rng(seed))
        self._motors = self._world.reset(motors, conditions=self._conditions, seed=seed)
        self._delays = self._conditions.delay_steps(self._config.physics_dt)
        self._oldest = -(-int(self._delays.max()) // self._config.substeps)
        self._commands = [self._robot.nominal_pose] * self._oldest
        self._step = 0
        return self._state(self._motors, 0.0)

    def step(self, position_target: np.ndarray) -> BackendState:
        """Hold (joints,) targets [rad] for one control step.

        Raises:
            ConfigError: no reset before; another shape, or a target that is not finite.
        """
        if self._motors is None:
            raise ConfigError("step() outside an episode", remedy="call reset() first")
        target = require_finite("position_target", position_target, (self._robot.num_joints,))
        self._commands.append(target - self._conditions.encoder_offset)
        pushes, substeps, total = self._conditions.push, self._config.substeps, 0.0
        push = pushes[self._step % len(pushes)] if len(pushes) else None
        with np.errstate(over="ignore", invalid="ignore"):  # a state that broke down is reported as a fault
            for k in range(substeps):
                late = control_steps_late(self._delays, self._step, k, substeps)
                total += self._world.physics_step(self._motors, self._commands[-1 - late], push)
        del self._commands[: len(self._commands) - self._oldest]
        self._step += 1
        return self._state(self._motors, total / substeps)

    def close(self) -> None:
        """Close the client."""
        self._world.close()

    def _state(self, motors: ActuatorArrays, torque_squared_sum: float) -> BackendState:
        base, measured = self._world.base(), self._world.measured_joint_pos(motors)
        joint_pos, joint_vel = self._world.joints()
        qpos = np.concatenate([base.pos, base.quat, joint_pos])
        broken = has_diverged(qpos, np.concatenate([base.lin_vel, base.ang_vel, joint_vel]))
        return BackendState(
            base_pos=base.pos,
            base_quat=base.quat,
            base_lin_vel=base.lin_vel,
            base_ang_vel=base.ang_vel,
            measured_joint_pos=measured,
            foot_pos=np.full((len(self._robot.legs), 3), np.nan),
            torque_squared_sum=torque_squared_sum,
            fault=1 if broken else 0,
        )
