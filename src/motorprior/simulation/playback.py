"""Replay of position targets on a simulated robot, recording the motion of every joint."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.kernels import without_refcounts
from motorprior.bounds import generator_of, require_array
from motorprior.compiled import njit
from motorprior.exceptions import SimulationFault
from motorprior.logs.motor_log import MotorLog, checked
from motorprior.robots.load import as_robot
from motorprior.robots.robot import Robot
from motorprior.simulation.motors import MotorSource, simulated_motors
from motorprior.simulation.physics import FAULTS, find_fault, physics_step, read_joints
from motorprior.simulation.world import World


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

    joints = targets.shape[1]
    row = 0
    for step in range(targets.shape[0]):
        read_joints(world, motors, measured[step])
        if base.shape[0] > 0:
            base[step] = world.qpos[:7]
        for _ in range(world.substeps):
            physics_step(world, motors, targets[step])
            joint_torque[row] = world.torque
            joint_pos[row] = world.qpos[world.qpos.shape[0] - joints :]
            row += 1


def replay(
    world: World,
    actuator: Actuator,
    targets: np.ndarray,
    start: np.ndarray | None = None,
    lead_in: np.ndarray | None = None,
    tolerate_fault: bool = False,
) -> Playback:
    """Reset the world, and hold each row of the targets for one control step.

    Args:
        world: the robot in MuJoCo.
        actuator: motors, one per joint.
        targets: (C, joints) position targets [rad].
        start: (joints,) angles at rest [rad]; the nominal pose if not given.
        lead_in: (L, joints) targets that are held before the recording begins [rad].
        tolerate_fault: return the recording of a diverged simulation, too.

    Raises:
        SimulationFault: the simulation diverged, unless ``tolerate_fault``.
    """
    played_targets = targets if lead_in is None else np.concatenate([lead_in, targets])
    played_targets = np.ascontiguousarray(played_targets, dtype=np.float64)
    steps, joints = played_targets.shape
    physics_steps = steps * world.substeps
    joint_pos = np.zeros((physics_steps, joints))
    joint_torque = np.zeros((physics_steps, joints))
    measured = np.zeros((steps, joints))
    base = np.zeros((0 if world.is_fixed else steps, 7))

    simulation = world.reset(actuator, start)
    _play(
        simulation.arrays,
        simulation.motors,
        played_targets,
        joint_pos,
        joint_torque,
        measured,
        base,
    )
    fault = find_fault(simulation.arrays)
    if fault and not tolerate_fault:
        raise SimulationFault(FAULTS[fault], remedy="shorten physics_dt or check the motors' gains")

    first_step = steps - len(targets)
    first_row = first_step * world.substeps
    return Playback(
        joint_pos[first_row:],
        joint_torque[first_row:],
        measured[first_step:],
        base[first_step:],
    )


def simulate(
    robot: Robot | str | Path,
    motors: MotorSource,
    targets: np.ndarray,
    *,
    seed: int | np.random.Generator = 0,
    suspended: bool = False,
) -> Playback:
    """Simulate a robot that starts at rest in its nominal pose.

    Args:
        robot: a name, the path of a .toml file, or the result of `load_robot`; with legs or
            without.
        motors: one per joint, or a prior, posterior or fleet to sample.
        targets: (C, joints) position targets [rad], in the order of ``robot.joint_names``; each row
            lasts one control step.
        seed: seed of the sample of motors.
        suspended: suspend a free base in the air.

    Raises:
        ConfigError, ArtifactError: motors or targets that do not fit the robot, or a robot that
            cannot be read.
        SimulationFault: NaN, a reset or a full buffer of the engine.
    """
    robot = as_robot(robot)
    source = simulated_motors(motors, robot)
    targets = require_array("targets", targets, (len(targets), robot.num_joints))
    world = World(robot, source.physics_dt, suspended)
    actuator = source.draw(generator_of(seed))
    return replay(world, actuator, targets)


def simulated_log(
    robot: Robot, motors: Actuator, targets: np.ndarray, physics_dt: float
) -> MotorLog:
    """Log of the motors of a fixed or suspended robot; velocities are differences of angles.

    The rows are the robot's physics steps; ``physics_dt`` is the step of the simulation [s], which
    divides the robot's.
    """
    world = World(robot, physics_dt, suspended=robot.base == "free")
    played = replay(world, motors, targets, targets[0])

    # angles at the beginning of each of the robot's physics steps
    stride = round(robot.physics_dt / physics_dt)
    after_steps = played.joint_pos[stride - 1 :: stride]
    joint_pos = np.concatenate([targets[:1], after_steps[:-1]])

    substeps = round(robot.control_dt / robot.physics_dt)
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
