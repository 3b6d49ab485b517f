"""Excitation of the motors of a hung or standing robot, within an amplitude and a speed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from motorprior.bench import excitation
from motorprior.exceptions import ConfigError
from motorprior.hardware.settings import Excitation
from motorprior.locomotion.body import body_of
from motorprior.locomotion.trajectory_generator import open_loop_gait
from motorprior.robots.robot import Robot

_SIGNALS: dict[str, excitation.Signal] = {
    "sine": excitation.sine,
    "chirp": excitation.chirp,
    "steps": excitation.held_steps,
    "multisine": excitation.multisine,
}
_SLOW = 0.5
"""Frequency and speed of the gait, as shares of the robot's usual frequency and highest speed [-]."""
_FADE = 0.5
"""The amplitude grows from 0, and goes back to it, in this time [s]."""


def joints_of(robot: Robot, name: str) -> tuple[int, ...]:
    """Indices of the joints named by ``all``, a joint (FR_knee), or a part of joints' names: a leg (FR), a kind (knee).

    Raises:
        ConfigError: no joint has that name.
    """
    names = robot.joint_names
    if name in names:
        return (names.index(name),)
    found = tuple(index for index, joint in enumerate(names) if name == "all" or name in joint.split("_"))
    if not found:
        parts = dict.fromkeys(part for joint in names for part in joint.split("_"))
        known = f"all, {', '.join((*parts, names[0]))}, ..."
        raise ConfigError(f"joint {name!r} is unknown", remedy=f"use one of {known}", argument="joint")
    return found


def excitation_targets(
    robot: Robot,
    kind: Excitation,
    joints: Sequence[int],
    seconds: float,
    amplitude: float,
    speed: float,
    seed: int,
) -> np.ndarray:
    """(steps, joints) targets [rad] about the nominal pose.

    Every joint gets a signal of its own, scaled to ``amplitude`` at its largest, and then down until no target is
    faster than ``speed``; `gait` is a trot of the whole robot, scaled likewise. Steps are the exception: a step has no
    speed, the gate slows it down to ``speed``. Half of
    `varied` is a multisine, the other half steps of one joint after the other.

    Args:
        robot: whose nominal pose, limits and control period hold.
        kind: of the signal, see `bench.excitation`.
        joints: which joints move.
        seconds: duration [s].
        amplitude: largest distance from the nominal pose [rad].
        speed: fastest target [rad/s].
        seed: of the random signals.

    Raises:
        ConfigError: it would move none of the joints: a trot does not move the abductions; or a trot without legs.
    """
    steps, rng = round(seconds / robot.control_dt), np.random.default_rng([seed, robot.num_joints])
    if kind == "varied":
        together = _away(robot, "multisine", joints, steps // 2, amplitude, speed, rng)
        alone = _away(robot, "steps", joints, steps - steps // 2, amplitude, speed, rng)
        away = np.concatenate([together, _one_after_the_other(alone, joints)])
    else:
        away = _away(robot, kind, joints, steps, amplitude, speed, rng)
    return np.clip(robot.nominal_pose + away, robot.lower, robot.upper)


def _one_after_the_other(away: np.ndarray, joints: Sequence[int]) -> np.ndarray:
    """The same targets (steps, joints), but each of these joints moves in its own share of the time only.

    The load of a joint comes from the motion of all, and where all of them jump, it is known so badly that gears seem
    better damped than they are.
    """
    alone, bounds = np.zeros_like(away), np.linspace(0, len(away), len(joints) + 1).astype(int)
    for joint, first, end in zip(joints, bounds[:-1], bounds[1:], strict=True):
        alone[first:end, joint] = away[first:end, joint]
    return alone


def _away(
    robot: Robot,
    kind: Excitation,
    joints: Sequence[int],
    steps: int,
    amplitude: float,
    speed: float,
    rng: np.random.Generator,
) -> np.ndarray:
    """(steps, joints) distance of the targets from the nominal pose, 0 at both ends [rad]."""
    control_dt, names, nominal = robot.control_dt, robot.joint_names, robot.nominal_pose
    if kind == "gait":
        body = body_of(robot)
        forward, frequency = _SLOW * body.fastest, _SLOW * body.frequency
        away = open_loop_gait(body, steps, forward, frequency, 0.0, body.swing_stance_ratio, control_dt) - nominal
    else:
        away = np.stack([_SIGNALS[kind](rng, steps, control_dt) for _ in names], axis=1)
        away -= 0.5 * (away.max(axis=0) + away.min(axis=0))
    away[:, [joint for joint in range(robot.num_joints) if joint not in joints]] = 0.0
    if not away.any():
        still = ", ".join(names[joint] for joint in joints)
        raise ConfigError(f"{kind} does not move {still}", remedy="choose another joint, or a sine", argument="joint")
    time = np.arange(steps) * control_dt
    fade = np.clip(np.minimum(time, time[-1] - time) / _FADE, 0.0, 1.0)[:, None]
    over = None if kind == "gait" else 0  # a gait keeps its shape; other signals are each joint's own
    away *= amplitude / np.maximum(1e-9, np.abs(away).max(axis=over))
    away *= fade
    if kind != "steps":
        fastest = np.abs(np.diff(away, axis=0)).max(axis=over) / control_dt
        away /= np.maximum(1.0, fastest / speed)
    return away
