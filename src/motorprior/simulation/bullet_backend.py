"""PyBullet behind the `Backend` contract: the paper's engine, one Python call per physics step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motorprior.actuator.actuator import ActuatorArrays
from motorprior.backend import BackendState
from motorprior.bounds import require_finite
from motorprior.exceptions import ConfigError
from motorprior.robots.pupper_v2 import spec
from motorprior.simulation.bullet_world import PHYSICS_DT, BulletWorld
from motorprior.simulation.mujoco_backend import DrawMotors
from motorprior.simulation.randomization import NOMINAL, Conditions, Randomization
from motorprior.simulation.terrain import Terrain
from motorprior.simulation.world import WorldConfig, control_steps_late, has_broken_down


class PybulletBackend:
    """A simulated Pupper with other motors in every episode; see `bullet_world` for what it has in common with MuJoCo.

    Args:
        draw_motors: called at every reset with a generator seeded by the reset's seed.
        config: physics; the chassis must be free. 1 kHz if not given.
        randomization: what else differs between episodes.
        terrain: the ground; other bumps in every episode.
        episode_steps: control steps that pushes are drawn for.

    Raises:
        ConfigError: PyBullet is not installed, or the robot hangs.
    """

    def __init__(
        self,
        draw_motors: DrawMotors,
        config: WorldConfig | None = None,
        randomization: Randomization | None = None,
        terrain: Terrain | None = None,
        episode_steps: int = 500,
    ):
        self._config = config or replace(WorldConfig(), physics_dt=PHYSICS_DT)
        if self._config.hung:
            raise ConfigError("a hung robot cannot walk", remedy="use hung=False")
        self._world = BulletWorld(self._config, terrain)
        self._draw, self._episode_steps = draw_motors, episode_steps
        self._randomization = randomization or Randomization()
        self._conditions: Conditions = NOMINAL
        self._motors: ActuatorArrays | None = None

    def reset(self, seed: int) -> BackendState:
        """Stand in the nominal pose on newly drawn motors, in a fresh client."""
        self._conditions = self._randomization.conditions(seed, self._episode_steps)
        motors = self._draw(np.random.default_rng(seed))
        self._motors = self._world.reset(motors, conditions=self._conditions, seed=seed)
        self._delay = self._conditions.delay_steps(self._config.physics_dt)
        self._commands = [spec.NOMINAL_POSE] * control_steps_late(self._delay, 0, self._config.substeps)
        self._step = 0
        return self._state(self._motors, 0.0)

    def step(self, position_target: np.ndarray) -> BackendState:
        """Hold (12,) targets [rad] for one control step.

        Raises:
            ConfigError: no reset before; another shape, or a target that is not finite.
        """
        if self._motors is None:
            raise ConfigError("step() outside an episode", remedy="call reset() first")
        target = require_finite("position_target", position_target, (spec.NUM_JOINTS,))
        self._commands.append(target - self._conditions.encoder_offset)
        pushes, substeps, total = self._conditions.push, self._config.substeps, 0.0
        push = pushes[self._step % len(pushes)] if len(pushes) else None
        with np.errstate(over="ignore", invalid="ignore"):  # a state that broke down is reported as a fault
            for k in range(substeps):
                late = control_steps_late(self._delay, k, substeps)
                total += self._world.physics_step(self._motors, self._commands[-1 - late], push)
        del self._commands[: len(self._commands) - control_steps_late(self._delay, 0, substeps)]
        self._step += 1
        return self._state(self._motors, total / substeps)

    def close(self) -> None:
        """Close the client."""
        self._world.close()

    def _state(self, motors: ActuatorArrays, torque_squared_sum: float) -> BackendState:
        base, measured = self._world.base(), self._world.measured_joint_pos(motors)
        joint_pos, joint_vel = self._world.joints()
        qpos = np.concatenate([base.pos, base.quat, joint_pos])
        broken = has_broken_down(qpos, np.concatenate([base.lin_vel, base.ang_vel, joint_vel]))
        return BackendState(
            base_pos=base.pos,
            base_quat=base.quat,
            base_lin_vel=base.lin_vel,
            base_ang_vel=base.ang_vel,
            measured_joint_pos=measured,
            torque_squared_sum=torque_squared_sum,
            fault=1 if broken else 0,
        )
