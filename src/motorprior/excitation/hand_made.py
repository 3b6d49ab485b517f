"""Hand-made excitations by name. To add one, add its signal and an entry to EXCITATIONS.

Signals are (steps,) position targets [rad], or external torques [N·m] where stated.
"""

from functools import partial

import numpy as np

from motorprior.excitation.excitation import Excitation, Rng


def sine(rng: Rng, steps: int, dt: float) -> np.ndarray:
    """The paper's excitation: center + amplitude(t)·sin(2π∫f(t) dt), f 0.3-6 Hz, 0.05-0.6 rad."""
    frequency = _wandering(rng, steps, dt, 0.3, 6.0)
    amplitude = np.minimum(_wandering(rng, steps, dt, 0.05, 0.6), 1.2 / frequency)

    first_phase = rng.uniform(0, 2 * np.pi)
    phase = first_phase + 2 * np.pi * np.cumsum(frequency) * dt
    center = rng.uniform(-0.3, 0.3)
    return center + amplitude * np.sin(phase)


def held_steps(rng: Rng, steps: int, dt: float) -> np.ndarray:
    """Levels within ±0.6 rad, each held for 0.08-0.5 s."""
    targets = np.empty(steps)
    filled = 0
    while filled < steps:
        length = int(rng.uniform(0.08, 0.5) / dt)
        targets[filled : filled + length] = rng.uniform(-0.6, 0.6)
        filled += length
    return targets


def gait(rng: Rng, steps: int, dt: float) -> np.ndarray:
    """Periodic motion of a leg joint: 0.8-2.5 Hz, three harmonics.

    The joint is nearly static in a part of the cycle.
    """
    frequency = rng.uniform(0.8, 2.5)
    warp = rng.uniform(-0.8, 0.8)
    angle = 2 * np.pi * frequency * np.arange(steps) * dt + rng.uniform(0, 2 * np.pi)
    angle = angle + warp * np.sin(angle)

    targets = np.zeros(steps)
    for harmonic in (1, 2, 3):
        amplitude = rng.uniform(0.1, 0.5) / harmonic**2
        phase = rng.uniform(0, 2 * np.pi)
        targets += amplitude * np.sin(harmonic * angle + phase)

    center = rng.uniform(-0.3, 0.3)
    return center + targets


def chirp(rng: Rng, steps: int, dt: float) -> np.ndarray:
    """Logarithmic sine sweep, 0.3 to 6 Hz and back: 0.5 rad up to 1 Hz, then 0.5 rad · 1 Hz / f."""
    turn = rng.uniform(0.4, 0.6) * steps
    rising = np.arange(steps) / turn
    falling = (steps - np.arange(steps)) / (steps - turn)
    frequency = 0.3 * 20.0 ** np.minimum(rising, falling)

    amplitude = 0.5 / np.maximum(1.0, frequency)
    return amplitude * np.sin(2 * np.pi * np.cumsum(frequency) * dt)


def multisine(rng: Rng, steps: int, dt: float) -> np.ndarray:
    """Sines of 0.2 to 8 Hz with random phases, equal speed amplitudes above 1 Hz, rms 0.25 rad."""
    frequency = np.geomspace(0.2, 8.0, 12) * rng.uniform(0.95, 1.05, 12)
    amplitude = 1.0 / np.maximum(1.0, frequency)
    first_phase = rng.uniform(0, 2 * np.pi, 12)

    phase = 2 * np.pi * frequency[:, None] * np.arange(steps) * dt + first_phase[:, None]
    total = amplitude @ np.sin(phase)
    rms = np.sqrt(0.5 * np.sum(amplitude**2))
    return 0.25 * total / rms


def ramps(rng: Rng, steps: int, dt: float, reach: float) -> np.ndarray:
    """Straight lines between random levels within ±reach, 0.3-1 s apart, starting at 0."""
    knots = _knots(rng, steps * dt, 0.3, 1.0)
    levels = rng.uniform(-reach, reach, len(knots))
    levels[0] = 0.0
    return np.interp(np.arange(steps) * dt, knots, levels)


def impacts(rng: Rng, steps: int, dt: float) -> np.ndarray:
    """External torque [N·m]: the weight on a leg in stance, and half-sine impacts.

    Impacts last 4-60 ms and reach at most 3 N·m.
    """
    torque = np.full(steps, rng.uniform(-0.5, 0.5))
    time = np.arange(steps) * dt

    start = rng.uniform(0.0, 0.2)
    while start < steps * dt:
        length = np.exp(rng.uniform(np.log(0.004), np.log(0.06)))
        sign = rng.choice([-1.0, 1.0])
        peak = sign * np.exp(rng.uniform(np.log(0.2), np.log(3.0)))

        inside = (time >= start) & (time < start + length)
        torque[inside] += peak * np.sin(np.pi * (time[inside] - start) / length)
        start += rng.uniform(0.08, 0.35)
    return torque


def zero_order_hold(targets: np.ndarray, hold_steps: int) -> np.ndarray:
    """Zero-order hold over ``hold_steps`` steps, like the targets of a 100 Hz policy."""
    return targets[(np.arange(len(targets)) // hold_steps) * hold_steps]


def _wandering(rng: Rng, steps: int, dt: float, low: float, high: float) -> np.ndarray:
    """A positive signal, log-linear between random levels 0.5-1.5 s apart."""
    knots = _knots(rng, steps * dt, 0.5, 1.5)
    levels = rng.uniform(np.log(low), np.log(high), len(knots))
    return np.exp(np.interp(np.arange(steps) * dt, knots, levels))


def _knots(rng: Rng, duration: float, low: float, high: float) -> list[float]:
    """Times from 0 to beyond ``duration`` [s], with random intervals from ``low`` to ``high``."""
    knots = [0.0]
    while knots[-1] < duration:
        knots.append(knots[-1] + rng.uniform(low, high))
    return knots


EXCITATIONS = {
    "sine": Excitation(sine),
    "steps": Excitation(held_steps, jumps=True),
    "gait": Excitation(gait),
    "impacts": Excitation(gait, impacts),
    # Slow motion [rad], dominated by friction and backlash.
    # The external torque [N·m] reaches from stiction to stall.
    "creep": Excitation(partial(ramps, reach=0.3), partial(ramps, reach=2.0)),
    "chirp": Excitation(chirp),
    "multisine": Excitation(multisine),
}
