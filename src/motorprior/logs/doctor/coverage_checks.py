"""Checks of what a motion covers: amplitudes by frequency, and turns."""

from __future__ import annotations

import numpy as np

from motorprior.logs.doctor.excited_stretch import Stretch
from motorprior.logs.doctor.findings import Finding
from motorprior.logs.doctor.joint_checks import excited_joints
from motorprior.logs.doctor.reversals import reversals
from motorprior.logs.motor_log import MotorLog

OCTAVES = tuple(0.125 * 2.0**k for k in range(8))
"""Lower edges of the octaves [Hz], up to 32 Hz."""
LEAST_AMPLITUDE = 2e-3
LEAST_SHARE = 0.05
MIN_OCTAVES = 3
MIN_REVERSALS = 4
MANY_ROWS = 200_000
"""In which turns are sought, evenly spaced."""
TURN = 0.05
"""Share of a joint's range by which it goes back after a turn."""


def coverage(parts: list[Stretch]) -> list[Finding]:
    """Octaves of frequency in which an excited joint moves, with its amplitude in each, in some part.

    An octave counts where the amplitude is above 2 mrad and above 5 % of that of the strongest octave.
    """
    amplitudes = np.max([octave_amplitudes(part.angle, part.period) for part in parts], axis=0)
    return _octaves(parts[0].joint, amplitudes, parts[0].row)


def turns(log: MotorLog) -> list[Finding]:
    """How often each excited joint turns in all segments, by more than 5 % of its range."""
    found = []
    for column in excited_joints(log):
        angle = log.joint_pos[:, column]
        least, every = TURN * float(np.ptp(angle)), max(1, len(angle) // MANY_ROWS)
        count = sum(len(reversals(angle[part][::every], least)) for part in log.segment_slices())
        found += _turns(log.joint_names[column], count)
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
    least, most = OCTAVES[0], 2.0 * OCTAVES[-1]
    message = f"{joint} moves {moved or f'by less than 2 mrad at {least:g} to {most:g} Hz'}"
    if count >= MIN_OCTAVES:
        return [Finding("info", "coverage", count, MIN_OCTAVES, message, joint=joint, row=row)]
    message += f": {count} octaves, fewer than {MIN_OCTAVES}"
    remedy = "record steps, chirps or sums of sines as well, fast and slow, large and small"
    return [Finding("warning", "coverage", count, MIN_OCTAVES, message, remedy, joint, row)]


def _turns(joint: str, count: int) -> list[Finding]:
    if count >= MIN_REVERSALS:
        message = f"{joint}: {count} turns"
        return [Finding("info", "reversals", count, MIN_REVERSALS, message, joint=joint, row=0)]
    message = f"{joint}: {count} turns, fewer than {MIN_REVERSALS}: friction and play show at turns"
    remedy = "record motions that go back and forth"
    return [Finding("warning", "reversals", count, MIN_REVERSALS, message, remedy, joint, row=0)]
