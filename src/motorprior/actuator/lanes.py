"""Sixteen motors side by side: one network layer as 16-wide float32 arithmetic.

LLVM does not find this layout from plain loops, so an intrinsic spells it out: the 16 lanes of a
vector register are 16 motors, and each weight is broadcast. One call makes four neurons of a layer,

    y[k] = softsign(b[k] + Σ_i w[i, k]·x[i]),   softsign(a) = a / (1 + |a|),   k = 0..3,

which keeps four accumulators in registers. Arrays are C-contiguous float32 of shape (rows, 16). The inputs x[i] are
rows of such an array: in turn, or, of a history, those that a list of row numbers picks.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from motorprior.compiled import njit

LANES = 16
_FLOAT = ir.FloatType()
_VECTOR = ir.VectorType(_FLOAT, LANES)
_INT = ir.IntType(64)
_BLOCK = 4


def _address(builder, base, index, width):
    """Pointer to float32 vector number ``index`` (of ``width`` floats each) from an integer address."""
    offset = builder.mul(index, ir.Constant(_INT, 4 * width))
    return builder.inttoptr(builder.add(base, offset), _VECTOR.as_pointer())


def _load_vector(builder, base, index):
    return builder.load(_address(builder, base, index, LANES), align=4)


def _broadcast(builder, scalar):
    single = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(single, ir.Constant(_VECTOR, ir.Undefined), zeros)


def _load_weight(builder, base, index):
    pointer = builder.add(base, builder.mul(index, ir.Constant(_INT, 4)))
    return builder.load(builder.inttoptr(pointer, _FLOAT.as_pointer()), align=4)


def _load_number(builder, base, index):
    pointer = builder.add(base, builder.mul(index, ir.Constant(_INT, 8)))
    return builder.load(builder.inttoptr(pointer, _INT.as_pointer()), align=8)


def _softsign(builder, value):
    zero, one = ir.Constant(_VECTOR, [0.0] * LANES), ir.Constant(_VECTOR, [1.0] * LANES)
    negative = builder.fcmp_ordered("<", value, zero)
    magnitude = builder.select(negative, builder.fsub(zero, value), value)
    return builder.fdiv(value, builder.fadd(one, magnitude))


def _neurons(number, activation, picked=False):
    """An intrinsic for ``number`` neurons; where ``picked``, input i is row ``rows[i]``, not row i."""

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
    initial = [_load_vector(builder, biases, ir.Constant(_INT, k)) for k in range(number)]
    builder.branch(loop)
    builder.position_at_end(loop)
    index = builder.phi(_INT)
    sums = [builder.phi(_VECTOR) for _ in range(number)]
    x = _load_vector(builder, inputs, _load_number(builder, rows, index) if picked else index)
    row = builder.mul(index, stride)
    following = builder.add(index, ir.Constant(_INT, 1))
    index.add_incoming(ir.Constant(_INT, 0), start)
    index.add_incoming(following, loop)
    totals = []
    for k in range(number):
        weight = _load_weight(builder, weights, builder.add(row, ir.Constant(_INT, k)))
        product = builder.fmul(_broadcast(builder, weight), x, flags=("contract",))
        totals.append(builder.fadd(sums[k], product, flags=("contract",)))
        sums[k].add_incoming(initial[k], start)
        sums[k].add_incoming(totals[k], loop)
    builder.cbranch(builder.icmp_signed("<", following, count), loop, done)
    builder.position_at_end(done)
    for k in range(number):
        pointer = _address(builder, outputs, ir.Constant(_INT, k), LANES)
        builder.store(activation(builder, totals[k]), pointer, align=4)


_four_softsign_neurons = _neurons(_BLOCK, _softsign)
_four_first_neurons = _neurons(_BLOCK, _softsign, picked=True)
_one_linear_neuron = _neurons(1, lambda builder, total: total)


@njit(cache=True, nogil=True)
def first_layer(
    weights: np.ndarray, history: np.ndarray, newest: int, rows: np.ndarray, biases: np.ndarray, outputs: np.ndarray
) -> None:
    """As `softsign_layer`; inputs are ``rows`` (inputs,) int64 of a ``history`` (rows, 16), counted from ``newest``.

    The matrix is at the beginning of ``weights``; z is folded into the biases.
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
