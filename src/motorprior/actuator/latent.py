"""The learned actuator: a softsign network of error and velocity history and a latent z per motor.

    x      = [error(t - k·period) / error_scale | k in taps]
             + [joint_vel(t - k·period) / velocity_scale | k in taps]
    h1     = softsign(W1ᵀx + V1ᵀz + b1),  h2 = softsign(W2ᵀh1 + b2)
    torque = clip(torque_scale·(w3ᵀh2 + b3), ±torque_limit)
    armature = exp(a0 + aᵀz)                                  (zero if the network decodes none)

The torque is updated every ``period`` and constant in between. b1 + V1ᵀz is computed once per
motor. The kernel evaluates blocks of 16 motors in float32, with one motor per lane of the vector
registers.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numba import types
from numba.extending import intrinsic

from motorprior.actuator.actuator import ConstantFactors, require_step, require_unchanged
from motorprior.actuator.arrays import ActuatorArrays
from motorprior.actuator.copula import Copula
from motorprior.actuator.kernels import ActuatorKind, without_refcounts
from motorprior.actuator.vector import FLOAT, Vector
from motorprior.bounds import BOOLEAN, exactly, integer, many, number
from motorprior.compiled import njit
from motorprior.exceptions import ConfigError
from motorprior.schema import Schema, Tensor

LANES = 16  # motors per block: float32 values per vector
# fields of `LatentNetwork`
NETWORK_SCALES = ("error_scale", "velocity_scale", "torque_scale", "torque_limit")
_INPUT_ORDER = "errors of all taps, then velocities of all taps; tap k is k periods old"
# content of a prior's file: arrays, and entries of its header
WEIGHTS = {
    "b1": Tensor(("neurons",)),
    "w1": Tensor(("inputs", "neurons")),
    "v1": Tensor(("latents", "neurons")),
    "w2": Tensor(("neurons", "neurons")),
    "b2": Tensor(("neurons",)),
    "w3": Tensor(("neurons",)),
    "b3": Tensor(()),
    "log_armature": Tensor(()),
    "armature_slope": Tensor(("latents",)),
}
_ENTRIES = {
    "input_order": exactly(_INPUT_ORDER),
    "taps": many(integer(0, 10_000), minimum=1),
    "has_armature": BOOLEAN,
    **dict.fromkeys(NETWORK_SCALES, number(above=0.0)),
}


def _softsign(x: Any) -> Any:
    return x / (1.0 + abs(x))


def first_bias(weights: Mapping[str, Any], latents: Any) -> Any:
    """(n, H) first-layer bias b1 + V1ᵀ·latents, by numpy or JAX, for decoder latents (n, Z)."""
    return weights["b1"] + latents @ weights["v1"]


def log_armature(weights: Mapping[str, Any], latents: Any) -> Any:
    """(n,) logarithm of the armature [kg·m²], by numpy or JAX, for decoder latents (n, Z)."""
    return weights["log_armature"] + latents @ weights["armature_slope"]


def scaled_torque(weights: Mapping[str, Any], inputs: Any, bias: Any) -> Any:
    """(n,) torque / torque_scale before the clip, by numpy or JAX.

    ``inputs`` are scaled and (n, 2T); ``bias`` of the first layer is (n, H).
    """
    first = _softsign(inputs @ weights["w1"] + bias)
    second = _softsign(first @ weights["w2"] + weights["b2"])
    return second @ weights["w3"] + weights["b3"]


@dataclass(frozen=True)
class LatentNetwork:
    """Weights and scales; shapes with T taps, Z latents, H neurons per layer."""

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
    copula: Copula | None = None  # maps z ~ N(0, I) to the decoder's latents; None: z itself
    gain_unit = ""  # a network has no gains

    @property
    def num_latents(self) -> int:
        """Z."""
        return self.v1.shape[0]

    @property
    def num_neurons(self) -> int:
        """H."""
        return self.w2.shape[0]

    def contents(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Arrays and header entries for a prior's file."""
        entries = {
            "input_order": _INPUT_ORDER,
            "taps": list(self.taps),
            "has_armature": self.has_armature,
        }
        weights = {name: np.asarray(getattr(self, name), np.float64) for name in WEIGHTS}
        return weights, entries | {name: getattr(self, name) for name in NETWORK_SCALES}

    @classmethod
    def of(
        cls,
        tensors: Mapping[str, np.ndarray],
        entries: Mapping[str, Any],
        period: float,
        copula: Copula | None,
    ) -> "LatentNetwork":
        """From `contents`, with its ``period`` [s]."""
        values: dict[str, Any] = {name: tensors[name] for name in WEIGHTS}
        values |= {name: float(entries[name]) for name in NETWORK_SCALES}
        values |= {"taps": tuple(entries["taps"]), "has_armature": entries["has_armature"]}
        return cls(**values, period=period, copula=copula)

    def decoder_latents(self, z: np.ndarray) -> np.ndarray:
        """(n, Z) latents of the decoder for motors with latents z (n, Z)."""
        return z if self.copula is None else self.copula.decoder_latents(z)

    def armature(self, z: np.ndarray) -> np.ndarray:
        """(n,) decoded armature [kg·m²] of motors with latents z (n, Z)."""
        if not self.has_armature:
            return np.zeros(len(z))
        return np.exp(log_armature(vars(self), self.decoder_latents(z)))

    def torque(self, inputs: np.ndarray, z: np.ndarray) -> np.ndarray:
        """(n,) torque [N·m] in numpy, for scaled inputs (n, 2T) and latents z (n, Z)."""
        bias = first_bias(vars(self), self.decoder_latents(z))
        raw = self.torque_scale * scaled_torque(vars(self), inputs, bias)
        return np.clip(raw, -self.torque_limit, self.torque_limit)

    def motors(self, z: np.ndarray, gains: np.ndarray | None = None) -> "NetworkActuator":
        """Motors with latents z (n, Z); gains have no effect."""
        return NetworkActuator(self, z)


