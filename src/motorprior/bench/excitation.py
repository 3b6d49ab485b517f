"""Excitations for a bench, a simulated robot or a real robot. To add one, add an entry to EXCITATIONS.

Each function returns (steps,) targets [rad], or torques [N·m] where stated.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, NamedTuple, TypeAlias

import numpy as np

from motorprior.exceptions import ConfigError

Rng: TypeAlias = np.random.Generator
# (generator, steps, sample period [s]) -> (steps,) signal
Signal = Callable[[Rng, int, float], np.ndarray]


class Streams(NamedTuple):
    """Commands and loads of n joints."""

    position_target: np.ndarray  # (steps, n) [rad]
    external_torque: np.ndarray  # (steps, n) on the joints, on a bench [N·m]
    load_inertia: np.ndarray | None = None  # (n,) on a bench [kg·m²]; None: the bench's own choice


@dataclass(frozen=True)
class Excitation:
    """Excitation of a motor."""

    target: Signal  # position targets [rad]
    # acts on the joint, in units that `streams` gets; 0 if None
    external_torque: Signal | None = None
    jumps: bool = False  # whether targets change faster than any speed limit
    # whether targets have a fixed amplitude, which a robot may only reduce
    is_bounded: ClassVar[bool] = False

    def streams(
        self, rng: Rng, steps: int, dt: float, joint_names: Sequence[str], unit: float = 1.0
    ) -> Streams:
        """Streams of joints, sampled every ``dt`` [s]; ``unit`` of external torques [N·m]."""
        targets = np.stack([self.target(rng, steps, dt) for _ in joint_names], axis=1)
        if self.external_torque is None:
            return Streams(targets, np.zeros_like(targets))
        torques = [self.external_torque(rng, steps, dt) for _ in joint_names]
        return Streams(targets, unit * np.stack(torques, axis=1))


def _knots(rng: np.random.Generator, duration: float, low: float, high: float) -> list[float]:
    """Times from 0 to beyond ``duration``, with random intervals between ``low`` and ``high`` [s]."""
    knots = [0.0]
    while knots[-1] < duration:
        knots.append(knots[-1] + rng.uniform(low, high))
    return knots


def _wandering(
    rng: np.random.Generator, steps: int, dt: float, low: float, high: float
) -> np.ndarray:
    """A positive signal, log-linear between random levels 0.5-1.5 s apart."""
    knots = _knots(rng, steps * dt, 0.5, 1.5)
    levels = rng.uniform(np.log(low), np.log(high), len(knots))
    return np.exp(np.interp(np.arange(steps) * dt, knots, levels))


def sine(rng: np.random.Generator, steps: int, dt: float) -> np.ndarray:
    """The paper's excitation: center + amplitude(t)·sin(2π∫frequency dt), 0.3-6 Hz, 0.05-0.6 rad."""
    frequency = _wandering(rng, steps, dt, 0.3, 6.0)
    amplitude = np.minimum(_wandering(rng, steps, dt, 0.05, 0.6), 1.2 / frequency)
    phase = rng.uniform(0, 2 * np.pi) + 2 * np.pi * np.cumsum(frequency) * dt
    return rng.uniform(-0.3, 0.3) + amplitude * np.sin(phase)


def held_steps(rng: np.random.Generator, steps: int, dt: float) -> np.ndarray:
    """Levels within ±0.6 rad, each held for 0.08-0.5 s."""
    targets = np.empty(steps)
    filled = 0
    while filled < steps:
        length = int(rng.uniform(0.08, 0.5) / dt)
        targets[filled : filled + length] = rng.uniform(-0.6, 0.6)
        filled += length
    return targets


