"""Arrays of motors, which compiled code reads and writes."""

from typing import NamedTuple

import numpy as np

NO_FRAMES = np.zeros((0, 0))
_NO_BLOCKS = np.zeros((0, 0, 16), np.float32)


class KernelTable(NamedTuple):
    """Addresses of an actuator kind's compiled functions in this process; see `ActuatorKind`."""

    reset: int
    step: int
    read_encoders: int
    make_explicit: int


class ActuatorArrays(NamedTuple):
    """Arrays of n motors for compiled code. Networks are evaluated in blocks of 16 motors.

    The module of a kind names the rows of ``parameters`` and ``memory``. Only networks have the
    fields from ``weights`` on.
    """

    kernels: KernelTable
    parameters: np.ndarray  # (rows, n) float64
    memory: np.ndarray  # (rows, n) float64, state
    # (2,) int64: steps since reset; steps per network update, or substeps per step
    clock: np.ndarray
    # (n,) float64 [N·m·s/rad] that the engine integrates implicitly in the coming step
    damping: np.ndarray
    # command frames of `command_frame`; without rows for position commands at constant gains
    frames: np.ndarray = NO_FRAMES
    weights: np.ndarray = np.zeros(0, np.float32)  # flat: matrices of the layers, row-major
    # (inputs,) rows of the history that are inputs, counted from the newest
    inputs: np.ndarray = np.zeros(0, np.int64)
    # (blocks, neurons of all layers, 16); the first layer's include z
    biases: np.ndarray = _NO_BLOCKS
    # (blocks, 4·ring, 16): scaled error twice, then velocity twice; state
    history: np.ndarray = _NO_BLOCKS
    scratch: np.ndarray = _NO_BLOCKS  # (blocks, inputs and neurons of all layers, 16)
