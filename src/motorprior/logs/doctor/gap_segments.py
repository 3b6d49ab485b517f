"""New segments after gaps, so that nothing is interpolated or fitted across them."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from motorprior.exceptions import LogError
from motorprior.logs.doctor.clock import GAP_FACTOR, gap_rows
from motorprior.logs.doctor.findings import IN_MAP
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.validity import checked

MIN_ROWS = 4  # of a piece between gaps
_MAX_NAMED = 5


def begin_at_gaps(log: MotorLog, period: float = 0.0) -> tuple[MotorLog, str]:
    """Begin a segment after every gap (`clock.gap_rows`).

    Args:
        log: as it was recorded.
        period: of the grid for the log [s]. Pieces next to gaps with a shorter duration, or with fewer than 4 rows, are
            dropped. Segments without a gap stay as they are.

    Returns:
        The log, its segments renumbered, and a sentence about the gaps; the same log and "" if there are none.

    Raises:
        LogError: no piece remains.
    """
    gaps = gap_rows(log)
    if not gaps.size:
        return log, ""
    after = set(gaps.tolist())
    pieces = []
    for first, last in pairwise(sorted({part.start for part in log.segment_slices()} | after | {log.num_rows})):
        short = last - first < MIN_ROWS or log.time[last - 1] - log.time[first] < period
        if not (short and after & {first, last}):
            pieces.append(np.arange(first, last))
    if not pieces:
        duration = f" and {period:g} s" if period else ""
        raise LogError(
            f"no run of {MIN_ROWS} rows{duration} without a gap of more than {GAP_FACTOR:g} median steps",
            where=log.source,
            remedy=f"record the time at which a row was measured, not received; or state its rate {IN_MAP}",
        )
    kept = log.rows(np.concatenate(pieces))
    segment = np.repeat(np.arange(len(pieces)), [len(piece) for piece in pieces])
    return checked(replace(kept, segment=segment), where=log.source), _sentence(log, gaps, log.num_rows - kept.num_rows)


def _sentence(log: MotorLog, gaps: np.ndarray, dropped: int) -> str:
    named = "; ".join(
        f"{log.time[row] - log.time[row - 1]:.3g} s before row {row}, at {log.time[row]:.6g} s"
        for row in gaps[:_MAX_NAMED]
    )
    more = f"; and {len(gaps) - _MAX_NAMED} more" if len(gaps) > _MAX_NAMED else ""
    lost = f"; {dropped} rows between gaps, too few to use, are left out" if dropped else ""
    count = "1 gap" if len(gaps) == 1 else f"{len(gaps)} gaps"
    return f"{count} longer than {GAP_FACTOR:g} median steps: {named}{more}; a segment begins after each{lost}"
