"""An unknown load, fitted together with its motor: a rigid body on the joint, on a base that stands still.

    load_inertia = J,   external_torque = -(s·sin q + c·cos q),   load_stiffness = -(s·cos q - c·sin q)

with the joint's angle q. Free runs of the grey box have three latents more per motor than constants, ln(J/J₀), s/g and
c/g, around a regression of the stated proportional law,

    kp·(position_target - q) = J₀·q̈ + s₀·sin q + c₀·cos q + d·q̇ + f·sign q̇.

A log of angles and commands says nothing about how large a torque is, so the gains have to be stated in N·m/rad. Nor
does it tell the inertia of a load from the armature of a rotor without play: their sum is found, and what is believed
of the two beforehand divides it. The deviations say so. They are Laplace's, and count the whole log as one
observation: what is left of its errors is mostly what the model lacks, which is alike in every window.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from motorprior.actuator.geared_motor_constants import PARAMETERS
from motorprior.actuator.latent import LatentNetwork
from motorprior.exceptions import LogError
from motorprior.identification.fleet_fit import held_constants
from motorprior.identification.grey_box_fit import inverse_precision
from motorprior.identification.initial_motor import initial_center, with_motor
from motorprior.identification.loss import POSITION_SCALE
from motorprior.identification.motor_fit import NARROW, WIDE, Belief, Fit, MotorFit
from motorprior.identification.presets import PRESETS, Preset
from motorprior.identification.residual import without_residual
from motorprior.identification.window_runs import Segment, WindowRuns
from motorprior.identification.windows import (
    EXTERNAL,
    INERTIA,
    POS,
    STIFFNESS,
    TARGET,
    VEL,
    that_fits,
    training_data,
)
from motorprior.logs.motor_log import PHYSICAL_GAINS, POSTURES, MotorLog, stated_gains_of
from motorprior.logs.validity import checked

RECIPE = "pace_long_runs"
"""Preset of the free runs: a second long, no term of a servo's firmware."""
LOAD = ("inertia", "sine", "cosine")
"""Of a joint [kg·m²], [N·m], [N·m]."""
ROUNDS = 16
"""Most rounds of a fit."""
_SEARCH, _DRAWS, _AWAY, _STEPS = (1.0, 0.5, 0.25), 96, 0.35, 8
_QUIET, _LITTLE = 3, 0.01
"""Rounds in a row, each of which lowers no joint's loss by a larger share, that end a fit."""
_DEVIATIONS = 1.0, 2.0, 1.0
"""Believed of a constant's logarithm, of ln(J/J₀), and of s/g and c/g."""
_SAG = 0.2
"""g, over kp [rad]."""
_LANES = 32
"""Loads that are simulated at a time; every one has rows of its own."""
_HOPED = 0.01
"""Loss after a fit, over that before."""
_STREAM = 61


@dataclass(frozen=True)
class FittedLoads:
    """Loads of M joints.

    Attributes:
        inertia: (M,) J [kg·m²].
        inertia_deviation: (M,) standard deviation of ln J [-].
        gravity: (M, 2) s and c [N·m].
        gravity_deviation: (M, 2) their standard deviations [N·m].
        error: (M,) root mean square error of position that is left [rad].
    """

    inertia: np.ndarray
    inertia_deviation: np.ndarray
    gravity: np.ndarray
    gravity_deviation: np.ndarray
    error: np.ndarray


