"""Tests that permute policies: p values that are exact however few there are, and their correction for many."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from functools import lru_cache
from itertools import combinations
from math import comb
from typing import TypeVar

import numpy as np

WAYS = 20_000
"""Most ways to deal policies that a test tries; of more it draws so many."""
_SEED = 0x57A7
Key = TypeVar("Key", bound=Hashable)


def permutation_p(one: np.ndarray, other: np.ndarray) -> float:
    """Two-sided p of no difference between two conditions, by dealing their policies anew (Pitman 1937).

    The share of all ways to deal the policies to the conditions in which the means differ by at least as much as they
    do. Exact, however few policies there are and whatever their distribution: of eight against eight it is 2 / 12870 at
    least, of two against two 1 / 3. 1 where a condition has no score.

    Args:
        one: (policies,) a score of every policy of the first condition; NaN where it is not known.
        other: likewise of the second.
    """
    one, other = one[np.isfinite(one)], other[np.isfinite(other)]
    if not len(one) or not len(other):
        return 1.0
    scores, taken = np.concatenate([one, other]), _splits(len(one), len(other))
    differences = (taken @ scores) / len(one) - (~taken @ scores) / len(other)
    least = abs(one.mean() - other.mean()) * (1.0 - 1e-9) - 1e-12  # sums round differently
    return float(np.mean(np.abs(differences) >= least))


@lru_cache
def _splits(first: int, second: int) -> np.ndarray:
    """(ways, first + second) which scores a way gives to the first condition; row 0 is how they are.

    All ways, or WAYS of them.
    """
    size = first + second
    if comb(size, first) <= WAYS:
        chosen = np.array(list(combinations(range(size), first)))
    else:
        rng = np.random.default_rng(_SEED)
        chosen = np.array([np.arange(first), *(rng.permutation(size)[:first] for _ in range(WAYS - 1))])
    taken = np.zeros((len(chosen), size), dtype=bool)
    np.put_along_axis(taken, chosen, True, axis=1)
    return taken


def sign_p(differences: np.ndarray) -> float:
    """Two-sided p of no difference between pairs, by changing signs in all ways, or in WAYS of them (Fisher 1935).

    Args:
        differences: (pairs,) of scores; NaN where one is not known.
    """
    known = differences[np.isfinite(differences)]
    count = len(known)
    if not count:
        return 1.0
    if 2**count <= WAYS:
        signs = 1 - 2 * (np.arange(2**count)[:, None] >> np.arange(count) & 1)
    else:
        signs = np.random.default_rng(_SEED).choice([-1, 1], (WAYS, count))
        signs[0] = 1
    least = abs(known.sum()) * (1.0 - 1e-9) - 1e-12  # sums round differently
    return float(np.mean(np.abs(signs @ known) >= least))


def holm(p_values: Mapping[Key, float]) -> dict[Key, float]:
    """P values corrected for their number by the step-down procedure of Holm, by the same keys."""
    corrected, largest = {}, 0.0
    for rank, key in enumerate(sorted(p_values, key=p_values.__getitem__)):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[key]))
        corrected[key] = largest
    return {key: corrected[key] for key in p_values}
