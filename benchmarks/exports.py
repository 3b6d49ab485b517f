"""What exports of motors lose, and how far the GPU kernel is from the compiled motors.

    python benchmarks/exports.py --out runs/exports

figures.json: FORMAT/leg, FORMAT/shank and FORMAT/leg_steps, the RMSE of exported against our own joint angles over
MOTORS motors [rad] (`exports.registry`), for bam, mjcf, mjcf_detailed and table; kernel/parity_median and
kernel/parity, median and maximum over 64 motors of the largest difference of angles [rad] in 2000 steps of 2 ms between
the Warp kernel in float32 and the compiled motors, each in its own closed loop; left out without the extras mjlab and
newton. The motors have the true constants of the fleet pupper_v2.
"""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from figures import report
from motorprior.actuator.geared_motor_step import PARAMETERS
from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.actuator.motors import Motors
from motorprior.actuator.physical import PhysicalMotors
from motorprior.bench.families import require_geared
from motorprior.bench.fleet import load_fleet
from motorprior.exports.bam import motors_of
from motorprior.exports.registry import EXPORTERS, MAX_STEP, is_supported, losses

DT, STEPS, COUNT, INERTIA, MOTORS = 0.002, 2000, 64, 0.002, 12
MIN_CONSTANT = 1e-6


def true_grey_box(motors: PhysicalMotors) -> GreyBoxActuator:
    """Grey boxes with these constants, one latent per constant."""
    positive = (*(name for name in PARAMETERS if name not in ("kd_over_kp", "encoder_zero")), "kd")
    values = {name: np.maximum(getattr(motors, name), MIN_CONSTANT) for name in positive}
    return motors_of(values | {"encoder_zero": motors.encoder_zero})


def targets(step: int, count: int) -> np.ndarray:
    """(count,) sines of several frequencies with jumps, at which the torque limit is reached [rad]."""
    phase = np.arange(count)
    return 0.4 * np.sin(2 * np.pi * (0.5 + 0.05 * (phase % 20)) * step * DT + phase) + 0.4 * (step // 250 % 2)


Step = Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def free_run(step_motors: Step, count: int, steps: int) -> np.ndarray:
    """(steps, count) joint angles [rad] on a load of INERTIA, with torques and dampings of ``step_motors``."""
    q, dq, out = np.zeros(count), np.zeros(count), np.zeros((steps, count))
    for step in range(steps):
        torque, damping = step_motors(targets(step, count), q, dq)
        dq = (dq + DT * torque / INERTIA) / (1.0 + DT * damping / INERTIA)
        q = q + DT * dq
        out[step] = q
    return out


def compiled(motors: GreyBoxActuator) -> Step:
    """Our own motors."""
    return Motors(motors, DT, np.zeros(motors.num_motors)).step


def warp_array(values: Any, kind: Any = float) -> Any:
    """A Warp array on the CPU."""
    import warp as wp

    return wp.array(np.asarray(values), dtype=kind, device="cpu")


def kernel(motors: GreyBoxActuator) -> Step:
    """The Warp kernel alone."""
    import warp as wp

    from motorprior.exports.warp_motors import WarpMotors

    count = motors.num_motors
    found, zero = WarpMotors(motors, count, DT, "cpu"), warp_array(np.zeros(count))
    found.reset(warp_array(np.ones(count, bool), wp.bool), warp_array(np.arange(count), int), zero, zero)

    def step(*given: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found.step(*(warp_array(each) for each in given))
        return found.torque.numpy().astype(float), found.damping.numpy().astype(float)

    return step


def measure(out: Path = Path("runs/exports")) -> None:
    """Measure, print and write; see the module docstring."""
    rng, fleet = np.random.default_rng(0), load_fleet("pupper_v2")
    few, every = (true_grey_box(require_geared(fleet.sample(n, rng))) for n in (MOTORS, COUNT))
    figures: dict[str, float] = {}
    for name, exporter in EXPORTERS.items():
        if not is_supported(exporter):
            print(f"{name} left out: it needs MuJoCo {exporter.mujoco}")
            continue
        if exporter.replay is not None:
            found = losses(exporter.replay, few, MAX_STEP)
            figures |= {f"{name.replace('-', '_')}/{load}": value for load, value in found.items()}
    if find_spec("warp"):
        ours, theirs = (free_run(make(every), COUNT, STEPS) for make in (compiled, kernel))
        apart = np.abs(ours - theirs).max(axis=0)
        figures |= {"kernel/parity_median": float(np.median(apart)), "kernel/parity": float(apart.max())}
    else:
        print("kernel/parity left out: install the extra mjlab or newton")
    report(figures, out / "figures.json")


if __name__ == "__main__":
    tyro.cli(measure, description=__doc__)
