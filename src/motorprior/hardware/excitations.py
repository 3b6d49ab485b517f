"""Motions that make the motors of a hung or standing robot show themselves, within an amplitude and a speed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from motorprior.bench import excitation
from motorprior.exceptions import ConfigError
from motorprior.hardware.settings import Excitation
from motorprior.locomotion.trajectory_generator import open_loop_trot
from motorprior.robots.pupper_v2 import spec

_SIGNALS: dict[str, excitation.Signal] = {
    "sine": excitation.sine,
    "chirp": excitation.chirp,
    "steps": excitation.held_steps,
    "multisine": excitation.multisine,
}
_FADE = 0.5
"""The amplitude grows from 0, and goes back to it, in this time [s]."""


def joints_of(name: str) -> tuple[int, ...]:
    """Indices of the joints that ``all``, a joint (FR_knee), a leg (FR) or a kind (knee) names.

    Raises:
        ConfigError: nothing is called so.
    """
    found = tuple(index for index, joint in enumerate(spec.JOINT_NAMES) if name == "all" or name in joint.split("_"))
    if name in spec.JOINT_NAMES:
        found = (spec.JOINT_NAMES.index(name),)
    if not found:
        known = f"all, {', '.join((*spec.LEGS, *spec.JOINTS_PER_LEG, spec.JOINT_NAMES[0]))}, ..."
        raise ConfigError(f"joint {name!r} is unknown", remedy=f"use one of {known}", argument="joint")
    return found


def excitation_targets(
    kind: Excitation,
    joints: Sequence[int],
    seconds: float,
    amplitude: float,
    speed: float,
    control_dt: float,
    seed: int,
) -> np.ndarray:
    """(steps, 12) targets [rad] about the nominal pose.

    Every joint gets a signal of its own, scaled to ``amplitude`` at its largest, and then down until no target is
    faster than ``speed``; `gait` is a trot of the whole robot, scaled likewise. Steps are the exception: a step has no
    speed, the gate slows it down to ``speed``.

    Args:
        kind: of the signal, see `bench.excitation`.
        joints: which joints move.
        seconds: duration [s].
        amplitude: largest distance from the nominal pose [rad].
        speed: fastest target [rad/s].
        control_dt: period of the targets [s].
        seed: of the random signals.

    Raises:
        ConfigError: it would move none of the joints: a trot has nothing for the abductions.
    """
    steps, rng = round(seconds / control_dt), np.random.default_rng([seed, spec.NUM_JOINTS])
    if kind == "gait":
        away = _trot(steps, control_dt)
    else:
        away = np.stack([_SIGNALS[kind](rng, steps, control_dt) for _ in spec.JOINT_NAMES], axis=1)
        away -= 0.5 * (away.max(axis=0) + away.min(axis=0))
    away[:, [joint for joint in range(spec.NUM_JOINTS) if joint not in joints]] = 0.0
    largest = float(np.abs(away).max())
    if largest == 0.0:
        names = ", ".join(spec.JOINT_NAMES[joint] for joint in joints)
        raise ConfigError(f"{kind} does not move {names}", remedy="choose another joint, or a sine", argument="joint")
    time = np.arange(steps) * control_dt
    fade = np.clip(np.minimum(time, time[-1] - time) / _FADE, 0.0, 1.0)[:, None]
    away *= amplitude / largest if kind == "gait" else _scale(away, amplitude)
    away *= fade
    if kind != "steps":
        fastest = np.abs(np.diff(away, axis=0)).max(axis=0) / control_dt
        away /= np.maximum(1.0, fastest / speed)
    return np.clip(spec.NOMINAL_POSE + away, spec.JOINT_LOWER, spec.JOINT_UPPER)


def _scale(away: np.ndarray, amplitude: float) -> np.ndarray:
    """Per joint, what brings its largest value to the amplitude."""
    return amplitude / np.maximum(1e-9, np.abs(away).max(axis=0))


def _trot(steps: int, control_dt: float) -> np.ndarray:
    """(steps, 12) distance from the nominal pose [rad] of a trot at 1.25 Hz and half intensity."""
    return open_loop_trot(steps, 1.25, 0.5, 0.25, 1.0, control_dt) - spec.NOMINAL_POSE
