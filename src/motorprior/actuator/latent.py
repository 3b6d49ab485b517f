"""The learned actuator: a softsign network of error and velocity history and a latent z per motor.

    x      = [error(t - k·period) / error_scale | k in taps] + [joint_vel(t - k·period) / velocity_scale | k in taps]
    h1     = softsign(W1ᵀx + V1ᵀz + b1),  h2 = softsign(W2ᵀh1 + b2)
    torque = clip(torque_scale·(w3ᵀh2 + b3), ±torque_limit)
    armature = exp(a0 + aᵀz)                                  (zero for a network without one)

A grey-box network also decodes the constants of a geared motor (`geared_motor`) from z. Its own torque is then only
what the motor's physics leave over, added at the joint; the rotor's inertia is inside, and the engine gets none.

The torque is renewed every ``period`` and held in between. Per motor the network is folded once:
b1 + V1ᵀz becomes that motor's bias.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from motorprior.actuator.actuator import GREY_BOX, LATENT, ActuatorArrays, require_step
from motorprior.actuator.copula import Copula
from motorprior.actuator.geared_motor import GearedMotor, memory_rows, motor_table
from motorprior.actuator.lanes import LANES, first_layer, linear_output, softsign_layer
from motorprior.exceptions import ConfigError

_LINE = 64
"""Bytes."""


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
    motor: GearedMotor | None = None
    """the physical half of a grey box"""
    copula: Copula | None = None
    """from z ~ N(0, I) to the latents that all the above is a function of; None: z itself"""

    @property
    def num_latents(self) -> int:
        """Z."""
        return self.v1.shape[0]

    @property
    def num_neurons(self) -> int:
        """H."""
        return self.w2.shape[0]

    def decoder_latents(self, z: np.ndarray) -> np.ndarray:
        """(n, Z) what weights and constants are functions of, for motors with latents z (n, Z)."""
        return z if self.copula is None else self.copula.decoder_latents(z)

    def constants(self, z: np.ndarray) -> dict[str, np.ndarray]:
        """(n,) physical constants by name, of a grey box."""
        assert self.motor is not None
        return self.motor.decode(self.decoder_latents(z))

    def armature(self, z: np.ndarray) -> np.ndarray:
        """(n,) decoded armature [kg·m²] of motors with latents z (n, Z); that of a grey box is inside its motor."""
        if self.motor is not None:
            return self.constants(z)["armature"]
        if not self.has_armature:
            return np.zeros(len(z))
        return np.exp(float(self.log_armature) + self.decoder_latents(z) @ self.armature_slope)

    def bias(self, z: np.ndarray) -> np.ndarray:
        """(n, H) first-layer bias b1 + V1ᵀ·latents of motors with latents z (n, Z)."""
        return self.b1 + self.decoder_latents(z) @ self.v1

    def torque(self, inputs: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Reference in numpy: inputs (n, 2T) already scaled, z (n, Z) -> (n,) torque [N·m]."""
        first = inputs @ self.w1 + self.bias(z)
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
        """Decoded from z [kg·m²]; zero for a grey box, whose rotor is simulated in the model."""
        return np.zeros(self.num_motors) if self.network.motor is not None else self.network.armature(self.z)

    @property
    def damping(self) -> np.ndarray:
        """Zero: the network damps; a grey box renews the damping of its gear every step."""
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
        scales = np.array([[1 / net.error_scale], [1 / net.velocity_scale], [net.torque_scale], [net.torque_limit]])
        parameters, rows = np.repeat(scales, self.num_motors, axis=1), 1
        if net.motor is not None:
            parameters = np.concatenate([parameters, motor_table(net.constants(self.z), physics_dt)])
            rows = 1 + memory_rows(physics_dt)
        return ActuatorArrays(
            kind=LATENT if net.motor is None else GREY_BOX,
            parameters=parameters,
            memory=np.zeros((rows, self.num_motors)),
            clock=np.array([0, renewal], dtype=np.int64),
            damping=np.zeros(self.num_motors),
            weights=_on_lines(_flat_weights(net)),
            inputs=np.concatenate([ring - np.array(net.taps), 3 * ring - np.array(net.taps)]),
            biases=_on_lines(_folded_biases(net, self.z, blocks)),
            history=_on_lines(np.zeros((blocks, 4 * ring, LANES), np.float32)),
            scratch=_on_lines(np.zeros((blocks, 2 * neurons + 1, LANES), np.float32)),
        )


