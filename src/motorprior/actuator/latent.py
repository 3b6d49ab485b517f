"""The learned actuator: a softsign network of error and velocity history and a latent z per motor.

    x      = [error(t - k·period) / error_scale | k in taps] + [joint_vel(t - k·period) / velocity_scale | k in taps]
    h1     = softsign(W1ᵀx + V1ᵀz + b1),  h2 = softsign(W2ᵀh1 + b2)
    torque = clip(torque_scale·(w3ᵀh2 + b3), ±torque_limit)
    armature = exp(a0 + aᵀz)                                  (zero if the network decodes none)

A grey box also decodes the constants of a geared motor (`geared_motor`) from z. The network's torque is then the
residual of the physics, added at the joint. The model simulates the rotor, so the engine gets no armature.

The torque is updated every ``period`` and constant in between. b1 + V1ᵀz is computed once per motor.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from motorprior.actuator.actuator import Actuator, ActuatorArrays, Factors, require_step, require_unchanged
from motorprior.actuator.copula import Copula
from motorprior.actuator.geared_motor import GearedMotor, memory_rows, motor_table
from motorprior.actuator.geared_motor_constants import with_logged_gains
from motorprior.actuator.kernels import ActuatorKind
from motorprior.actuator.lanes import LANES
from motorprior.actuator.learned_kernels import GREY_BOX, LATENT
from motorprior.actuator.optional_terms import HALF_WARM, Conditions
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
    motor: GearedMotor | None = None  # physics of a grey box
    copula: Copula | None = None  # from z ~ N(0, I) to the latents of the decoder; None: z itself
    gain_unit: str = ""  # unit of logged gains (`MotorLog`) that kp and kd_over_kp are multiples of; "": absolute gains

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

    def constants(self, z: np.ndarray) -> dict[str, np.ndarray]:
        """(n,) physical constants by name of a cold grey box at nominal conditions.

        With a ``gain_unit``, kp and kd_over_kp are multiples of logged gains (`with_logged_gains`).
        """
        assert self.motor is not None
        return self.motor.decode(self.decoder_latents(z))

    def warmth(self, z: np.ndarray, seconds: float) -> np.ndarray | float:
        """(n,) warmth of a grey box's motors ``seconds`` [s] after a cold start; 0 without the term heat."""
        if self.motor is None or "heat" not in self.motor.terms:
            return 0.0
        return 1.0 - np.exp(-seconds / self.constants(z)["heat_time"])

    def armature(self, z: np.ndarray) -> np.ndarray:
        """(n,) decoded armature [kg·m²] of motors with latents z (n, Z)."""
        if self.motor is not None:
            return self.constants(z)["armature"]
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


@dataclass(frozen=True)
class LatentActuator(Actuator):
    """n learned motors of one network."""

    network: LatentNetwork  # shared by all motors
    z: np.ndarray  # (n, Z)
    conditions: Conditions = HALF_WARM
    gains: np.ndarray | None = None  # (2, n) kp and kd in the network's ``gain_unit``; if that is "", factors on gains
    factors: Factors | None = None  # on the constants of a grey box

    @property
    def kind(self) -> ActuatorKind:
        """GREY_BOX if the network has a geared motor, LATENT otherwise."""
        return LATENT if self.network.motor is None else GREY_BOX

    @property
    def num_motors(self) -> int:
        """Number of motors."""
        return len(self.z)

    @property
    def armature(self) -> np.ndarray:
        """(n,) decoded from z [kg·m²]; zero for a grey box."""
        return np.zeros(self.num_motors) if self.network.motor is not None else self.network.armature(self.z)

    def with_factors(self, factors: Factors) -> LatentActuator:
        """See `actuator.with_factors`; grey boxes only. The integral gain, kp·integral_rate, scales with kp."""
        if self.network.motor is None:
            require_unchanged(self.kind, factors, *Factors._fields)
        self._require_gains()
        before = self.factors
        return replace(self, factors=factors if before is None else Factors(*np.multiply(before, factors)))

    def _require_gains(self) -> None:
        if self.network.gain_unit and self.gains is None:
            raise ConfigError(
                f"these motors were learned with logged gains [{self.network.gain_unit}]",
                remedy="give their gains", argument="gains",
            )  # fmt: skip

    def _scaled(self, values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        if self.gains is not None:
            values = with_logged_gains(values, *self.gains)
        if self.factors is None:
            return values
        kp, kd, torque_limit, coulomb = self.factors
        others = {"torque_limit": torque_limit, "coulomb": coulomb, "stribeck_torque": coulomb}
        return with_logged_gains(values, kp, kd) | {name: values[name] * factor for name, factor in others.items()}

    def arrays(self, physics_dt: float) -> ActuatorArrays:
        """See `Actuator.arrays`.

        Raises:
            ConfigError: ``physics_dt`` does not divide the network's period, or gains are missing.
        """
        require_step(physics_dt)
        self._require_gains()
        net = self.network
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
        parameters, rows = np.repeat(scales, self.num_motors, axis=1), 1
        if net.motor is not None:
            values = self._scaled(net.motor.decode(latents[: self.num_motors], self.conditions))
            parameters = np.concatenate([parameters, motor_table(values, physics_dt, net.motor.terms)])
            rows = 1 + memory_rows(physics_dt)
        return ActuatorArrays(
            kernels=self.kind.kernels,
            parameters=parameters,
            memory=np.zeros((rows, self.num_motors)),
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
