"""Gaps in a recording become ends of segments, so that nothing is interpolated or fitted across them."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from motorprior.exceptions import LogError
from motorprior.logs.doctor.clock_checks import GAP_FACTOR, gap_rows
from motorprior.logs.doctor.findings import IN_MAP
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.validity import checked

LEAST_ROWS = 4
"""Of what is left between two gaps; shorter pieces are left out."""
_MOST_NAMED = 5


def begin_at_gaps(log: MotorLog, period: float = 0.0) -> tuple[MotorLog, str]:
    """The log with a new segment after every gap, as the log doctor finds them (`clock_checks.gap_rows`).

    Args:
        log: as it was recorded.
        period: of the grid that it will be put on [s]; pieces between gaps that are shorter, or have fewer than
            LEAST_ROWS rows, are left out. Segments without a gap stay as they are.

    Returns:
        The log, whose segments are numbered anew if there is a gap, and a sentence about the gaps; empty if none is.

    Raises:
        LogError: nothing is left.
    """
    starts = gap_rows(log)
    if not starts.size:
        return log, ""
    parts = _pieces(log, starts, period)
    if not parts:
        least = f" and {period:g} s" if period else ""
        raise LogError(
            f"nowhere {LEAST_ROWS} rows{least} without a gap of more than {GAP_FACTOR:g} median steps",
            where=log.source,
            remedy=f"record the time at which a row was measured, not received; or state its rate {IN_MAP}",
        )  # fmt: skip
    kept = log.rows(np.concatenate([np.arange(part.start, part.stop) for part in parts]))
    segment = np.repeat(np.arange(len(parts)), [part.stop - part.start for part in parts])
    told = _sentence(log, starts, log.num_rows - kept.num_rows)
    return checked(replace(kept, segment=segment), where=log.source), told


def _pieces(log: MotorLog, starts: np.ndarray, period: float) -> list[slice]:
    """Rows of every segment, and of what is left of one that has gaps before the rows ``starts``."""
    after = set(starts.tolist())
    edges = sorted({part.start for part in log.segment_slices()} | after | {log.num_rows})
    pieces = [slice(first, last) for first, last in pairwise(edges)]
    return [piece for piece in pieces if not (after & {piece.start, piece.stop} and _is_short(log, piece, period))]


def _is_short(log: MotorLog, piece: slice, period: float) -> bool:
    seconds = float(log.time[piece.stop - 1] - log.time[piece.start])
    return piece.stop - piece.start < LEAST_ROWS or seconds < period


def _sentence(log: MotorLog, starts: np.ndarray, left_out: int) -> str:
    named = [
        f"{log.time[row] - log.time[row - 1]:.3g} s before row {row}, at {log.time[row]:.6g} s"
        for row in starts[:_MOST_NAMED]
    ]
    more = f"; and {len(starts) - len(named)} more" if len(starts) > len(named) else ""
    many = "1 gap" if len(starts) == 1 else f"{len(starts)} gaps"
    lost = f"; {left_out} rows between gaps, too few to use, are left out" if left_out else ""
    return (
        f"{many} longer than {GAP_FACTOR:g} median steps: {'; '.join(named)}{more}; "
        f"a segment begins after {'it' if len(starts) == 1 else 'each'}{lost}"
    )
