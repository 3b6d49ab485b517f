"""One layer of a network for 16 motors in parallel, in float32.

LLVM does not vectorise the plain loops, so an intrinsic emits the code: the lanes of a vector register are 16 motors,
each weight is broadcast, and one call computes four neurons of a layer with their accumulators in registers,

    y[k] = softsign(b[k] + Σ_i w[i, k]·x[i]),   softsign(a) = a / (1 + |a|),   k = 0..3.

Arrays are C-contiguous float32 of shape (rows, 16). The inputs x[i] are consecutive rows of such an array, or the rows
of a history that a list of row numbers selects.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from motorprior.actuator.vector import Vector
from motorprior.compiled import njit

LANES = 16
_FLOAT, _INT = ir.FloatType(), ir.IntType(64)
_BLOCK = 4  # neurons per call


def _address(builder, base, index, size):
    """Integer address of element ``index`` of ``size`` bytes."""
    return builder.add(base, builder.mul(index, ir.Constant(_INT, size)))


def _load(builder, base, index, kind, size):
    return builder.load(builder.inttoptr(_address(builder, base, index, size), kind.as_pointer()), align=size)


def _load_lanes(builder, base, index):
    return Vector.load(builder, _address(builder, base, index, 4 * LANES), LANES, _FLOAT)


def _neurons(number, activation, picked=False):
    """An intrinsic for ``number`` neurons; if ``picked``, input i is row ``rows[i]`` instead of row i."""

    def neurons(typingctx, weights, stride, inputs, rows, count, biases, outputs):
        """Integer addresses of w (row stride ``stride`` floats), x, rows, b, y; ``count`` inputs, at least one."""
        signature = types.void(*([types.intp] * 7))

        def codegen(context, builder, signature, arguments):
            _emit(builder, arguments, number, activation, picked)
            return context.get_dummy_value()

        return signature, codegen

    return intrinsic(neurons)


def _emit(builder, arguments, number, activation, picked):
    """sum[k] = b[k]; for i in range(count): sum[k] += w[i, k]·x[i]; y[k] = activation(sum[k])."""
    weights, stride, inputs, rows, count, biases, outputs = arguments
    start = builder.block
    loop, done = builder.append_basic_block("inputs"), builder.append_basic_block("store")
    initial = [_load_lanes(builder, biases, ir.Constant(_INT, k)).value for k in range(number)]
    builder.branch(loop)
    builder.position_at_end(loop)
    index = builder.phi(_INT)
    sums = [builder.phi(ir.VectorType(_FLOAT, LANES)) for _ in range(number)]
    x = _load_lanes(builder, inputs, _load(builder, rows, index, _INT, 8) if picked else index).value
    row = builder.mul(index, stride)
    following = builder.add(index, ir.Constant(_INT, 1))
    index.add_incoming(ir.Constant(_INT, 0), start)
    index.add_incoming(following, loop)
    totals = []
    for k in range(number):
        weight = _load(builder, weights, builder.add(row, ir.Constant(_INT, k)), _FLOAT, 4)
        product = builder.fmul(Vector.broadcast(builder, weight, LANES).value, x, flags=("contract",))
        totals.append(builder.fadd(sums[k], product, flags=("contract",)))
        sums[k].add_incoming(initial[k], start)
        sums[k].add_incoming(totals[k], loop)
    builder.cbranch(builder.icmp_signed("<", following, count), loop, done)
    builder.position_at_end(done)
    for k in range(number):
        activation(Vector(builder, totals[k])).store(_address(builder, outputs, ir.Constant(_INT, k), 4 * LANES))


def _softsign(x):
    return x / (1.0 + abs(x))


_four_softsign_neurons = _neurons(_BLOCK, _softsign)
_four_first_neurons = _neurons(_BLOCK, _softsign, picked=True)
_one_linear_neuron = _neurons(1, lambda total: total)


@njit(cache=True, nogil=True)
def first_layer(
    weights: np.ndarray, history: np.ndarray, newest: int, rows: np.ndarray, biases: np.ndarray, outputs: np.ndarray
) -> None:
    """As `softsign_layer`; inputs are ``rows`` (inputs,) int64 of a ``history`` (rows, 16), counted from ``newest``.

    The matrix starts at the first element of ``weights``; the biases include z.
    """
    neurons, count, x = outputs.shape[0], rows.shape[0], history.ctypes.data + 4 * LANES * newest
    w, b, y = weights.ctypes.data, biases.ctypes.data, outputs.ctypes.data
    for k in range(0, neurons, _BLOCK):
        at = 4 * LANES * k
        _four_first_neurons(w + 4 * k, neurons, x, rows.ctypes.data, count, b + at, y + at)  # pyright: ignore


@njit(cache=True, nogil=True)
def softsign_layer(
    weights: np.ndarray, offset: int, inputs: np.ndarray, biases: np.ndarray, outputs: np.ndarray
) -> None:
    """One softsign layer for 16 motors: inputs (inputs, 16), biases and outputs (neurons, 16), a multiple of 4.

    The layer's matrix (inputs, neurons) starts at ``offset`` of ``weights``, flat and row-major; all are float32.
    """
    neurons, count = outputs.shape[0], inputs.shape[0]
    w, x, b, y = weights.ctypes.data + 4 * offset, inputs.ctypes.data, biases.ctypes.data, outputs.ctypes.data
    for k in range(0, neurons, _BLOCK):
        at = 4 * LANES * k
        _four_softsign_neurons(w + 4 * k, neurons, x, 0, count, b + at, y + at)  # pyright: ignore


@njit(cache=True, nogil=True)
def linear_output(
    weights: np.ndarray, offset: int, inputs: np.ndarray, biases: np.ndarray, outputs: np.ndarray
) -> None:
    """One linear output for 16 motors; arguments as for `softsign_layer`, with one neuron."""
    w, x, b, y = weights.ctypes.data + 4 * offset, inputs.ctypes.data, biases.ctypes.data, outputs.ctypes.data
    _one_linear_neuron(w, 1, x, 0, inputs.shape[0], b, y)  # pyright: ignore[reportCallIssue]
