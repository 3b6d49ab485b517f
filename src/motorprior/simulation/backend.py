"""A simulated robot as a `Backend`: one Python call per control step."""

from __future__ import annotations

import numpy as np

from motorprior.actuator.actuator import ActuatorArrays
from motorprior.backend import BackendState
from motorprior.bounds import require_finite
from motorprior.exceptions import ConfigError
from motorprior.simulation.scene import Scene


class SimulatedBackend:
    """A robot in the engine of a scene, with new motors and conditions in every episode.

    Raises:
        ConfigError: a robot that has no model for the engine.
    """

    def __init__(self, scene: Scene):
        self._scene, self.world = scene, scene.world()
        self._motors: ActuatorArrays | None = None

    def reset(self, seed: int) -> BackendState:
        """Stand in the nominal pose; ``seed`` determines everything random."""
        self._motors = self._scene.begin(self.world, seed)
        return self.world.state(self._motors, 0.0)

    def step(self, position_target: np.ndarray) -> BackendState:
        """Hold (joints,) targets [rad] for one control step.

        Raises:
            ConfigError: no reset before; another shape, or a target that is not finite.
        """
        if self._motors is None:
            raise ConfigError("step() outside an episode", remedy="call reset() first")
        target = require_finite("position_target", position_target, (self._scene.robot.num_joints,))
        return self.world.state(self._motors, self.world.hold(self._motors, target))

    def close(self) -> None:
        """Close the engine."""
        self.world.close()
