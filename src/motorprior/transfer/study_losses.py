"""On which robots policies of the prior fall: on a few that are hard for everybody, or on all of them now and then?"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from motorprior.transfer.study_verdicts import MOST_OF_IT, ORACLE, PRIOR, ROBUST_PRIOR, Loss
from motorprior.transfer.walk_table import OWN, WalkTable

Cells = Mapping[tuple[str, str], WalkTable]
"""(place, condition) -> its walks."""


def losses(cells: Cells) -> dict[tuple[str, str], Loss]:
    """(twin, condition) -> where it loses time; of the conditions whose policies walk all robots, if they lose any."""
    found = {}
    for place, condition in cells:
        if condition in (PRIOR, ROBUST_PRIOR) and place != OWN:
            upright, oracle = (_by_robot(cells.get((place, name)), place, name) for name in (condition, ORACLE))
            if sum(upright.values()) < len(upright):
                found[place, condition] = _loss(upright, oracle)
    return found


def _by_robot(cell: WalkTable | None, place: str, condition: str) -> dict[int, float]:
    """Number of the robot, which is the draw's -> share of the time that policies are upright on it."""
    if cell is None:
        return {}
    return dict(zip(cell.distinct("draw"), cell.scores(place, condition, "upright").mean(axis=0), strict=True))


def _loss(upright: Mapping[int, float], oracle: Mapping[int, float]) -> Loss:
    order = sorted(upright, key=upright.__getitem__)
    lost = np.cumsum([1.0 - upright[robot] for robot in order])
    worst = order[: int(np.searchsorted(lost, MOST_OF_IT * lost[-1] * (1.0 - 1e-9))) + 1]
    there = float(np.mean([oracle.get(robot, np.nan) for robot in worst]))
    return Loss(len(worst), len(order), float(np.mean([upright[robot] for robot in worst])), there)
