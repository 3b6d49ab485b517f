"""Excite the motors of a suspended or standing robot: the targets, and the run that plays them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from motorprior.bench.excitation import excitation_named
from motorprior.exceptions import ConfigError
from motorprior.hardware.control_loop import ControlLoop
from motorprior.hardware.health import Measurement
from motorprior.hardware.session import Session
from motorprior.locomotion.body import body_of, open_loop_gait
from motorprior.logs.readers.robot_run import Mode
from motorprior.robots.robot import Robot

OF_ROBOTS = ("varied", "trot")  # excitations of a whole robot
_SLOW = 0.5  # frequency and speed of the gait, relative to the robot's usual frequency and maximum speed
_FADE = 0.5  # [s] in which the amplitude grows from 0 and returns to it
_STATUS_PERIOD = 500  # control steps


def joints_of(robot: Robot, name: str) -> tuple[int, ...]:
    """Indices of all joints (``all``), of one (FR_knee), or of a leg or kind of joint (FR, knee)."""
    names = robot.joint_names
    if name in names:
        return (names.index(name),)
    indices = tuple(index for index, joint in enumerate(names) if name == "all" or name in joint.split("_"))
    if not indices:
        parts = dict.fromkeys(part for joint in names for part in joint.split("_"))
        valid = f"all, {', '.join((*parts, names[0]))}, ..."
        raise ConfigError(f"joint {name!r} is unknown", remedy=f"use one of {valid}", argument="joint")
    return indices


def excitation_targets(
    robot: Robot, kind: str, joints: Sequence[int], seconds: float, amplitude: float, speed: float, seed: int
) -> np.ndarray:
    """(steps, joints) targets [rad] about the nominal pose, for ``seconds`` [s].

    Every joint gets a signal of its own (`bench.excitation`), scaled to ``amplitude`` [rad] and then down to ``speed``
    [rad/s]; ``trot`` is of the whole robot, scaled as one. Steps are not scaled to the speed: the safety gate limits
    their slew rate. ``varied`` is a multisine of all joints, and then steps of one joint after the other.

    Raises:
        ConfigError: an unknown excitation, one that moves none of the joints, or a trot without legs.
    """
    steps, rng = round(seconds / robot.control_dt), np.random.default_rng([seed, robot.num_joints])
    parts = [("multisine", steps // 2), ("steps", steps - steps // 2)] if kind == "varied" else [(kind, steps)]
    signals = [(part, _signals(robot, part, joints, num, rng)) for part, num in parts]
    away = np.concatenate([_scaled(signal, part, amplitude, speed, robot.control_dt) for part, signal in signals])
    if kind == "varied":
        # A joint's load depends on the motion of all. If all jump at once, its estimate is so poor that gears seem
        # better damped than they are.
        bounds = steps // 2 + np.linspace(0, steps - steps // 2, len(joints) + 1).astype(int)
        for joint, first, end in zip(joints, bounds[:-1], bounds[1:], strict=True):
            away[steps // 2 : first, joint] = away[end:, joint] = 0.0
    return np.clip(robot.nominal_pose + away, robot.lower, robot.upper)


def _signals(robot: Robot, kind: str, joints: Sequence[int], steps: int, rng: np.random.Generator) -> np.ndarray:
    """(steps, joints) differences between the targets and the nominal pose [rad]; 0 for all other joints."""
    if kind == "trot":
        body = body_of(robot)
        forward, frequency = _SLOW * body.max_speed, _SLOW * body.frequency
        gait = open_loop_gait(body, steps, forward, frequency, 0.0, body.swing_stance_ratio, robot.control_dt)
        away = gait - robot.nominal_pose
    else:
        signal = excitation_named(kind, OF_ROBOTS).target
        away = np.stack([signal(rng, steps, robot.control_dt) for _ in robot.joints], axis=1)
        away -= 0.5 * (away.max(axis=0) + away.min(axis=0))
    away[:, [joint for joint in range(robot.num_joints) if joint not in joints]] = 0.0
    if not away.any():
        names = ", ".join(robot.joint_names[joint] for joint in joints)
        raise ConfigError(f"{kind} does not move {names}", remedy="choose another joint, or a sine", argument="joint")
    return away


def _scaled(away: np.ndarray, kind: str, amplitude: float, speed: float, control_dt: float) -> np.ndarray:
    """The same motion within amplitude and speed, faded in from 0 and out to it."""
    time = np.arange(len(away)) * control_dt
    fade = np.clip(np.minimum(time, time[-1] - time) / _FADE, 0.0, 1.0)[:, None]
    over = None if kind == "trot" else 0  # a trot keeps its shape; other signals are scaled joint by joint
    away *= amplitude / np.maximum(1e-9, np.abs(away).max(axis=over))
    away *= fade
    if kind == "trot" or not excitation_named(kind).jumps:
        fastest = np.abs(np.diff(away, axis=0)).max(axis=over) / control_dt
        away /= np.maximum(1.0, fastest / speed)
    return away


def excite(session: Session, targets: np.ndarray, suspended: bool) -> None:
    """Check, arm, ramp to the nominal pose, play the targets (steps, joints) [rad], and remove the current.

    A ``suspended`` robot does not crouch at the end. The status is a line every five seconds. Raises as `deploy.walk`.
    """
    session.check()
    period, rows = session.link.robot.control_dt, iter(targets)

    def show(count: int, _: Measurement) -> None:
        if count % _STATUS_PERIOD == 0:
            session.status(f"{count * period:6.1f} of {len(targets) * period:g} s recorded")

    def work(loop: ControlLoop) -> None:
        loop.play(lambda _: next(rows, None), Mode.EXCITE, show, session.timing)

    session.run(work, crouch=not suspended)
