"""Reference for speed: a Python loop over ``mj_step`` with a network in numpy or TorchScript.

It serves only for comparison (`motorprior speed`): the same learned motors, one interpreted call of the
network and one of MuJoCo per physics step. The step of a grey box's geared motors is the compiled one, so that only
loop and network are compared.
"""

# pyright: reportAttributeAccessIssue=false, reportMissingImports=false
from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np

from motorprior.actuator.geared_motor import step_geared_motor
from motorprior.actuator.kernels import measure_joint_pos
from motorprior.actuator.latent import LatentActuator
from motorprior.actuator.learned_kernels import SCALES
from motorprior.backend import BackendState
from motorprior.robots.robot import Robot
from motorprior.simulation.world import World
from motorprior.simulation.world_config import WorldConfig

Torque = Callable[[np.ndarray], np.ndarray]
"""From scaled inputs (joints, 2·taps) to torque (joints,) [N·m]."""


class PythonLoopBackend:
    """MuJoCo with learned motors, interpreted.

    Args:
        robot: a legged one.
        actuator: the motors; their period must be a multiple of the physics step.
        torque: evaluates the network for them.
    """

    def __init__(self, robot: Robot, actuator: LatentActuator, torque: Torque):
        self._world, self._actuator, self._torque = World(WorldConfig.of(robot)), actuator, torque
        self._joints = robot.num_joints
        self._taps = np.array(actuator.network.taps)
        self._history = np.zeros((2, self._taps[-1] + 1, self._joints))
        self._renewal = round(actuator.network.period / self._world.config.physics_dt)
        self._count, self._held = 0, np.zeros(self._joints)
        self._motors = actuator.arrays(self._world.config.physics_dt)

    def reset(self, seed: int) -> BackendState:
        """Stand in the nominal pose."""
        self._motors = self._world.reset(self._actuator)
        self._history[:] = 0.0
        self._count = 0
        return self._state(0.0)

    def step(self, position_target: np.ndarray) -> BackendState:
        """Hold (joints,) targets [rad] for one control step."""
        world, total = self._world, 0.0
        for _ in range(world.config.substeps):
            if self._count % self._renewal == 0:
                self._held = self._renewed(position_target)
            torque = self._held + self._geared(position_target)
            self._count += 1
            world.data.qfrc_applied[6:] = torque
            mujoco.mj_step(world.model, world.data)
            torque = torque - self._motors.damping * world.data.qvel[6:]
            total += float(torque @ torque)
        return self._state(total / world.config.substeps)

    def _renewed(self, position_target: np.ndarray) -> np.ndarray:
        """Torque (joints,) of the network on its history and the present."""
        data, network = self._world.data, self._actuator.network
        self._history[:, 1:] = self._history[:, :-1]
        self._history[0, 0] = (position_target - data.qpos[7:]) / network.error_scale
        self._history[1, 0] = data.qvel[6:] / network.velocity_scale
        return self._torque(self._history[:, self._taps].reshape(-1, self._joints).T)

    def _geared(self, position_target: np.ndarray) -> np.ndarray:
        """(joints,) torque of a grey box's geared motors, by a compiled call; sets the engine's damping."""
        torque, motors, world = np.zeros(self._joints), self._motors, self._world
        if self._actuator.network.motor is not None:
            data, dt = world.data, world.config.physics_dt
            step_geared_motor(
                motors.parameters[SCALES:], motors.memory[1:], self._count, dt, position_target, data.qpos[7:],
                data.qvel[6:], torque, motors.damping,
            )  # fmt: skip
            world.arrays.damping[:] = motors.damping
        return torque

    def close(self) -> None:
        """Nothing to give back."""

    def _state(self, torque_squared_sum: float) -> BackendState:
        data, measured = self._world.data, np.zeros(self._joints)
        measure_joint_pos(self._motors, data.qpos[7:], measured)
        return BackendState(
            data.qpos[:3].copy(), data.qpos[3:7].copy(), data.qvel[:3].copy(), data.qvel[3:6].copy(), measured,
            data.geom_xpos[self._world.arrays.feet], torque_squared_sum,
        )  # fmt: skip


def numpy_torque(actuator: LatentActuator) -> Torque:
    """The network's own reference, its latents decoded once, as compiled motors' are."""
    network, latents = replace(actuator.network, copula=None), actuator.network.decoder_latents(actuator.z)
    return lambda inputs: network.torque(inputs, latents)


def torchscript_torque(actuator: LatentActuator) -> Torque | None:
    """The same layers in TorchScript, float32, on one thread; None if PyTorch is not installed."""
    try:
        import torch
    except ImportError:
        return None
    torch.set_num_threads(1)
    net = actuator.network
    first, second, last = (
        torch.nn.Linear(*net.w1.shape),
        torch.nn.Linear(*net.w2.shape),
        torch.nn.Linear(len(net.w3), 1),
    )
    folded = torch.from_numpy(net.bias(actuator.z)).float()
    values = ((first, net.w1.T, 0.0 * net.b1), (second, net.w2.T, net.b2), (last, net.w3[None], np.atleast_1d(net.b3)))
    for layer, weight, bias in values:
        layer.weight.data, layer.bias.data = torch.from_numpy(weight.copy()).float(), torch.tensor(bias).float()

    class Motors(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.first, self.second, self.last, self.folded = first, second, last, folded
            self.activation, self.scale, self.limit = torch.nn.Softsign(), net.torque_scale, net.torque_limit

        def forward(self, inputs):
            hidden = self.activation(self.second(self.activation(self.first(inputs) + self.folded)))
            return torch.clamp(self.scale * self.last(hidden)[:, 0], -self.limit, self.limit)

    example = torch.zeros(actuator.num_motors, net.w1.shape[0])
    with warnings.catch_warnings(action="ignore", category=FutureWarning):  # deprecated since PyTorch 2.15, and in use
        compiled = torch.jit.freeze(torch.jit.trace(Motors().eval(), example))

    def torque(inputs: np.ndarray) -> np.ndarray:
        with torch.inference_mode():
            return compiled(torch.from_numpy(np.ascontiguousarray(inputs, np.float32))).numpy().astype(np.float64)

    return torque