def gait(rng: np.random.Generator, steps: int, dt: float) -> np.ndarray:
    """Periodic motion of a leg joint: 0.8-2.5 Hz, three harmonics, nearly static in part of the cycle."""
    frequency = rng.uniform(0.8, 2.5)
    warp = rng.uniform(-0.8, 0.8)
    angle = 2 * np.pi * frequency * np.arange(steps) * dt + rng.uniform(0, 2 * np.pi)
    angle = angle + warp * np.sin(angle)
    targets = np.zeros(steps)
    for harmonic in (1, 2, 3):
        amplitude = rng.uniform(0.1, 0.5) / harmonic**2
        targets += amplitude * np.sin(harmonic * angle + rng.uniform(0, 2 * np.pi))
    return rng.uniform(-0.3, 0.3) + targets


def chirp(rng: np.random.Generator, steps: int, dt: float) -> np.ndarray:
    """Logarithmic sine sweep from 0.3 to 6 Hz and back: 0.5 rad up to 1 Hz, then 0.5 rad · 1 Hz / f."""
    turn = rng.uniform(0.4, 0.6) * steps
    share = np.minimum(np.arange(steps) / turn, (steps - np.arange(steps)) / (steps - turn))
    frequency = 0.3 * 20.0**share
    return 0.5 / np.maximum(1.0, frequency) * np.sin(2 * np.pi * np.cumsum(frequency) * dt)


def multisine(rng: np.random.Generator, steps: int, dt: float) -> np.ndarray:
    """Sum of sines from 0.2 to 8 Hz with random phases, equal speed amplitudes above 1 Hz, rms 0.25 rad."""
    frequency = np.geomspace(0.2, 8.0, 12) * rng.uniform(0.95, 1.05, 12)
    amplitude = 1.0 / np.maximum(1.0, frequency)
    phase = rng.uniform(0, 2 * np.pi, 12)
    total = amplitude @ np.sin(
        2 * np.pi * frequency[:, None] * np.arange(steps) * dt + phase[:, None]
    )
    return 0.25 * total / np.sqrt(0.5 * np.sum(amplitude**2))


def zero_order_hold(targets: np.ndarray, every: int) -> np.ndarray:
    """Zero-order hold over ``every`` steps, like the targets of a 100 Hz policy."""
    return targets[(np.arange(len(targets)) // every) * every]


def ramps(rng: np.random.Generator, steps: int, dt: float, reach: float) -> np.ndarray:
    """Straight lines between random levels within ±reach, 0.3-1 s apart, starting at 0."""
    knots = _knots(rng, steps * dt, 0.3, 1.0)
    levels = rng.uniform(-reach, reach, len(knots))
    levels[0] = 0.0
    return np.interp(np.arange(steps) * dt, knots, levels)


def impacts(rng: np.random.Generator, steps: int, dt: float) -> np.ndarray:
    """(steps,) external torque [N·m]: the weight on a leg in stance, and half-sine impacts of 4-60 ms, up to 3 N·m."""
    torque = np.full(steps, rng.uniform(-0.5, 0.5))
    time = np.arange(steps) * dt
    now = rng.uniform(0.0, 0.2)
    while now < steps * dt:
        length = np.exp(rng.uniform(np.log(0.004), np.log(0.06)))
        peak = rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(0.2), np.log(3.0)))
        inside = (time >= now) & (time < now + length)
        torque[inside] += peak * np.sin(np.pi * (time[inside] - now) / length)
        now += rng.uniform(0.08, 0.35)
    return torque


EXCITATIONS = {
    "sine": Excitation(sine),
    "steps": Excitation(held_steps, jumps=True),
    "gait": Excitation(gait),
    "impacts": Excitation(gait, impacts),
    # slow motion [rad], dominated by friction and backlash; external torque [N·m] from stiction to
    # the stall
    "creep": Excitation(partial(ramps, reach=0.3), partial(ramps, reach=2.0)),
    "chirp": Excitation(chirp),
    "multisine": Excitation(multisine),
}


def excitation_named(name: str, others: tuple[str, ...] = ()) -> Excitation:
    """The excitation of that name; raises `ConfigError` if there is none. The remedy also lists ``others``."""
    if name not in EXCITATIONS:
        names = ", ".join((*EXCITATIONS, *others))
        raise ConfigError(
            f"no excitation {name!r}", remedy=f"use one of {names}", argument="excitation"
        )
    return EXCITATIONS[name]
