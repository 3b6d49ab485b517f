"""The learned actuator: a softsign network of error and velocity history and a latent z per motor.

    x      = [error(t - k·period) / error_scale | k in taps] + [joint_vel(t - k·period) / velocity_scale | k in taps]
    h1     = softsign(W1ᵀx + V1ᵀz + b1),  h2 = softsign(W2ᵀh1 + b2)
    torque = clip(torque_scale·(w3ᵀh2 + b3), ±torque_limit)
    armature = exp(a0 + aᵀz)                                  (zero for a network without one)

The torque is renewed every ``period`` and held in between. Per motor the network is folded once:
b1 + V1ᵀz becomes that motor's bias.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from motorprior.actuator.actuator import LATENT, ActuatorArrays, require_step
from motorprior.actuator.lanes import LANES, softsign_layer
from motorprior.exceptions import ConfigError


@dataclass(frozen=True)
class LatentNetwork:
    """Weights and scales; shapes with T taps, Z latents, H neurons per layer (a multiple of 4)."""

    w1: np.ndarray
    """(2T, H): rows are T errors, then T velocities, in the order of ``taps``."""
    v1: np.ndarray
    """(Z, H)"""
    b1: np.ndarray
    """(H,)"""
    w2: np.ndarray
    """(H, H)"""
    b2: np.ndarray
    """(H,)"""
    w3: np.ndarray
    """(H,)"""
    b3: np.ndarray
    """() output bias"""
    log_armature: np.ndarray
    """() a0, log of [kg·m²]; -inf is written as no armature by ``has_armature``"""
    armature_slope: np.ndarray
    """(Z,) a"""
    taps: tuple[int, ...]
    """ages of the inputs in periods, ascending from 0"""
    period: float
    """[s]"""
    error_scale: float
    """[rad]"""
    velocity_scale: float
    """[rad/s]"""
    torque_scale: float
    """[N·m]"""
    torque_limit: float
    """[N·m]"""
    has_armature: bool

    @property
    def num_latents(self) -> int:
        """Z."""
        return self.v1.shape[0]

    @property
    def num_neurons(self) -> int:
        """H."""
        return self.w2.shape[0]

    def armature(self, z: np.ndarray) -> np.ndarray:
        """(n,) decoded armature [kg·m²] of motors with latents z (n, Z)."""
        if not self.has_armature:
            return np.zeros(len(z))
        return np.exp(float(self.log_armature) + z @ self.armature_slope)

    def torque(self, inputs: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Reference in numpy: inputs (n, 2T) already scaled, z (n, Z) -> (n,) torque [N·m]."""
        first = inputs @ self.w1 + z @ self.v1 + self.b1
        second = (first / (1 + np.abs(first))) @ self.w2 + self.b2
        raw = self.torque_scale * ((second / (1 + np.abs(second))) @ self.w3 + self.b3)
        return np.clip(raw, -self.torque_limit, self.torque_limit)


