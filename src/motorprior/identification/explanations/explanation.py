"""The interface of an explanation: a few parameters that change the inputs of a fit.

An explanation states what may be wrong with a log, for example a factor on its gains. Its
parameters θ are 0 if the log is right. `attempt` fits them together with the constants of each
motor.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from motorprior.identification import windows
from motorprior.logs.loads_bodies import TURN_POWERS

# Further channels, after those of `windows`, of three kinds of explanations.
_FIRST = windows.CHANNELS + windows.FRAME_CHANNELS
# Gravity: lever and slope (`GravityLevers`) in the directions x, y and z
LEVER = slice(_FIRST, _FIRST + 3)
SLOPE = slice(_FIRST + 3, _FIRST + 6)
CHANNELS_WITH_GRAVITY = _FIRST + 6
# A mass on a link: coefficients of `LinkMass`
MASS_INERTIA = slice(_FIRST, _FIRST + 3)
MASS_EXTERNAL = slice(_FIRST + 3, _FIRST + 6)
MASS_STIFFNESS = slice(_FIRST + 6, _FIRST + 9)
CHANNELS_WITH_MASS = _FIRST + 9
# A joint that is turned: coefficients of `turned_loads`, its angle, and whether it is this joint
TURNED_INERTIA = slice(_FIRST, _FIRST + TURN_POWERS)
TURNED_EXTERNAL = slice(_FIRST + TURN_POWERS, _FIRST + 2 * TURN_POWERS)
TURNED_STIFFNESS = slice(_FIRST + 2 * TURN_POWERS, _FIRST + 3 * TURN_POWERS)
TURNED_POS = _FIRST + 3 * TURN_POWERS
IS_TURNED = TURNED_POS + 1
CHANNELS_WITH_TURN = IS_TURNED + 1


def has_turned_loads(rows: np.ndarray) -> bool:
    """Whether rows (T, channels, L) have the channels of a joint that is turned."""
    return rows.shape[1] == CHANNELS_WITH_TURN


@dataclass(frozen=True)
class Facts:
    """What is known about the logs of M motors that are explained."""

    joint_names: tuple[str, ...]  # M
    period: float  # [s]
    logs: tuple[str, ...]  # names of the logs
    gains: np.ndarray | None  # (2, M) gains that the logs state in N·m/rad, None if they do not
    has_kd: bool  # whether the logs state kd
    has_torque: bool
    has_gravity: bool  # whether the rigid bodies of the loads are known
    at_rotor: bool
    motion: np.ndarray  # (M,) standard deviation of the angles [rad]
    kd_over_kp: np.ndarray  # (M,) of the fitted motors [s]
    link_mass: np.ndarray  # (M,) mass of what each joint carries, 0 if unknown [kg]
    link_reach: np.ndarray  # (M,) twice the distance of its link's centre of mass [m]
    # velocity_target and torque_feedforward, if the logs have them
    commands: tuple[str, ...]


@dataclass(frozen=True)
class Estimate:
    """Parameters of one motor, with the half widths of their 90 % intervals."""

    values: np.ndarray  # (P,)
    half_widths: np.ndarray  # (P,)

    def count_above(self, smallest: np.ndarray) -> int:
        """Number of parameters above ``smallest`` (P,) whose intervals exclude 0."""
        size = np.abs(self.values)
        return int(np.sum((size > smallest) & (size > self.half_widths)))

    @property
    def low(self) -> np.ndarray:
        """(P,) lower ends."""
        return self.values - self.half_widths

    @property
    def high(self) -> np.ndarray:
        """(P,) upper ends."""
        return self.values + self.half_widths

    def factor_text(self, index: int = 0) -> str:
        """A parameter that is the logarithm of a factor, for example "4.1 [4.0, 4.2]"."""
        ends = f"[{np.exp(self.low[index]):.3g}, {np.exp(self.high[index]):.3g}]"
        return f"{np.exp(self.values[index]):.3g} {ends}"

    def text(self, index: int = 0, factor: float = 1.0) -> str:
        """A parameter times ``factor``, for example "0.35 [0.34, 0.36]"."""
        ends = factor * np.array([self.low[index], self.high[index]])
        return f"{factor * self.values[index]:.3g} [{ends.min():.3g}, {ends.max():.3g}]"


# (rows (T, channels, L), parameters (P, L), period [s]) -> changed rows; the rows may be changed in
# place
Change = Callable[[np.ndarray, np.ndarray, float], np.ndarray]
# (estimate, joint, facts) -> what is wrong, and what to do
Description = Callable[[Estimate, int, Facts], tuple[str, str]]


@dataclass(frozen=True)
class Explanation:
    """One entry of the registry.

    Attributes:
        name: unique, for programs.
        change: the inputs with the parameters.
        describe: what is wrong, with the value, and the remedy.
        units: values of the P parameters that change the inputs noticeably.
        smallest: magnitudes of the P parameters; if all are smaller, a user need not know.
        applies: whether the logs can be wrong in this way.
        guess: parameters from the rows (T, channels, M) of a log, to start from.
        replaces: signed constants that are 0, since the parameters have their effect.
        held: constants that keep the value of the initial motor, since they have the same effect.
        scales_torques: whether its first parameter is a factor on torques of the motor as well.
        per_log: whether it is also tried on single logs, if there are several.
        only_per_log: whether it is not tried on all logs together.
        is_shared: whether it has the same parameters for all joints.
        is_even: whether its effect may be the same for both signs of a parameter: weights that are
            turned out of the plane of a joint become lighter.
        turns: whether it turns what a joint carries; with known bodies it is tried for one joint
            after the other, and changes the loads of this joint, and of all joints that carry it or
            that it carries.
        adds_mass: whether it adds a mass to the link of a joint; it is tried for one joint after
            the other, and changes the loads of all joints that carry this link.
    """

    name: str
    change: Change
    describe: Description
    units: tuple[float, ...] = (1.0,)
    smallest: tuple[float, ...] = (0.05,)
    applies: Callable[[Facts], bool] = field(default=lambda facts: True)
    guess: Callable[[np.ndarray], np.ndarray] | None = None
    replaces: tuple[str, ...] = ()
    held: tuple[str, ...] = ()
    scales_torques: bool = False
    per_log: bool = False
    only_per_log: bool = False
    is_shared: bool = False
    is_even: bool = False
    turns: bool = False
    adds_mass: bool = False


# (time steps of one segment as rows (T, channels, M), motion (M,) [rad], period [s]) -> mask (T, M)
Faulty = Callable[[np.ndarray, np.ndarray, float], np.ndarray]


@dataclass(frozen=True)
class RowExplanation:
    """An entry that leaves rows out, in which the joint is not driven by its motor alone."""

    name: str
    faulty: Faulty
    problem: str  # with {joint}, {seconds} and {where}
    remedy: str
