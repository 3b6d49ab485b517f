"""Replay of given position targets on a simulated robot, recording every joint's motion."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.kernels import without_refcounts
from motorprior.bench.learned_excitation import excitation_of
from motorprior.bounds import generator_of, require_array
from motorprior.compiled import njit
from motorprior.exceptions import SimulationFault
from motorprior.logs.motor_log import MotorLog, checked
from motorprior.robots.load import as_robot
from motorprior.robots.robot import Robot
from motorprior.simulation.motors import MotorSource, simulated_motors
from motorprior.simulation.world import FAULTS, World, find_fault, physics_step, read_joints


@dataclass(frozen=True)
class Playback:
    """A recording of C control steps with P physics steps in all."""

    joint_pos: np.ndarray  # (P, joints) [rad] after each physics step
    joint_torque: np.ndarray  # (P, joints) [N·m] during each physics step
    measured_joint_pos: np.ndarray  # (C, joints) [rad] at the encoders, before each control step
    # (C, 7) position [m] and quaternion before each control step; empty if it is fixed
    base: np.ndarray


@njit(cache=True, nogil=True)
def _play(world, motors, targets, joint_pos, joint_torque, measured, base):
    world = without_refcounts(world)
    motors = without_refcounts(motors)
    targets = without_refcounts(targets)
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
    """Reset the world to rest at ``start``, and hold each row of ``targets`` (C, joints) [rad] for one control step.

    ``start`` (joints,) [rad] is the nominal pose if not given; the targets ``lead_in`` (L, joints)
    are held before the recording begins; a diverged simulation is a SimulationFault unless
    ``tolerate_fault``.
    """
    held = targets if lead_in is None else np.concatenate([lead_in, targets])
    held = np.ascontiguousarray(held, dtype=np.float64)
    steps, n = held.shape
    physics = steps * world.substeps
    before = steps - len(targets)
    pos = np.zeros((physics, n))
    torque = np.zeros((physics, n))
    measured = np.zeros((steps, n))
    base = np.zeros((0 if world.is_fixed else steps, 7))
    motors = world.reset(actuator, start)
    _play(world.arrays, motors, held, pos, torque, measured, base)
    fault = find_fault(world.arrays)
    if fault and not tolerate_fault:
        raise SimulationFault(FAULTS[fault], remedy="shorten physics_dt or check the motors' gains")
    first = before * world.substeps
    return Playback(pos[first:], torque[first:], measured[before:], base[before:])


def simulate(
    robot: Robot | str | Path,
    motors: MotorSource,
    targets: np.ndarray,
    *,
    seed: int | np.random.Generator = 0,
    suspended: bool = False,
) -> Playback:
    """Simulate a robot that starts at rest in its nominal pose; each row of ``targets`` lasts one control step.

    Args:
        robot: a name, the path of a .toml file, or the result of `load_robot`; with legs or
            without.
        motors: one per joint, or a prior, posterior or fleet to sample.
        targets: (C, joints) position targets [rad], in the order of ``robot.joint_names``.
        seed: of the sample of motors.
        suspended: suspend a free base in the air.

    Raises:
        ConfigError, ArtifactError: motors or targets that do not fit the robot, or a robot that
        cannot be read.
        SimulationFault: NaN, a reset or a full buffer of the engine.
    """
    robot = as_robot(robot)
    found = simulated_motors(motors, robot)
    wanted = require_array("targets", targets, (len(targets), robot.num_joints))
    return replay(World(robot, found.physics_dt, suspended), found.draw(generator_of(seed)), wanted)


def excitation_targets(
    robot: Robot, kind: str, seconds: float, amplitude: float, seed: int
) -> np.ndarray:
    """(control steps, joints) targets [rad]: every joint has its own signal about the nominal pose."""
    excitation = excitation_of(kind)
    rng = np.random.default_rng([seed, 0x51E7])  # not the random stream of the motors
    steps = max(2, round(seconds / robot.control_dt))
    away = excitation.streams(rng, steps, robot.control_dt, robot.joint_names).position_target
    min_range = amplitude if excitation.is_bounded else 1e-9
    away *= amplitude / np.maximum(min_range, np.abs(away).max(axis=0))
    return np.clip(robot.nominal_pose + away, robot.lower, robot.upper)


def simulated_log(
    robot: Robot, motors: Actuator, targets: np.ndarray, physics_dt: float
) -> MotorLog:
    """Log of the motors of a fixed or suspended robot, a row per physics step; velocities are differences of angles."""
    world = World(robot, physics_dt, suspended=robot.base == "free")
    played = replay(world, motors, targets, targets[0])
    every = round(robot.physics_dt / physics_dt)
    rows = slice(every - 1, None, every)
    substeps = round(robot.control_dt / robot.physics_dt)
    joint_pos = np.concatenate([targets[:1], played.joint_pos[rows][:-1]])
    log = MotorLog(
        time=robot.physics_dt * np.arange(len(joint_pos)),
        position_target=np.repeat(targets, substeps, axis=0),
        joint_pos=joint_pos,
        joint_vel=np.gradient(joint_pos, robot.physics_dt, axis=0),
        joint_names=robot.joint_names,
        robot=robot.name,
        motor=robot.motor,
        source=f"simulated {robot.name}",
    )
    return checked(log)
