"""Effect of each MuJoCo setting on the time of an mj_step of this robot, and on the motion of a trot.

python benchmarks/levers.py [--json FILE]

Every variant replays the same torques (for the time) and the same trot in closed loop on the same motors (for
the motion); times are medians of interleaved runs. Motion: root mean square difference of all joint angles over
the first second, against the shipped settings and against steps of 0.25 ms.
"""

import argparse
import ctypes
import json
import time
from collections.abc import Callable
from contextlib import nullcontext
from typing import Any
from unittest.mock import patch

import mujoco
import numpy as np

from motorprior.actuator.ideal_pd import IdealPd
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.signals import rmse
from motorprior.simulation import build_model
from motorprior.simulation.build_model import FLOOR
from motorprior.simulation.mj_call import library
from motorprior.simulation.playback import replay
from motorprior.simulation.world import World
from motorprior.simulation.world_config import WorldConfig
from speed import mj_steps, recorded, zero_policy_targets

MOTORS = IdealPd.uniform(12, kp=8.8, kd=0.84, torque_limit=1.26, armature=0.003, delay=0.008)
UNDAMPED = IdealPd.uniform(12, kp=4.0, kd=0.0, torque_limit=1.26, armature=0.003)
"""Without damping for the engine, as physical motors are: Euler then needs no second factorisation."""
FINE_DT = 0.00025
REPEATS = 9


def every_geom(builder: Any, *settings: Any) -> None:
    """Add the floor with contacts between it and all geoms instead of explicit pairs with the feet, else the same."""
    FEET_ONLY(builder, *settings)
    friction, solref = list(builder.pairs[0].friction), list(builder.pairs[0].solref)
    for pair in list(builder.pairs):
        builder.delete(pair)
    for geom in builder.geoms:
        geom.contype, geom.conaffinity = (2, 1) if geom.name == FLOOR else (1, 2)
        geom.friction, geom.solref = [friction[0], *friction[2:4]], solref


FEET_ONLY = build_model._add_floor


def option(**values: object) -> Callable[[mujoco.MjModel], None]:
    """Set fields of mjOption."""

    def change(compiled: mujoco.MjModel) -> None:
        for name, value in values.items():
            setattr(compiled.opt, name, value)

    return change


def islands_on(compiled: mujoco.MjModel) -> None:
    """Let MuJoCo look for constraint islands."""
    compiled.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_ISLAND)


def critical_contacts(compiled: mujoco.MjModel) -> None:
    """MuJoCo's own damping ratio of the feet's contacts, whatever the step."""
    compiled.pair_solref[:, 1] = 1.0


VARIANTS: dict[str, Callable[[mujoco.MjModel], None]] = {
    "shipped": lambda compiled: None,
    "islands on": islands_on,
    "every geom collides": lambda compiled: None,
    "contact damping ratio 1": critical_contacts,
    "sparse Jacobian": option(jacobian=int(mujoco.mjtJacobian.mjJAC_SPARSE)),
    "implicitfast": option(integrator=int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)),
    "implicit": option(integrator=int(mujoco.mjtIntegrator.mjINT_IMPLICIT)),
    "RK4": option(integrator=int(mujoco.mjtIntegrator.mjINT_RK4)),
    "elliptic cone": option(cone=int(mujoco.mjtCone.mjCONE_ELLIPTIC)),
    "solver CG": option(solver=int(mujoco.mjtSolver.mjSOL_CG)),
    "tolerance 1e-5": option(tolerance=1e-5),
    "at most 3 iterations": option(iterations=3),
    "warm start off": lambda compiled: setattr(
        compiled.opt, "disableflags", compiled.opt.disableflags | int(mujoco.mjtDisableBit.mjDSBL_WARMSTART)
    ),
    "joint limits off": lambda compiled: setattr(
        compiled.opt, "disableflags", compiled.opt.disableflags | int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    ),
    "engine timers on": lambda compiled: None,
}


def world_of(name: str, physics_dt: float = 0.002) -> World:
    """A world with one setting changed."""
    swap = patch.object(build_model, "_add_floor", every_geom) if name == "every geom collides" else nullcontext()
    with swap:
        world = World(WorldConfig.of(PUPPER_V2, physics_dt=physics_dt))
    VARIANTS[name](world.model)
    return world


def drive_of(motors: IdealPd, targets: np.ndarray) -> np.ndarray:
    """(2, physics steps, 12) torques and damping that the shipped engine is given on this trot."""
    world = world_of("shipped")
    drive = np.zeros((2, len(targets) * world.config.substeps, 12))
    recorded(world.arrays, world.reset(motors), targets, drive)
    return drive


def apart(one: np.ndarray, other: np.ndarray) -> float:
    """RMS difference of joint angles at the control steps of the first second [mrad]."""
    a, b = (angles[len(angles) // 200 - 1 :: len(angles) // 200][:100] for angles in (one, other))
    return float(1e3 * rmse(a, b))


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json")
    path = parser.parse_args().json
    clock = ctypes.c_void_p.in_dll(library(), "mjcb_time")
    ticking = clock.value  # what the Python bindings gave MuJoCo; a World takes it away
    targets = zero_policy_targets(PUPPER_V2, 200)
    fine = replay(world_of("shipped", FINE_DT), MOTORS, targets).joint_pos
    shipped = replay(world_of("shipped"), MOTORS, targets).joint_pos
    figures, works = {}, {}
    for name in VARIANTS:
        joint_pos = replay(world_of(name), MOTORS, targets).joint_pos
        figures[f"from_shipped_mrad/{name}"] = apart(joint_pos, shipped)
        figures[f"from_fine_steps_mrad/{name}"] = apart(joint_pos, fine)
        for kind, motors in (("undamped", UNDAMPED), ("damped", MOTORS)):
            works[name, kind] = (world_of(name), motors, drive_of(motors, targets))
    seconds: dict[tuple[str, str], list[float]] = {key: [] for key in works}
    for _ in range(REPEATS):
        for key, (world, motors, drive) in works.items():
            world.reset(motors)
            clock.value = ticking if key[0] == "engine timers on" else None
            started = time.perf_counter()
            mj_steps(world.arrays, drive)
            seconds[key].append((time.perf_counter() - started) / drive.shape[1])
    clock.value = None
    for (name, kind), values in seconds.items():
        ratio = np.median(np.array(values) / np.array(seconds["shipped", kind]))
        figures[f"mj_step_us_{kind}/{name}"] = 1e6 * float(np.median(values))
        figures[f"time_over_shipped_{kind}/{name}"] = float(ratio)
    print("setting | mj_step over shipped, undamped | damped joints | from shipped [mrad] | from 0.25 ms [mrad]")
    for name in VARIANTS:
        columns = [figures[f"time_over_shipped_{kind}/{name}"] for kind in ("undamped", "damped")]
        columns += [figures[f"from_{which}_mrad/{name}"] for which in ("shipped", "fine_steps")]
        print(name, "|", " | ".join(f"{value:.2f}" for value in columns))
    print("shipped mj_step [us]:", round(figures["mj_step_us_undamped/shipped"], 2))
    if path:
        with open(path, "w", encoding="utf-8") as file:
            json.dump(figures, file, indent=1)


if __name__ == "__main__":
    main()
