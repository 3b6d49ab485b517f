"""Constants of training motors as their logs identify them: estimates and joint uncertainty.

The uncertainty of the constants v of a motor is Gaussian, jointly, in the coordinates

    y = log(v + s)      positive constants
    y = log(1/v + s)    gear stiffness, whose inverse is a compliance
    y = v/unit          signed constants (`optional_terms.SIGNED`)

The scale s of a constant is a value that has almost no effect, such as a small friction. Far above
s, y is the logarithm. Far below, y is linear, so that an interval may begin at 0, or, for a gear
stiffness, be open above.

A constant is *identified* if the upper end of its marginal 90 % interval is less than MAX_RATIO
times the lower end. A signed constant is identified if its interval is narrower than one unit.

Ends that are further away than the factor MAX_BOUND are no bounds: the interval of such a constant
is open to both sides. Nor is a delay beyond MAX_DELAY a bound.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from motorprior.actuator.geared_motor_step import MAX_DELAY, parameters_of
from motorprior.actuator.optional_terms import SIGNED

# Maximum ratio of the ends of the 90 % interval of an identified constant. A constant with this
# ratio is known within ±41 %: enough to tell motors apart that differ as much as makes do.
MAX_RATIO = 2.0
# Maximum ratio of v + s between an end of an interval and the estimate. Motors of different makers
# differ by less, so that a wider interval is no news.
MAX_BOUND = 10.0
SCORE = 1.6449  # standard normal score of the ends of a 90 % interval
LIMITS = (
    "torque_limit",
    "profile_speed",
    "no_load_speed",
    "profile_acceleration",
)
_INVERSE = "gear_stiffness"


def coordinate(name: str, value: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Coordinate y of values of a constant [SI], with scales s; formula of the module docstring."""
    if name in SIGNED:
        return value / SIGNED[name]
    return np.log((1.0 / value if name == _INVERSE else value) + scale)


def value_at(name: str, y: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Value of a constant [SI] at coordinates y: at least 0, and inf for a rigid gear."""
    if name in SIGNED:
        return y * SIGNED[name]
    value = np.maximum(np.exp(y) - scale, 0.0)
    if name != _INVERSE:
        return value
    with np.errstate(divide="ignore"):
        return 1.0 / value


@dataclass(frozen=True)
class Combination:
    """A product of powers of constants, or a sum, that a log may identify without its parts."""

    name: str
    unit: str
    text: str  # formula
    parts: tuple[str, ...]  # constants in the formula

    def value(self, constants: Mapping[str, np.ndarray]) -> np.ndarray:
        """Value of the combination [SI]."""
        kp = constants["kp"]
        if self.name == "kp_per_armature":
            return kp / constants["armature"]
        if self.name == "damping_per_kp":
            return constants["kd_over_kp"] + constants["viscous_damping"] / kp
        return constants["coulomb"] / kp


COMBINATIONS = (
    Combination("kp_per_armature", "1/s²", "kp / armature", ("kp", "armature")),
    Combination(
        "damping_per_kp",
        "s",
        "kd_over_kp + viscous_damping / kp",
        ("kd_over_kp", "viscous_damping", "kp"),
    ),
    Combination("coulomb_per_kp", "rad", "coulomb / kp", ("coulomb", "kp")),
)


@dataclass(frozen=True)
class Estimates:
    """Uncertainty of the P constants of M training motors."""

    covariance: np.ndarray  # (M, P, P) of the coordinates; 0 for constants that are not fitted
    # (M, P) scales s [SI]; of a limit, the largest value that the log reached
    scale: np.ndarray

    def with_more_variance(self, deviations: np.ndarray) -> "Estimates":
        """The estimates with variances that are larger by the squares of deviations (M, P).

        Deviations are distances of outliers from the other motors of the same model, or UNKNOWN_STD
        for constants that a log cannot identify, and 0 for other constants.
        """
        columns = np.arange(deviations.shape[1])
        covariance = self.covariance.copy()
        covariance[:, columns, columns] += deviations**2
        return Estimates(covariance, self.scale)

    def ends(
        self, values: Mapping[str, np.ndarray], terms: tuple[str, ...], score: float = SCORE
    ) -> dict[str, np.ndarray]:
        """(2, M) ends of the interval of each constant of the motors with ``values`` (M,).

        An interval reaches ``score`` standard deviations to both sides. A limit that the log does
        not identify may be any higher value, if its interval has the largest value that the log
        reached. A limit above this value has no effect on the log: its interval begins there.
        """
        ends = {}
        for column, name in enumerate(parameters_of(terms)):
            scale = scale_of(self.scale, name, column)
            y = coordinate(name, values[name], scale)
            std = np.sqrt(self.covariance[:, column, column])
            both = np.stack([value_at(name, y - score * std, scale)] * 2)
            both[1] = value_at(name, y + score * std, scale)
            ends[name] = np.sort(both, axis=0)
            if name in LIMITS:
                reached = self.scale[:, column]
                is_open = ~is_identified(name, ends[name]) & (ends[name][1] >= reached)
                ends[name][1, is_open] = np.inf
                has_no_effect = is_open & (values[name] >= reached)
                ends[name][0, has_no_effect] = reached[has_no_effect]
            elif name not in SIGNED:
                is_unbounded = score * std > np.log(MAX_BOUND)
                ends[name][0, is_unbounded] = 0.0
                ends[name][1, is_unbounded] = np.inf
            if name == "delay":
                ends[name][1, ends[name][1] > MAX_DELAY] = np.inf
        return ends

    def fitted(self, terms: tuple[str, ...]) -> tuple[str, ...]:
        """Names of the constants that were fitted."""
        variances = np.diagonal(self.covariance, axis1=1, axis2=2)
        columns = zip(parameters_of(terms), variances.T, strict=True)
        return tuple(name for name, of_motors in columns if of_motors.any())

    def identified(
        self, values: Mapping[str, np.ndarray], terms: tuple[str, ...]
    ) -> dict[str, np.ndarray]:
        """(M,) whether the log identifies each fitted constant, with ``values`` (M,) by name."""
        ends = self.ends(values, terms)
        return {name: is_identified(name, ends[name]) for name in self.fitted(terms)}

    def combination_ends(
        self, values: Mapping[str, np.ndarray], terms: tuple[str, ...], score: float = SCORE
    ) -> dict[str, np.ndarray]:
        """(2, M) ends of the intervals of the COMBINATIONS, whose logarithms are linearised."""
        names = parameters_of(terms)
        ends = {}
        for combination in COMBINATIONS:
            center = np.log(combination.value(values))
            slope = np.zeros(self.scale.shape)
            for column, name in enumerate(names):
                scale = scale_of(self.scale, name, column)
                y = coordinate(name, values[name], scale)
                changed = dict(values) | {name: value_at(name, y + 1e-4, scale)}
                slope[:, column] = (np.log(combination.value(changed)) - center) / 1e-4
            variance = np.einsum("mi,mij,mj->m", slope, self.covariance, slope)
            reach = score * np.sqrt(variance)
            ends[combination.name] = np.exp(np.stack([center - reach, center + reach]))
        return ends


def scale_of(scale: np.ndarray, name: str, column: int) -> np.ndarray:
    """(M,) scales s of a constant, of ``scale`` (M, K); limits have none."""
    return np.zeros(len(scale)) if name in LIMITS else scale[:, column]


def is_identified(name: str, ends: np.ndarray) -> np.ndarray:
    """(M,) whether intervals with these ends (2, M) identify a constant."""
    low, high = ends
    if name in SIGNED:
        return high - low < SIGNED[name]
    return high < MAX_RATIO * low
