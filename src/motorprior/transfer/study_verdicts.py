"""What a study compares, and the facts that its verdicts are told from."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from motorprior.transfer.places import ABROAD, TWINS
from motorprior.transfer.statistics import Comparison, Estimate, Statistic, iqms, means
from motorprior.transfer.walk_table import OWN, OWN_ABROAD

MEASURES = {
    "speed": "m/s", "upright": "1", "distance": "m", "heading_deg_per_m": "°/m", "lateral_share": "1", "drift": "m",
    "slip": "m/m", "transport": "1", "torque_beyond": "1", "step_frequency": "Hz", "foot_lift_mm": "mm",
    "body_rate": "rad/s",
}  # fmt: skip
"""Name -> unit, see `walk_measures`; the lift of every foot is foot_lift_mm/LEG."""
MEANS = frozenset({"upright"})
"""Measures whose mean is reported: the middle half of a share near 1 says nothing of the falls."""
PRIOR_MEAN, PRIOR, ADAPTED, ROBUST_PRIOR, ORACLE = "prior_mean", "prior", "prior_adapted", "prior_robust", "oracle"
PAPER, PAPER_WIDE, ONE_NETWORK = "paper", "paper_wide", "one_network"
BASELINE, TUNED_PD = "ideal_pd", "tuned_pd"
RIVALS = PD_FRICTION, PD_RANDOMISED = "pd_friction", "pd_randomised"
"""Conditions that the prior must beat."""
PD_ADAPTED = "pd_adapted"
OF_ONE_ROBOT = frozenset({ADAPTED, PD_ADAPTED})
"""Conditions whose policy of seed k was made for robot k, and walks on it alone."""
UNTRAINED = "untrained"
"""The gait itself: one policy, which nothing trained."""
CONDITIONS = (
    UNTRAINED, BASELINE, TUNED_PD, *RIVALS, PD_ADAPTED, ONE_NETWORK, PAPER, PAPER_WIDE,
    PRIOR_MEAN, PRIOR, ADAPTED, ROBUST_PRIOR, ORACLE,
)  # fmt: skip
"""Of a study, in the order of every table and picture."""
HARD = "hard"
DECIDING = tuple(name for name in TWINS if name != HARD)
"""Twins on which the prior must be better than its rivals; on the hard one, too, it must not be worse."""
NOT_MEASURED = "not measured"


class Compared(NamedTuple):
    """How a measure is told.

    Attributes:
        more: of it, in words.
        unit: in words.
        loss: difference that counts as a loss whatever its p [SI unit], since few policies would hide it.
    """

    more: str
    unit: str
    loss: float


COMPARED = {"speed": Compared("faster", "m/s", 0.05), "upright": Compared("upright for longer", "points", 0.05)}
"""Measures that conditions are compared by. Drift is none: it is known of who does not fall."""


def statistic_of(measure: str) -> Statistic:
    """What scores of a measure are summarised by."""
    return means if measure in MEANS else iqms


STEPS = (
    (TUNED_PD, PD_FRICTION, "Coulomb friction"),
    (PD_FRICTION, PRIOR_MEAN, "the prior's mean motor in place of a PD"),
    (PRIOR_MEAN, PRIOR, "samples in place of the mean"),
    (PRIOR, ADAPTED, "10 s of the robot's own log"),
    (ADAPTED, ORACLE, "true motors of other robots"),
    (PD_ADAPTED, ADAPTED, "the prior in place of a PD, after the same log"),
)
"""What each step from the tuned PD to the oracle changes, and last, aside, two ways to use one log: from, to, what."""
IN_WORDS = {
    PRIOR: "sampled", ADAPTED: "adapted", PD_FRICTION: "a PD with friction", PD_RANDOMISED: "a randomised PD",
}  # fmt: skip
LEAST_SPEED = 0.02
"""[m/s]; a policy that is slower where it was trained does not walk, and has no transfer ratio."""
LEAST_UPRIGHT = 0.9
"""Share of the time; an oracle that is upright for less is no measure."""
MOST_OF_IT = 2.0 / 3.0
"""Share of the lost time that the worst robots together make up."""
ENOUGH_SPEED, ENOUGH_UPRIGHT, UPRIGHT_WHERE_HARD, TWINS_WON = 0.95, 0.98, 0.9, 2


@dataclass(frozen=True)
class Verdict:
    """Attributes: said, aimed at or claimed; holds, None where it cannot be told; found, in numbers; why not."""

    said: str
    holds: bool | None
    found: str
    why: str = ""


class Pairing(NamedTuple):
    """Attributes: a place; two conditions that walked there, of which the second is taken from the first; a measure."""

    place: str
    one: str
    other: str
    measure: str


class Peer(NamedTuple):
    """What others are measured by. Attributes: its speed [m/s]; share of the time that it is upright [-]."""

    speed: float
    upright: float


class Loss(NamedTuple):
    """Where a condition loses time upright at a twin.

    Attributes:
        worst: fewest robots that make up MOST_OF_IT of the lost time.
        robots: that walked.
        upright: share of the time that the condition is upright on the worst ones [-].
        oracle: likewise of the oracle; NaN if it did not walk them.
    """

    worst: int
    robots: int
    upright: float
    oracle: float


@dataclass(frozen=True)
class Facts:
    """What the targets are judged by; see `study_summary.Summary`."""

    estimates: Mapping[tuple[str, str, str], Estimate]
    comparisons: Mapping[Pairing, Comparison]
    corrected: Mapping[Pairing, float]
    peers: Mapping[str, Peer]
    """Place -> the oracle on the robots that the adapted policies walk there."""
    standing: Mapping[tuple[str, str], float]
    """(place, condition) -> share of the policies that stand there."""
    losses: Mapping[tuple[str, str], Loss]
    """(twin, condition) -> on which robots its policies fall."""

    def value(self, place: str, condition: str, measure: str) -> float:
        """Of an estimate; NaN without one."""
        found = self.estimates.get((place, condition, measure))
        return float("nan") if found is None else found.value

    def twins(self) -> list[str]:
        """See `twins_in`."""
        return twins_in(place for place, *_ in self.estimates)


def twins_in(places: Iterable[str]) -> list[str]:
    """Those of some places where no policy was trained, each once: TWINS in their order, then others."""
    return in_order((place for place in places if place not in (OWN, OWN_ABROAD)), TWINS)


def home_of(place: str, condition: str, known: Container[tuple[str, str]]) -> tuple[str, str]:
    """Where, of the known (place, condition), the policies of a condition that walk at a twin were trained."""
    abroad = place in TWINS and TWINS[place].population == ABROAD and (OWN_ABROAD, condition) in known
    return (OWN_ABROAD if abroad else OWN), condition


def in_order(names: Iterable[str], order: Iterable[str]) -> list[str]:
    """Names, each once: those of an order in it, then the others as they come."""
    found = list(dict.fromkeys(names))
    known = [name for name in order if name in found]
    return known + [name for name in found if name not in known]


def number_text(value: float, form: str) -> str:
    """In a format, with a true minus."""
    return format(value, form).replace("-", "−")


def percent_text(value: float) -> str:
    """A share in per cent, rounded down to a tenth: what misses a bound does not look as if it met it."""
    return f"{np.floor(1000.0 * value + 1e-6) / 10.0:.1f} %" if np.isfinite(value) else "unknown"