class _LoadedRuns(WindowRuns):
    """Free runs in which the last three latents are the load's."""

    def __init__(self, data, preset: Preset, inertia: np.ndarray, unit: np.ndarray):
        super().__init__(data, preset)
        self._inertia, self._unit = inertia, unit

    def loads(self, z: np.ndarray, motor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(L,) inertia [kg·m²] and (2, L) s and c [N·m] of latents z (L, Z)."""
        return self._inertia[motor] * np.exp(z[:, -3]), self._unit[motor] * z[:, -2:].T

    def _run(self, network: LatentNetwork, z: np.ndarray, motor: np.ndarray, segment: Segment, out: np.ndarray) -> None:
        for first in range(0, len(motor), _LANES):
            some = slice(first, first + _LANES)
            inertia, gravity = self.loads(z[some], motor[some])
            rows = _loaded(segment.rows[:, :, motor[some]], inertia, gravity)
            lanes = np.arange(rows.shape[2])
            super()._run(network, z[some, :-3], lanes, Segment(rows, segment.windows), out[some])


def _loaded(rows: np.ndarray, inertia: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    """(steps, channels of `windows`, lanes) rows, a copy, that carry other loads: (lanes,) and (2, lanes)."""
    torque, stiffness = _pull(rows[:, POS], gravity)
    rows[:, INERTIA], rows[:, STIFFNESS] = inertia, stiffness
    rows[:, EXTERNAL] = torque - stiffness * rows[:, POS]
    return rows


def _pull(angle: np.ndarray, gravity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Torque of a weight [N·m] and its change with the joint's angle [N·m/rad] at angles (T, M), by s and c (2, M)."""
    sine, cosine = gravity
    swing, hold = np.sin(angle), np.cos(angle)
    return -(sine * swing + cosine * hold), -(sine * hold - cosine * swing)


def fit_loads(log: MotorLog, report: Callable[[], None] = lambda: None) -> FittedLoads:
    """Fit the load of every joint of a log, each by itself.

    Args:
        log: without loads, at the period of RECIPE, with gains stated in N·m/rad.
        report: called after every round, of which there are ROUNDS at most.

    Raises:
        LogError: without such gains, at another period, or too short for a window.
    """
    if log.stated_kp is None or log.gain_unit != PHYSICAL_GAINS:
        raise LogError(
            f"no stated kp in {PHYSICAL_GAINS}: nothing in it says how large a torque is, nor then an inertia",
            where=log.source, remedy="state kp, and kd if you know it, or import the log with its load",
        )  # fmt: skip
    nothing = np.zeros_like(log.joint_pos)
    bare = replace(log, load_inertia=np.ones_like(nothing), external_torque=nothing, load_stiffness=None)
    preset = replace(that_fits(PRESETS[RECIPE], log), gain_unit=PHYSICAL_GAINS)
    data = training_data(bare, preset, log.source)
    kp = cast(np.ndarray, stated_gains_of(log))[0]
    start = _regression(WindowRuns(data, preset), kp)
    runs = _LoadedRuns(data, preset, start[:, 0], _SAG * kp)
    center = initial_center((), runs)
    fit = MotorFit(with_motor(without_residual(data.scales, preset), center, ()), runs)
    belief, held = _belief(start, _SAG * kp), np.append(held_constants((), runs), [False] * len(LOAD))
    found = _search(fit, belief, held, report)
    return _finished(fit, found, belief, held)


def _regression(runs: WindowRuns, kp: np.ndarray) -> np.ndarray:
    """(M, 3) J₀, s₀, c₀ of the stated proportional law on all rows."""
    rows = np.concatenate([segment.rows for segment in runs.segments])
    acceleration = np.concatenate([np.gradient(segment.rows[:, VEL], axis=0) for segment in runs.segments])
    acceleration /= runs.preset.period
    found = []
    for joint, gain in enumerate(kp):
        target, angle, speed = (rows[:, channel, joint] for channel in (TARGET, POS, VEL))
        known = np.stack([acceleration[:, joint], np.sin(angle), np.cos(angle), speed, np.sign(speed)], axis=1)
        found.append(np.linalg.lstsq(known, gain * (target - angle), rcond=None)[0][:3])
    values = np.stack(found)
    least = 1e-5 * kp
    values[:, 0] = np.clip(values[:, 0], least, 1e4 * least)
    return values


def _belief(start: np.ndarray, unit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean (M, Z) and deviation (Z,): half of the regression's inertia is the load's."""
    of_constant, of_inertia, of_gravity = _DEVIATIONS
    mean = np.zeros((len(start), len(PARAMETERS) + len(LOAD)))
    mean[:, -3], mean[:, -2:] = np.log(0.5), start[:, 1:] / unit[:, None]
    return mean, np.array([of_constant] * len(PARAMETERS) + [of_inertia, of_gravity, of_gravity])


def _weighed(fit: MotorFit, belief: tuple[np.ndarray, np.ndarray], held: np.ndarray, loss: np.ndarray) -> Belief:
    """The belief beside a mean loss (M,) at which a window counts as one observation."""
    mean, deviation = belief
    return Belief(mean, loss[:, None] / fit.windows / deviation**2).holding(held)


def _search(fit: MotorFit, belief: tuple[np.ndarray, np.ndarray], held: np.ndarray, report: Callable[[], None]) -> Fit:
    """A random search around what is believed, then rounds of Gauss-Newton steps from the best and from others."""
    rng, quiet = np.random.default_rng(_STREAM), 0
    start = np.where(held, 0.0, belief[0])
    weighed = _weighed(fit, belief, held, _HOPED * fit.losses(start))
    found = fit.polish(fit.search(rng, start, weighed, _SEARCH, _DRAWS), weighed, _STEPS, WIDE)
    for round_ in range(ROUNDS):
        reach, before = NARROW if round_ % 2 else WIDE, found.loss
        weighed = _weighed(fit, belief, held, found.loss)
        found = replace(found, energy=found.loss + weighed.energy(found.z))
        drawn = rng.random((len(start), _DRAWS, start.shape[1])) < 0.5
        anew = found.z[:, None] + _AWAY * rng.standard_normal(drawn.shape)
        other = fit.best_of(np.where(drawn & ~held, anew, found.z[:, None]), weighed)
        again = fit.polish(found.z, weighed, _STEPS, reach)
        found = again.better(fit.polish(other, weighed, _STEPS, reach))
        report()
        quiet = quiet + 1 if np.all(found.loss > (1.0 - _LITTLE) * before) else 0
        if quiet == _QUIET:
            break
    return found


def _finished(fit: MotorFit, found: Fit, belief: tuple[np.ndarray, np.ndarray], held: np.ndarray) -> FittedLoads:
    runs = cast(_LoadedRuns, fit.runs)
    deviation = np.where(held, 1e-6, belief[1])
    curvature = fit.curvatures(found.z, WIDE) / found.loss[:, None, None]
    scaled = curvature * deviation * deviation[:, None]
    spread = deviation * np.sqrt(np.diagonal(inverse_precision(scaled, np.ones(len(found.z))), axis1=1, axis2=2))
    everyone = np.arange(len(found.z))
    inertia, gravity = runs.loads(found.z, everyone)
    scaled_errors = runs.residuals(fit.network, found.z, everyone)[:, :, 0]
    error = POSITION_SCALE * np.sqrt(np.mean(np.square(scaled_errors, dtype=np.float64), axis=(1, 2)))
    unit = runs.loads(np.ones_like(found.z), everyone)[1].T
    return FittedLoads(inertia, spread[:, -3], gravity.T, unit * spread[:, -2:], error)


def with_fitted_loads(log: MotorLog, loads: FittedLoads) -> MotorLog:
    """The log with these loads in place of a torque computed from currents; its base stood still."""
    torque, stiffness = _pull(log.joint_pos, loads.gravity.T)
    for part in log.segment_slices():
        torque[part][:-1] = 0.5 * (torque[part][:-1] + torque[part][1:])  # a log's are means until the next row
    channels = {
        "load_inertia": np.broadcast_to(loads.inertia, torque.shape).copy(), "external_torque": torque,
        "load_stiffness": stiffness, "posture": np.full(log.num_rows, POSTURES.index("fixed")),
    }  # fmt: skip
    return checked(replace(log, **channels, joint_torque=None), where=log.source)
