"""Position targets of a whole robot that excite its joints about the nominal pose."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from motorprior.bounds import require_number, require_seed
from motorprior.exceptions import ConfigError
from motorprior.excitation.excitation import Rng, StreamSource
from motorprior.excitation.recording import MotionSettings
from motorprior.excitation.registry import EXCITATIONS, excitation_of
from motorprior.locomotion.gait import open_loop_gait, walker_arrays
from motorprior.robots.joint_classes import position_classes
from motorprior.robots.robot import Robot

VARIED = "varied"
OF_ROBOTS = (VARIED, "trot")  # excitations of a whole robot
# frequency and speed of the trot, relative to the robot's usual frequency and maximum speed
_SLOW = 0.5
_FADE = 0.5  # [s] in which the amplitude grows from 0 and returns to it
_MIN_RANGE = 1e-9  # [rad], of a joint that does not move
# default limits of the targets' speed [rad/s], see `MotionSettings.max_speed`
_FAST_TARGETS = 40.0
_SLOW_TARGETS = 8.0
# default amplitudes [rad]; small on the ground, where feet that push into it look blocked
_STANDING_AMPLITUDE = 0.1
_SUSPENDED_AMPLITUDE = 0.4
_STREAM = 0x51E7  # tag of the random stream of `excitation_targets`, not that of the motors


def joints_of(robot: Robot, name: str) -> tuple[int, ...]:
    """Indices of all joints (``all``), of one (FR_knee), of a leg (FR) or of a class (knee).

    Raises ConfigError for a name that fits no joint.
    """
    if name == "all":
        return tuple(range(robot.num_joints))
    for leg in robot.legs:
        if leg.name == name:
            return leg.joints

    classes = position_classes(robot.joint_names, robot.given_classes)
    indices = tuple(
        index
        for index, (joint, joint_class) in enumerate(zip(robot.joint_names, classes, strict=True))
        if name in (joint, joint_class)
    )
    if not indices:
        legs = [leg.name for leg in robot.legs]
        names = ", ".join(dict.fromkeys(("all", *legs, *classes, robot.joint_names[0])))
        raise ConfigError(
            f"joint {name!r} is unknown", remedy=f"use one of {names}, ...", argument="joint"
        )
    return indices


class RobotMotion(NamedTuple):
    """Targets that a real robot plays, and what they are made of."""

    targets: np.ndarray  # (control steps, joints) [rad]
    excitation: str  # its name or file
    amplitude: float  # maximum distance from the nominal pose [rad]
    max_speed: float  # limit of the targets' speed [rad/s]


def recorded_motion(robot: Robot, settings: MotionSettings) -> RobotMotion:
    """The motion of a recording, with the defaults of the robot's posture.

    Raises ConfigError for a setting out of range or a robot without a wire, or as
    `hardware_targets`.
    """
    max_target_speed = robot.require_wire().safety.target_speed

    # steps of a leg that carries weight would tip a standing robot
    excitation = settings.excitation or ("multisine" if settings.standing else VARIED)

    amplitude = settings.amplitude
    if amplitude is None:
        amplitude = _STANDING_AMPLITUDE if settings.standing else _SUSPENDED_AMPLITUDE

    max_speed = settings.max_speed
    if max_speed is None:
        # steps in the air must be fast, to reach a motor's torque limit
        has_fast_steps = _has_steps(excitation) and not settings.standing
        usual_speed = _FAST_TARGETS if has_fast_steps else _SLOW_TARGETS
        max_speed = min(max_target_speed, usual_speed)

    require_number("seconds", settings.seconds, 1.0, 3600.0)
    require_number("amplitude", amplitude, 0.0, 1.5, positive=True)
    require_number("max_speed", max_speed, 0.0, max_target_speed, positive=True)
    require_seed(settings.seed)

    joints = joints_of(robot, settings.joint)
    targets = hardware_targets(
        robot, excitation, joints, settings.seconds, amplitude, max_speed, settings.seed
    )
    return RobotMotion(targets, excitation, amplitude, max_speed)


def _has_steps(excitation: str) -> bool:
    """Whether targets of this excitation change faster than any limit of their speed."""
    if excitation in EXCITATIONS:
        return EXCITATIONS[excitation].jumps
    return excitation == VARIED


def excitation_targets(
    robot: Robot, name: str, seconds: float, amplitude: float, seed: int
) -> np.ndarray:
    """(control steps, joints) targets [rad] for a simulated robot.

    Every joint has its own signal, scaled to ``amplitude`` [rad]. Errors as `excitation_of`.
    """
    excitation = excitation_of(name)
    rng = np.random.default_rng([seed, _STREAM])
    steps = max(2, round(seconds / robot.control_dt))
    away = _streamed_targets(excitation, robot, rng, steps)

    away *= _scale(away, amplitude, excitation, 0)
    return np.clip(robot.nominal_pose + away, robot.lower, robot.upper)


def hardware_targets(
    robot: Robot,
    name: str,
    joints: Sequence[int],
    seconds: float,
    amplitude: float,
    speed: float,
    seed: int,
) -> np.ndarray:
    """(control steps, joints) targets [rad] that a real robot can play.

    Every joint gets its own signal, scaled to ``amplitude`` [rad] and then down to ``speed``
    [rad/s]. Steps are not scaled to the speed: the safety gate limits their slew rate.

    Args:
        robot: for its joints, nominal pose and control period.
        name: of EXCITATIONS, or the file of a learned excitation. ``trot`` is of the whole robot
            and scaled as one. ``varied`` is a multisine of all joints, and then steps of one joint
            after the other.
        joints: indices of the joints to move.
        seconds: duration [s].
        amplitude: maximum distance from the nominal pose [rad].
        speed: maximum speed of the targets [rad/s].
        seed: of the random signals.

    Raises:
        ConfigError: an unknown excitation, one that moves none of the joints, or a trot of a robot
            without legs.
    """
    steps = round(seconds / robot.control_dt)
    rng = np.random.default_rng([seed, robot.num_joints])
    if name == VARIED:
        smooth_steps = steps // 2
        multisine = _away(robot, "multisine", joints, smooth_steps, amplitude, speed, rng)
        jumps = _away(robot, "steps", joints, steps - smooth_steps, amplitude, speed, rng)
        away = np.concatenate([multisine, _one_after_the_other(jumps, joints)])
    else:
        away = _away(robot, name, joints, steps, amplitude, speed, rng)
    return np.clip(robot.nominal_pose + away, robot.lower, robot.upper)


def _one_after_the_other(away: np.ndarray, joints: Sequence[int]) -> np.ndarray:
    """The signals (steps, joints), of one joint at a time; 0 for the others.

    A joint's load depends on the motion of all. If all jump at once, gears seem better damped than
    they are.
    """
    away = away.copy()
    ends = np.linspace(0, len(away), len(joints) + 1).astype(int)
    for joint, first, end in zip(joints, ends[:-1], ends[1:], strict=True):
        away[:first, joint] = 0.0
        away[end:, joint] = 0.0
    return away


def _away(
    robot: Robot,
    name: str,
    joints: Sequence[int],
    steps: int,
    amplitude: float,
    speed: float,
    rng: Rng,
) -> np.ndarray:
    """(steps, joints) distances of the targets from the nominal pose [rad], scaled and faded.

    They are 0 for joints that are not in ``joints``.
    """
    excitation = None if name == "trot" else excitation_of(name, OF_ROBOTS)
    if excitation is None:
        away = _trot(robot, steps)
    else:
        away = _streamed_targets(excitation, robot, rng, steps)
        away -= 0.5 * (away.max(axis=0) + away.min(axis=0))
    not_moved = [joint for joint in range(robot.num_joints) if joint not in joints]
    away[:, not_moved] = 0.0
    if not away.any():
        names = ", ".join(robot.joint_names[joint] for joint in joints)
        raise ConfigError(
            f"{name} does not move {names}",
            remedy="choose another joint, or a sine",
            argument="joint",
        )

    # Signals are scaled joint by joint; a trot keeps its shape.
    axis = None if excitation is None else 0
    away *= _scale(away, amplitude, excitation, axis)
    if excitation is not None:
        away = excitation.within(away, amplitude, speed, robot.control_dt)

    time = np.arange(steps) * robot.control_dt
    away *= np.clip(np.minimum(time, time[-1] - time) / _FADE, 0.0, 1.0)[:, None]
    if excitation is None or not excitation.jumps:
        fastest = np.abs(np.diff(away, axis=0)).max(axis=axis) / robot.control_dt
        away /= np.maximum(1.0, fastest / speed)
    return away


def _scale(
    away: np.ndarray, amplitude: float, excitation: StreamSource | None, axis: int | None
) -> np.ndarray:
    """Factor of distances (steps, joints) that brings their maximum along an axis to the amplitude.

    Distances of a bounded excitation are only reduced.
    """
    is_bounded = excitation is not None and excitation.is_bounded
    min_range = amplitude if is_bounded else _MIN_RANGE
    return amplitude / np.maximum(min_range, np.abs(away).max(axis=axis))


def _streamed_targets(excitation: StreamSource, robot: Robot, rng: Rng, steps: int) -> np.ndarray:
    """(steps, joints) targets of an excitation [rad]; a learned one plays each joint's position."""
    classes = position_classes(robot.joint_names, robot.given_classes)
    return excitation.streams(rng, steps, robot.control_dt, classes).position_target


def _trot(robot: Robot, steps: int) -> np.ndarray:
    """(steps, joints) distances of a slow trot from the nominal pose [rad]."""
    walker = walker_arrays(robot)
    forward = _SLOW * walker.max_speed
    frequency = _SLOW * walker.frequency
    return open_loop_gait(walker, steps, forward, frequency, 0.0, 1.0) - robot.nominal_pose
