"""The C++ for simulators on a GPU moves motors as the compiled step does; Warp is not needed."""

import ctypes
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from grey_boxes import make_grey_box

import exports as bench
from motorprior.actuator.grey_box import LINE, GreyBoxActuator, memory_rows
from motorprior.actuator.motors import Motors
from motorprior.actuator.optional_terms import TERMS
from motorprior.exports.step_code import KP_LINE, LINES, step_code

COMPILER = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")
COUNT = 7
STEPS = 400
TERMS_OF_MOTORS = [(), *((term,) for term in TERMS), tuple(TERMS)]
# what Warp brings; in double precision, so that only rounding is left
PROGRAM = """
#include <algorithm>
#include <cmath>

namespace wp {{
using std::abs; using std::copysign; using std::max; using std::min; using std::sqrt;
}}

template <typename T> struct Array {{ T* data; int shape[2]; }};

extern "C" void step_motors(
    double* table_, double* memory_, int* clock_, int rows, int n_, double h, const double* inputs,
    double* torque_, double* damping_)
{{
    Array<double> table{{table_, {{0, n_}}}}, memory{{memory_, {{rows, n_}}}};
    Array<int> clock{{clock_, {{n_, 0}}}};
    Array<double> torque{{torque_, {{n_, 0}}}}, damping{{damping_, {{n_, 0}}}};
    for (int i = 0; i < n_; ++i) {{
        const double position_target = inputs[i];
        const double joint_pos = inputs[n_ + i];
        const double joint_vel = inputs[2 * n_ + i];
        const double sent_velocity_target = inputs[3 * n_ + i];
        const double sent_torque_feedforward = inputs[4 * n_ + i];
        const double sent_kp_factor = inputs[5 * n_ + i];
        const double sent_kd_factor = inputs[6 * n_ + i];
        {step}
    }}
}}
"""


def in_double_precision(code: str) -> str:
    """The code with all numbers as double."""
    without_suffixes = re.sub(r"(?<=[\d.])f\b", "", code)
    return re.sub(r"\bfloat\b", "double", without_suffixes)


def built(code: str, folder: Path) -> Callable[..., None]:
    """The compiled function of PROGRAM."""
    source = folder / "step.cpp"
    source.write_text(PROGRAM.format(step=in_double_precision(code)), "utf-8")
    library = folder / "step.so"
    assert COMPILER is not None
    options = ["-std=c++17", "-O1", "-ffp-contract=off", "-shared", "-fPIC"]
    subprocess.run([COMPILER, *options, str(source), "-o", str(library)], check=True)
    return ctypes.CDLL(str(library)).step_motors


def pointer(array: np.ndarray) -> ctypes.c_void_p:
    return array.ctypes.data_as(ctypes.c_void_p)


@pytest.mark.skipif(COMPILER is None, reason="needs a C++ compiler")
@pytest.mark.parametrize("terms", TERMS_OF_MOTORS, ids=str)
def test_the_code_moves_motors_as_the_compiled_step(terms: tuple[str, ...], tmp_path: Path):
    rng = np.random.default_rng(3)
    motors = GreyBoxActuator(make_grey_box(terms=terms), rng.standard_normal((COUNT, 3)))
    compiled = Motors(motors, bench.DT, np.zeros(COUNT))
    step_in_cpp = built(step_code(terms), tmp_path)

    # a restart at angle 0, as in `warp_motors`
    table = motors.table(bench.DT)
    length = memory_rows(bench.DT) - LINE
    memory = np.zeros((LINE + LINES * length, COUNT))
    memory[LINE + KP_LINE * length :] = 1.0
    clock = np.zeros(COUNT, np.int32)
    torque = np.zeros(COUNT)
    damping = np.zeros(COUNT)

    def step(target: np.ndarray, q: np.ndarray, dq: np.ndarray, **frame):
        """A step of both, of which the compiled one moves the joints."""
        ours = compiled.step(target, q, dq, **frame)
        command = [target, q, dq, *frame.values()]
        inputs = np.array([np.broadcast_to(value, COUNT) for value in command])
        numbers = [ctypes.c_int(len(memory)), ctypes.c_int(COUNT), ctypes.c_double(bench.DT)]
        arrays = map(pointer, (table, memory, clock))
        step_in_cpp(*arrays, *numbers, *map(pointer, (inputs, torque, damping)))
        np.testing.assert_allclose(torque, ours[0], rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(damping, ours[1], rtol=1e-5, atol=1e-6)
        return ours

    angles = bench.free_run(step, COUNT, STEPS, bench.mit_frames)
    assert np.abs(angles).max() > 0.3, "they move"