def _on_lines(array: np.ndarray) -> np.ndarray:
    """A contiguous copy that begins on a cache line: sixteen lanes of float32 then fill one, and no more."""
    memory = np.empty(array.nbytes + _LINE, np.uint8)
    first = -memory.ctypes.data % _LINE
    copy = memory[first : first + array.nbytes].view(array.dtype).reshape(array.shape)
    copy[...] = array
    return copy


def _flat_weights(net: LatentNetwork) -> np.ndarray:
    """W1, W2, w3."""
    return np.concatenate([net.w1.ravel(), net.w2.ravel(), net.w3]).astype(np.float32)


def _folded_biases(net: LatentNetwork, z: np.ndarray, blocks: int) -> np.ndarray:
    """(blocks, 2H + 1, 16): b1 + V1ᵀz, b2 and b3 of every motor."""
    padded = np.zeros((blocks * LANES, net.num_latents))
    padded[: len(z)] = z
    first = net.bias(padded)
    second = np.broadcast_to(net.b2, first.shape)
    last = np.broadcast_to(float(net.b3), (len(padded), 1))
    every = np.concatenate([first, second, last], axis=1).astype(np.float32)
    return np.ascontiguousarray(every.reshape(blocks, LANES, -1).transpose(0, 2, 1))


@njit(cache=True, nogil=True)
def reset_latent(arrays: ActuatorArrays, position_target: np.ndarray, joint_pos: np.ndarray) -> None:
    """Fill the history with the present error and zero velocity."""
    ring2 = arrays.history.shape[1] // 2
    arrays.history[:] = np.float32(0.0)
    arrays.memory[:] = 0.0
    for motor in range(position_target.shape[0]):
        error = np.float32((position_target[motor] - joint_pos[motor]) * arrays.parameters[0, 0])
        for slot in range(ring2):
            arrays.history[motor // LANES, slot, motor % LANES] = error


@njit(cache=True, nogil=True)
def _remember(
    history: np.ndarray,
    parameters: np.ndarray,
    slot: int,
    position_target: np.ndarray,
    joint_pos: np.ndarray,
    joint_vel: np.ndarray,
) -> None:
    """Write error and velocity twice, a ring apart, so that any age is read without wrapping around."""
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
def _evaluate(
    weights: np.ndarray, inputs: np.ndarray, biases: np.ndarray, history: np.ndarray, scratch: np.ndarray, slot: int
) -> None:
    """Run the network of one block of lanes; its output is the last row of the scratch."""
    neurons = (biases.shape[0] - 1) // 2
    first, second, last = scratch[:neurons], scratch[neurons : 2 * neurons], scratch[2 * neurons :]
    first_layer(weights, history, slot, inputs, biases[:neurons], first)
    offset = inputs.shape[0] * neurons
    softsign_layer(weights, offset, first, biases[neurons : 2 * neurons], second)
    linear_output(weights, offset + neurons * neurons, second, biases[2 * neurons :], last)


@njit(cache=True, nogil=True, inline="always")
def renew_torque(
    arrays: ActuatorArrays, position_target: np.ndarray, joint_pos: np.ndarray, joint_vel: np.ndarray
) -> None:
    """Renew the network's torque [N·m] in the first row of the memory if its period is over."""
    held = arrays.memory[0]
    if arrays.clock[0] % arrays.clock[1] == 0:
        slot = (arrays.clock[0] // arrays.clock[1]) % (arrays.history.shape[1] // 4)
        _remember(arrays.history, arrays.parameters, slot, position_target, joint_pos, joint_vel)
        scale, limit = arrays.parameters[2, 0], arrays.parameters[3, 0]
        for block in range(arrays.history.shape[0]):
            scratch = arrays.scratch[block]
            _evaluate(arrays.weights, arrays.inputs, arrays.biases[block], arrays.history[block], scratch, slot)
            first, output = block * LANES, scratch[scratch.shape[0] - 1]
            for motor in range(first, min(first + LANES, held.shape[0])):
                raw = scale * float(output[motor - first])
                held[motor] = min(limit, max(-limit, raw))


@njit(cache=True, nogil=True, inline="always")
def step_latent(
    arrays: ActuatorArrays,
    position_target: np.ndarray,
    joint_pos: np.ndarray,
    joint_vel: np.ndarray,
    torque: np.ndarray,
) -> None:
    """Write (n,) torque [N·m], renewed every ``period`` and held in between."""
    renew_torque(arrays, position_target, joint_pos, joint_vel)
    torque[:] = arrays.memory[0]
