"""The learned actuator: a softsign network of error and velocity history and a latent z per motor.

    x      = [error(t - k·period) / error_scale | k in taps] + [joint_vel(t - k·period) / velocity_scale | k in taps]
    h1     = softsign(W1ᵀx + V1ᵀz + b1),  h2 = softsign(W2ᵀh1 + b2)
    torque = clip(torque_scale·(w3ᵀh2 + b3), ±torque_limit)
    armature = exp(a0 + aᵀz)                                  (zero if the network decodes none)

The torque is updated every ``period`` and constant in between. b1 + V1ᵀz is computed once per motor. The kernel
evaluates 16 motors in parallel (`lanes`): 0.2 µs for the motors of a quadruped, where a plain loop over neurons takes
1.1 to 1.7 µs, 10 % of a physics step or more.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from motorprior.actuator.actuator import Actuator, ActuatorArrays, require_step
from motorprior.actuator.copula import Copula
from motorprior.actuator.kernels import ActuatorKind, without_refcounts
from motorprior.actuator.lanes import LANES, first_layer, linear_output, softsign_layer
from motorprior.compiled import njit
from motorprior.exceptions import ConfigError


def _softsign(x: Any) -> Any:
    return x / (1.0 + abs(x))


def scaled_torque(weights: Mapping[str, Any], inputs: Any, bias: Any) -> Any:
    """(n,) torque / torque_scale before the clip, by numpy or JAX, for scaled inputs (n, 2T) and bias (n, H)."""
    first = _softsign(inputs @ weights["w1"] + bias)
    second = _softsign(first @ weights["w2"] + weights["b2"])
    return second @ weights["w3"] + weights["b3"]


@dataclass(frozen=True)
class LatentNetwork:
    """Weights and scales; shapes with T taps, Z latents, H neurons per layer (a multiple of 4)."""

    w1: np.ndarray  # (2T, H): T errors, then T velocities, in the order of ``taps``
    v1: np.ndarray  # (Z, H)
    b1: np.ndarray  # (H,)
    w2: np.ndarray  # (H, H)
    b2: np.ndarray  # (H,)
    w3: np.ndarray  # (H,)
    b3: np.ndarray  # () output bias
    log_armature: np.ndarray  # () a0, log of [kg·m²]
    armature_slope: np.ndarray  # (Z,) a
    taps: tuple[int, ...]  # ages of the inputs in periods, ascending from 0
    period: float  # [s]
    error_scale: float  # [rad]
    velocity_scale: float  # [rad/s]
    torque_scale: float  # [N·m]
    torque_limit: float  # [N·m]
    has_armature: bool
    copula: Copula | None = None  # from z ~ N(0, I) to the latents of the decoder; None: z itself
    gain_unit = ""  # a network has no gains

    @property
    def num_latents(self) -> int:
        """Z."""
        return self.v1.shape[0]

    @property
    def num_neurons(self) -> int:
        """H."""
        return self.w2.shape[0]

    def decoder_latents(self, z: np.ndarray) -> np.ndarray:
        """(n, Z) latents of the decoder for motors with latents z (n, Z)."""
        return z if self.copula is None else self.copula.decoder_latents(z)

    def armature(self, z: np.ndarray) -> np.ndarray:
        """(n,) decoded armature [kg·m²] of motors with latents z (n, Z)."""
        if not self.has_armature:
            return np.zeros(len(z))
        return np.exp(float(self.log_armature) + self.decoder_latents(z) @ self.armature_slope)

    def bias(self, z: np.ndarray) -> np.ndarray:
        """(n, H) first-layer bias b1 + V1ᵀ·latents of motors with latents z (n, Z)."""
        return self.b1 + self.decoder_latents(z) @ self.v1

    def torque(self, inputs: np.ndarray, z: np.ndarray) -> np.ndarray:
        """(n,) torque [N·m] in numpy, for scaled inputs (n, 2T) and latents z (n, Z)."""
        raw = self.torque_scale * scaled_torque(vars(self), inputs, self.bias(z))
        return np.clip(raw, -self.torque_limit, self.torque_limit)

    def motors(self, z: np.ndarray, gains: np.ndarray | None = None) -> NetworkActuator:
        """Motors with latents z (n, Z); gains have no effect."""
        return NetworkActuator(self, z)


@dataclass(frozen=True)
class NetworkActuator(Actuator):
    """n motors of one network."""

    model: LatentNetwork  # shared by all motors
    z: np.ndarray  # (n, Z)

    @property
    def kind(self) -> ActuatorKind:
        """LATENT."""
        return LATENT

    @property
    def num_motors(self) -> int:
        """Number of motors."""
        return len(self.z)

    @property
    def armature(self) -> np.ndarray:
        """(n,) decoded from z [kg·m²]."""
        return self.model.armature(self.z)

    def arrays(self, physics_dt: float) -> ActuatorArrays:
        """See `Actuator.arrays`.

        Raises:
            ConfigError: ``physics_dt`` does not divide the network's period.
        """
        require_step(physics_dt)
        net = self.model
        update_steps = round(net.period / physics_dt)
        if update_steps < 1 or abs(update_steps * physics_dt - net.period) > 1e-9:
            raise ConfigError(
                f"physics step {physics_dt:g} s does not divide the prior's period {net.period:g} s",
                remedy=f"use a step of {net.period:g} s or an integer fraction of it",
            )
        blocks = -(-self.num_motors // LANES)
        ring, neurons = net.taps[-1] + 1, net.num_neurons
        padded = np.zeros((blocks * LANES, net.num_latents))
        padded[: self.num_motors] = self.z
        latents = net.decoder_latents(padded)  # once: the slowest part of a reset
        scales = np.array([[1 / net.error_scale], [1 / net.velocity_scale], [net.torque_scale], [net.torque_limit]])
        parameters = np.repeat(scales, self.num_motors, axis=1)
        return ActuatorArrays(
            kernels=self.kind.kernels,
            parameters=parameters,
            memory=np.zeros((1, self.num_motors)),
            clock=np.array([0, update_steps], dtype=np.int64),
            damping=np.zeros(self.num_motors),
            weights=_cache_aligned(np.concatenate([net.w1.ravel(), net.w2.ravel(), net.w3]).astype(np.float32)),
            inputs=np.concatenate([ring - np.array(net.taps), 3 * ring - np.array(net.taps)]),
            biases=_cache_aligned(_folded_biases(net, latents, blocks)),
            history=_cache_aligned(np.zeros((blocks, 4 * ring, LANES), np.float32)),
            scratch=_cache_aligned(np.zeros((blocks, 2 * neurons + 1, LANES), np.float32)),
        )


def _cache_aligned(array: np.ndarray) -> np.ndarray:
    """A contiguous copy aligned to cache lines, so that 16 lanes of float32 fill exactly one."""
    memory = np.empty(array.nbytes + 64, np.uint8)
    first = -memory.ctypes.data % 64
    copy = memory[first : first + array.nbytes].view(array.dtype).reshape(array.shape)
    copy[...] = array
    return copy


def _folded_biases(net: LatentNetwork, latents: np.ndarray, blocks: int) -> np.ndarray:
    """(blocks, 2H + 1, 16): first-layer bias, b2 and b3 of motors with decoder latents (16·blocks, Z)."""
    first = net.b1 + latents @ net.v1
    second = np.broadcast_to(net.b2, first.shape)
    last = np.broadcast_to(float(net.b3), (len(latents), 1))
    every = np.concatenate([first, second, last], axis=1).astype(np.float32)
    return np.ascontiguousarray(every.reshape(blocks, LANES, -1).transpose(0, 2, 1))


@njit(cache=True, nogil=True)
def _reset(arrays: ActuatorArrays, position_target: np.ndarray, joint_pos: np.ndarray) -> None:
    """Fill the history with the current error and zero velocity."""
    ring2 = arrays.history.shape[1] // 2
    arrays.history[:] = np.float32(0.0)
    arrays.memory[:] = 0.0
    for motor in range(position_target.shape[0]):
        error = np.float32((position_target[motor] - joint_pos[motor]) * arrays.parameters[0, 0])
        for slot in range(ring2):
            arrays.history[motor // LANES, slot, motor % LANES] = error


@njit(cache=True, nogil=True)
def _write_history(history, parameters, slot, position_target, joint_pos, joint_vel):
    """Write error and velocity twice, one ring length apart, so that reads of any age need no wrap-around."""
    ring, motors = history.shape[1] // 4, position_target.shape[0]
    error_gain, velocity_gain = parameters[0, 0], parameters[1, 0]
    for block in range(history.shape[0]):
        first = block * LANES
        for lane in range(min(LANES, motors - first)):
            motor = first + lane
            error = np.float32((position_target[motor] - joint_pos[motor]) * error_gain)
            velocity = np.float32(joint_vel[motor] * velocity_gain)
            history[block, slot, lane] = error
            history[block, slot + ring, lane] = error
            history[block, slot + 2 * ring, lane] = velocity
            history[block, slot + 3 * ring, lane] = velocity


@njit(cache=True, nogil=True)
def _evaluate(weights, inputs, biases, history, scratch, slot):
    neurons = (biases.shape[0] - 1) // 2
    first, second, last = scratch[:neurons], scratch[neurons : 2 * neurons], scratch[2 * neurons :]
    first_layer(weights, history, slot, inputs, biases[:neurons], first)
    offset = inputs.shape[0] * neurons
    softsign_layer(weights, offset, first, biases[neurons : 2 * neurons], second)
    linear_output(weights, offset + neurons * neurons, second, biases[2 * neurons :], last)


@njit(cache=True, nogil=True, inline="always")
def _update_torque(arrays, position_target, joint_pos, joint_vel):
    """Every period, write the torque [N·m] of the network into the first row of the memory."""
    network_torque = arrays.memory[0]
    if arrays.clock[0] % arrays.clock[1] == 0:
        slot = (arrays.clock[0] // arrays.clock[1]) % (arrays.history.shape[1] // 4)
        _write_history(arrays.history, arrays.parameters, slot, position_target, joint_pos, joint_vel)
        scale, limit = arrays.parameters[2, 0], arrays.parameters[3, 0]
        for block in range(arrays.history.shape[0]):
            scratch = arrays.scratch[block]
            _evaluate(arrays.weights, arrays.inputs, arrays.biases[block], arrays.history[block], scratch, slot)
            first, output = block * LANES, scratch[scratch.shape[0] - 1]
            for motor in range(first, min(first + LANES, network_torque.shape[0])):
                raw = scale * float(output[motor - first])
                network_torque[motor] = min(limit, max(-limit, raw))


@njit(cache=True, nogil=True)
def _step(arrays, physics_dt, position_target, joint_pos, joint_vel, torque):
    arrays = without_refcounts(arrays)
    _update_torque(arrays, position_target, joint_pos, joint_vel)
    torque[:] = arrays.memory[0]


LATENT = ActuatorKind("latent", "latent network", reset=_reset, step=_step)