def network_schema(remedy: str) -> Schema:
    """Declaration of the header entries of `LatentNetwork.contents`."""
    return Schema(_ENTRIES, remedy, name="network")


@dataclass(frozen=True)
class NetworkActuator:
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

    @property
    def damping(self) -> np.ndarray:
        """(n,) zero [N·m·s/rad]: the network's torque includes it."""
        return np.zeros(self.num_motors)

    def with_factors(self, factors: ConstantFactors) -> Self:
        """See `Actuator.with_factors`; a network has no constants to scale."""
        require_unchanged(LATENT, factors, *ConstantFactors._fields)
        return self

    def arrays(self, physics_dt: float) -> ActuatorArrays:
        """See `Actuator.arrays`; ``physics_dt`` must divide the network's period."""
        require_step(physics_dt)
        net = self.model
        update_steps = round(net.period / physics_dt)
        if update_steps < 1 or abs(update_steps * physics_dt - net.period) > 1e-9:
            problem = f"physics step {physics_dt:g} s does not divide the prior's period"
            raise ConfigError(
                f"{problem} {net.period:g} s",
                remedy=f"use a step of {net.period:g} s or an integer fraction of it",
            )

        # biases of all layers, for whole blocks of motors
        blocks = -(-self.num_motors // LANES)
        padded = np.zeros((blocks * LANES, net.num_latents))
        padded[: self.num_motors] = self.z
        first = first_bias(vars(net), net.decoder_latents(padded))
        ones = np.ones((len(padded), 1))
        layers = [first, ones * net.b2, ones * float(net.b3)]
        biases = np.concatenate(layers, axis=1, dtype=np.float32)
        biases = biases.reshape(blocks, LANES, -1).transpose(0, 2, 1)

        ring = net.taps[-1] + 1
        taps = np.array(net.taps)
        scales = np.array(
            [1 / net.error_scale, 1 / net.velocity_scale, net.torque_scale, net.torque_limit]
        )
        return ActuatorArrays(
            kernels=self.kind.kernels,
            parameters=np.repeat(scales[:, None], self.num_motors, axis=1),
            memory=np.zeros((1, self.num_motors)),
            clock=np.array([0, update_steps], dtype=np.int64),
            damping=np.zeros(self.num_motors),
            weights=np.concatenate([net.w1.ravel(), net.w2.ravel(), net.w3]).astype(np.float32),
            inputs=np.concatenate([ring - taps, 3 * ring - taps]),
            biases=np.ascontiguousarray(biases),
            history=np.zeros((blocks, 4 * ring, LANES), np.float32),
            scratch=np.zeros((blocks, 2 * len(taps) + 2 * net.num_neurons + 1, LANES), np.float32),
        )


@njit(cache=True, nogil=True)
def _reset(arrays: ActuatorArrays, position_target: np.ndarray, joint_pos: np.ndarray) -> None:
    """Fill the history with the current error and zero velocity."""
    ring2 = arrays.history.shape[1] // 2
    arrays.history[:] = np.float32(0.0)
    arrays.memory[:] = 0.0
    for motor in range(position_target.shape[0]):
        error = (position_target[motor] - joint_pos[motor]) * arrays.parameters[0, 0]
        arrays.history[motor // LANES, :ring2, motor % LANES] = np.float32(error)


@njit(cache=True, nogil=True)
def _write_history(history, parameters, slot, position_target, joint_pos, joint_vel):
    """Write error and velocity twice, one ring apart: reads of any age need no wrap-around."""
    ring = history.shape[1] // 4
    for motor in range(position_target.shape[0]):
        block = motor // LANES
        lane = motor % LANES
        error = np.float32((position_target[motor] - joint_pos[motor]) * parameters[0, 0])
        velocity = np.float32(joint_vel[motor] * parameters[1, 0])
        history[block, slot, lane] = error
        history[block, slot + ring, lane] = error
        history[block, slot + 2 * ring, lane] = velocity
        history[block, slot + 3 * ring, lane] = velocity


def _product_added(typingctx, total, weight, x):
    """Add weight·x to total, fused where the processor can.

    ``total`` and ``x`` are addresses of LANES float32.
    """

    def codegen(context, builder, signature, arguments):
        total, weight, x = arguments
        old_total = Vector.load(builder, total, LANES, FLOAT).value
        factor = Vector.load(builder, x, LANES, FLOAT).value
        weights = Vector.broadcast(builder, weight, LANES).value
        product = builder.fmul(weights, factor, flags=("contract",))
        new_total = builder.fadd(old_total, product, flags=("contract",))
        Vector(builder, new_total).store(total)
        return context.get_dummy_value()

    return types.void(types.intp, types.float32, types.intp), codegen


def _softened(typingctx, address):
    """Softsign x / (1 + |x|) of LANES float32 at this address."""

    def codegen(context, builder, signature, arguments):
        x = Vector.load(builder, arguments[0], LANES, FLOAT)
        (x / (1.0 + abs(x))).store(arguments[0])
        return context.get_dummy_value()

    return types.void(types.intp), codegen


_add_product: Any = intrinsic(_product_added)
_soften: Any = intrinsic(_softened)


@njit(cache=True, nogil=True)
def _layer(weights, inputs, biases, outputs):
    """outputs[k] = biases[k] + Σ_i weights[i, k]·inputs[i], in rows of 16 float32.

    ``weights`` is flat, row-major.
    """
    outputs[:] = biases
    neurons = outputs.shape[0]
    x = inputs.ctypes.data
    y = outputs.ctypes.data
    for i in range(inputs.shape[0]):
        for k in range(neurons):
            _add_product(y + 4 * LANES * k, weights[i * neurons + k], x + 4 * LANES * i)


@njit(cache=True, nogil=True)
def _evaluate(weights, inputs, biases, history, scratch, slot):
    """Write inputs, hidden neurons and torque / torque_scale of a block into ``scratch``."""
    count = inputs.shape[0]
    neurons = (biases.shape[0] - 1) // 2
    second = count + neurons
    last = count + 2 * neurons
    address = scratch.ctypes.data
    for i in range(count):
        scratch[i] = history[slot + inputs[i]]
    _layer(weights, scratch[:count], biases[:neurons], scratch[count:second])
    for row in range(count, second):
        _soften(address + 4 * LANES * row)
    _layer(
        weights[count * neurons :],
        scratch[count:second],
        biases[neurons : 2 * neurons],
        scratch[second:last],
    )
    for row in range(second, last):
        _soften(address + 4 * LANES * row)
    _layer(weights[neurons * second :], scratch[second:last], biases[2 * neurons :], scratch[last:])


@njit(cache=True, nogil=True)
def _step(arrays, physics_dt, position_target, joint_pos, joint_vel, torque):
    """Every period, write the torque [N·m] of the network into the first row of the memory."""
    arrays = without_refcounts(arrays)
    if arrays.clock[0] % arrays.clock[1] == 0:
        slot = (arrays.clock[0] // arrays.clock[1]) % (arrays.history.shape[1] // 4)
        _write_history(
            arrays.history, arrays.parameters, slot, position_target, joint_pos, joint_vel
        )
        for block in range(arrays.history.shape[0]):
            biases = arrays.biases[block]
            history = arrays.history[block]
            scratch = arrays.scratch[block]
            _evaluate(arrays.weights, arrays.inputs, biases, history, scratch, slot)
        scale = arrays.parameters[2, 0]
        limit = arrays.parameters[3, 0]
        for motor in range(torque.shape[0]):
            raw = scale * float(arrays.scratch[motor // LANES, -1, motor % LANES])
            arrays.memory[0, motor] = min(limit, max(-limit, raw))
    torque[:] = arrays.memory[0]


LATENT = ActuatorKind("latent", "latent network", reset=_reset, step=_step)
