"""Checks of what a motion covers: amplitudes by frequency, and turns."""

from __future__ import annotations

import numpy as np

from motorprior.logs.excited_stretch import Stretch
from motorprior.logs.findings import Finding
from motorprior.logs.joint_checks import excited_joints
from motorprior.logs.reversals import reversals

OCTAVES = tuple(0.125 * 2.0**k for k in range(8))
"""Lower edges of the octaves [Hz], up to 32 Hz."""
LEAST_AMPLITUDE = 2e-3
LEAST_SHARE = 0.05
MIN_OCTAVES = 3
MIN_REVERSALS = 4


def coverage(stretch: Stretch) -> list[Finding]:
    """Octaves of frequency in which each excited joint moves, with its amplitude in each, and how often it turns.

    An octave counts where the amplitude is above 2 mrad and above 5 % of that of the strongest octave.
    """
    found = []
    for column in excited_joints(stretch.log):
        angle, joint = stretch.log.joint_pos[:, column], stretch.log.joint_names[column]
        found += _octaves(joint, octave_amplitudes(angle, stretch.period), stretch.row)
        found += _turns(joint, len(reversals(angle)), stretch.row)
    return found


def octave_amplitudes(angle: np.ndarray, period: float) -> np.ndarray:
    """Amplitude [rad] in each of OCTAVES: √2 times the root mean square of what an angle (T,) does there.

    Of the periodogram with Hann's window, scaled so that its sum is the variance.
    """
    window = np.hanning(len(angle))
    power = np.abs(np.fft.rfft(window * (angle - angle.mean()))) ** 2
    power[1:] *= 2.0 / (len(angle) * float(window @ window))
    frequency = np.fft.rfftfreq(len(angle), period)
    octave = np.digitize(frequency, [*OCTAVES, 2.0 * OCTAVES[-1]])
    return np.array([np.sqrt(2.0 * power[octave == 1 + index].sum()) for index in range(len(OCTAVES))])


def _octaves(joint: str, amplitudes: np.ndarray, row: int) -> list[Finding]:
    strong = amplitudes > max(LEAST_AMPLITUDE, LEAST_SHARE * float(amplitudes.max()))
    count = int(strong.sum())
    moved = ", ".join(
        f"{1e3 * amplitudes[k]:.0f} mrad at {OCTAVES[k]:g}-{2 * OCTAVES[k]:g} Hz" for k in np.flatnonzero(strong)
    )
    message = f"{joint} moves {moved or 'by less than 2 mrad at any frequency'}"
    if count >= MIN_OCTAVES:
        return [Finding("info", "coverage", count, MIN_OCTAVES, message, joint=joint, row=row)]
    message += f": {count} octaves, fewer than {MIN_OCTAVES}"
    remedy = "record steps, chirps or sums of sines as well, fast and slow, large and small"
    return [Finding("warning", "coverage", count, MIN_OCTAVES, message, remedy, joint, row)]


def _turns(joint: str, count: int, row: int) -> list[Finding]:
    if count >= MIN_REVERSALS:
        message = f"{joint}: {count} turns"
        return [Finding("info", "reversals", count, MIN_REVERSALS, message, joint=joint, row=row)]
    message = f"{joint}: {count} turns, fewer than {MIN_REVERSALS}: friction and play show at turns"
    remedy = "record motions that go back and forth"
    return [Finding("warning", "reversals", count, MIN_REVERSALS, message, remedy, joint, row)]