@dataclass(frozen=True)
class LatentActuator:
    """n learned motors: one network, one z (n, Z) each."""

    network: LatentNetwork
    z: np.ndarray

    @property
    def num_motors(self) -> int:
        """Number of motors."""
        return len(self.z)

    @property
    def armature(self) -> np.ndarray:
        """Decoded from z [kg·m²]."""
        return self.network.armature(self.z)

    @property
    def damping(self) -> np.ndarray:
        """Zero: the network damps."""
        return np.zeros(self.num_motors)

    def arrays(self, physics_dt: float) -> ActuatorArrays:
        """See `Actuator.arrays`.

        Raises:
            ConfigError: ``physics_dt`` does not divide the network's period.
        """
        require_step(physics_dt)
        net = self.network
        renewal = round(net.period / physics_dt)
        if renewal < 1 or abs(renewal * physics_dt - net.period) > 1e-9:
            raise ConfigError(
                f"physics step {physics_dt:g} s does not divide the prior's period {net.period:g} s",
                remedy=f"use a step of {net.period:g} s or an integer fraction of it",
            )
        blocks = -(-self.num_motors // LANES)
        ring, neurons = net.taps[-1] + 1, net.num_neurons
        return ActuatorArrays(
            kind=LATENT,
            parameters=np.array(
                [[1 / net.error_scale], [1 / net.velocity_scale], [net.torque_scale], [net.torque_limit]]
            ),
            memory=np.zeros((1, self.num_motors)),
            clock=np.array([0, renewal], dtype=np.int64),
            weights=_flat_weights(net),
            taps=np.array(net.taps, dtype=np.int64),
            biases=_folded_biases(net, self.z, blocks),
            history=np.zeros((blocks, 2 * ring, LANES), np.float32),
            scratch=np.zeros((blocks, 2 * len(net.taps) + 2 * neurons, LANES), np.float32),
        )


def _flat_weights(net: LatentNetwork) -> np.ndarray:
    parts = [net.w1.ravel(), net.w2.ravel(), net.w3.ravel(), np.reshape(net.b3, 1)]
    return np.concatenate(parts).astype(np.float32)


def _folded_biases(net: LatentNetwork, z: np.ndarray, blocks: int) -> np.ndarray:
    padded = np.zeros((blocks * LANES, net.num_latents))
    padded[: len(z)] = z
    first = padded @ net.v1 + net.b1
    second = np.broadcast_to(net.b2, first.shape)
    both = np.concatenate([first, second], axis=1).astype(np.float32)
    return np.ascontiguousarray(both.reshape(blocks, LANES, -1).transpose(0, 2, 1))


@njit(cache=True, nogil=True)
def reset_latent(arrays: ActuatorArrays, position_target: np.ndarray, joint_pos: np.ndarray) -> None:
    """Fill the history with the present error and zero velocity."""
    ring = arrays.history.shape[1] // 2
    arrays.history[:] = np.float32(0.0)
    arrays.memory[:] = 0.0
    for motor in range(position_target.shape[0]):
        error = np.float32((position_target[motor] - joint_pos[motor]) * arrays.parameters[0, 0])
        for slot in range(ring):
            arrays.history[motor // LANES, 2 * slot, motor % LANES] = error


@njit(cache=True, nogil=True)
def _remember(
    arrays: ActuatorArrays, slot: int, position_target: np.ndarray, joint_pos: np.ndarray, joint_vel: np.ndarray
) -> None:
    error_gain, velocity_gain = arrays.parameters[0, 0], arrays.parameters[1, 0]
    for motor in range(position_target.shape[0]):
        block, lane = motor // LANES, motor % LANES
        error = (position_target[motor] - joint_pos[motor]) * error_gain
        arrays.history[block, 2 * slot, lane] = np.float32(error)
        arrays.history[block, 2 * slot + 1, lane] = np.float32(joint_vel[motor] * velocity_gain)


@njit(cache=True, nogil=True)
def _evaluate(arrays: ActuatorArrays, block: int, now: int) -> None:
    """Run the network of one block of lanes; the last hidden layer ends in the scratch rows."""
    taps, ring = arrays.taps.shape[0], arrays.history.shape[1] // 2
    neurons = arrays.biases.shape[1] // 2
    inputs = arrays.scratch[block, : 2 * taps]
    first = arrays.scratch[block, 2 * taps : 2 * taps + neurons]
    second = arrays.scratch[block, 2 * taps + neurons :]
    for tap in range(taps):
        slot = (now - arrays.taps[tap]) % ring
        for lane in range(LANES):
            inputs[tap, lane] = arrays.history[block, 2 * slot, lane]
            inputs[taps + tap, lane] = arrays.history[block, 2 * slot + 1, lane]
    biases = arrays.biases[block]
    softsign_layer(arrays.weights, 0, inputs, 2 * taps, biases[:neurons], first)
    softsign_layer(arrays.weights, 2 * taps * neurons, first, neurons, biases[neurons:], second)


@njit(cache=True, nogil=True)
def _read_out(arrays: ActuatorArrays, block: int) -> None:
    """torque_scale·(w3ᵀh2 + b3), clipped, into the held torque of this block's motors."""
    neurons = arrays.biases.shape[1] // 2
    start = 2 * arrays.taps.shape[0] + neurons
    offset = (2 * arrays.taps.shape[0] + neurons) * neurons
    total = np.full(LANES, arrays.weights[offset + neurons])
    for neuron in range(neurons):
        weight = arrays.weights[offset + neuron]
        for lane in range(LANES):
            total[lane] += weight * arrays.scratch[block, start + neuron, lane]
    scale, limit = arrays.parameters[2, 0], arrays.parameters[3, 0]
    first = block * LANES
    for motor in range(first, min(first + LANES, arrays.memory.shape[1])):
        arrays.memory[0, motor] = min(limit, max(-limit, scale * float(total[motor - first])))


@njit(cache=True, nogil=True)
def step_latent(
    arrays: ActuatorArrays,
    position_target: np.ndarray,
    joint_pos: np.ndarray,
    joint_vel: np.ndarray,
    torque: np.ndarray,
) -> None:
    """Write (n,) torque [N·m], renewed every ``period`` and held in between."""
    if arrays.clock[0] % arrays.clock[1] == 0:
        now = arrays.clock[0] // arrays.clock[1]
        _remember(arrays, now % (arrays.history.shape[1] // 2), position_target, joint_pos, joint_vel)
        for block in range(arrays.history.shape[0]):
            _evaluate(arrays, block, now)
            _read_out(arrays, block)
    torque[:] = arrays.memory[0]
