"""Replay of given position targets on a simulated robot, recording every joint's motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motorprior.actuator.actuator import Actuator, ActuatorArrays
from motorprior.actuator.kernels import without_refcounts
from motorprior.compiled import njit
from motorprior.exceptions import SimulationFault
from motorprior.simulation.world import World
from motorprior.simulation.world_step import FAULTS, WorldArrays, physics_step, read_joints


@dataclass(frozen=True)
class Playback:
    """A recording of C control steps with P physics steps in all."""

    joint_pos: np.ndarray  # (P, joints) [rad] after each physics step
    joint_torque: np.ndarray  # (P, joints) [N·m] during each physics step
    measured_joint_pos: np.ndarray  # (C, joints) [rad] at the encoders, before each control step
    base: np.ndarray  # (C, 7) position [m] and quaternion before each control step; empty if it is fixed


@njit(cache=True, nogil=True)
def _play(
    world: WorldArrays,
    motors: ActuatorArrays,
    targets: np.ndarray,
    joint_pos: np.ndarray,
    joint_torque: np.ndarray,
    measured: np.ndarray,
    base: np.ndarray,
) -> None:
    world, motors, targets = without_refcounts(world), without_refcounts(motors), without_refcounts(targets)
    n = targets.shape[1]
    row = 0
    for step in range(targets.shape[0]):
        read_joints(world, motors, measured[step])
        if base.shape[0] > 0:
            base[step] = world.qpos[:7]
        for _ in range(world.substeps):
            physics_step(world, motors, targets[step])
            joint_torque[row] = world.torque
            joint_pos[row] = world.qpos[world.qpos.shape[0] - n :]
            row += 1


def replay(
    world: World,
    actuator: Actuator,
    targets: np.ndarray,
    start: np.ndarray | None = None,
    lead_in: np.ndarray | None = None,
    tolerate_fault: bool = False,
) -> Playback:
    """Hold each row of ``targets`` (C, joints) [rad] for one control step, from rest at ``start``.

    Args:
        world: simulated robot; it is reset first.
        actuator: one motor per joint.
        targets: position targets.
        start: joint angles at the beginning; the nominal pose if not given.
        lead_in: (L, joints) targets held before the recording begins.
        tolerate_fault: return the recording even if the simulation diverged in it.

    Raises:
        SimulationFault: the state became NaN or the engine's memory was full.
    """
    held = targets if lead_in is None else np.concatenate([lead_in, targets])
    held = np.ascontiguousarray(held, dtype=np.float64)
    steps, n = held.shape
    physics, before = steps * world.substeps, steps - len(targets)
    pos, torque, measured = np.zeros((physics, n)), np.zeros((physics, n)), np.zeros((steps, n))
    base = np.zeros((0 if world.is_fixed else steps, 7))
    motors = world.reset(actuator, start)
    _play(world.arrays, motors, held, pos, torque, measured, base)
    fault = world.fault()
    if fault and not tolerate_fault:
        raise SimulationFault(FAULTS[fault], remedy="shorten physics_dt or check the motors' gains")
    first = before * world.substeps
    return Playback(pos[first:], torque[first:], measured[before:], base[before:])
