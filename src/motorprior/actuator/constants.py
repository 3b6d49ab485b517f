"""Tables of motor constants: unit, estimate with its interval from logs, range between motors."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from motorprior.actuator.geared_motor_step import parameters_of, with_logged_gains
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.optional_terms import CONSTANTS
from motorprior.logs.motor_log import PHYSICAL_GAINS
from motorprior.texts import html_table, text_table

if TYPE_CHECKING:
    from motorprior.actuator.latent import LatentNetwork

MAX_COLUMNS = 16  # motors with a column each in `html_of_motors`
NUM_SAMPLES = 1000  # samples for the quantiles of a distribution
# suffix of the names of constants that are multiples of a logged gain
PER_LOGGED_GAIN = "_per_logged"
_PER_UNIT = "of the firmware's gain"
UNITS = {
    "kp": "N·m/rad",
    "kd_over_kp": "s",
    "kd": "N·m·s/rad",
    "velocity_filter": "s",
    "delay": "s",
    "torque_limit": "N·m",
    "armature": "kg·m²",
    "coulomb": "N·m",
    "stribeck_torque": "N·m",
    "viscous_damping": "N·m·s/rad",
    "load_friction": "1",
    "gear_stiffness": "N·m/rad",
    "backlash": "rad",
    "gear_damping": "N·m·s/rad",
    "encoder_zero": "rad",
    f"kp{PER_LOGGED_GAIN}": f"N·m/rad per unit {_PER_UNIT}",
    f"kd_over_kp{PER_LOGGED_GAIN}": f"s per unit {_PER_UNIT}",
    f"kd{PER_LOGGED_GAIN}": f"N·m·s/rad per unit {_PER_UNIT}",
    **{constant.name: constant.unit for constant in CONSTANTS.values()},
}
COLUMNS = ("constant", "unit", "median", "5 %", "95 %", "identifiable")
# titles of columns
ESTIMATE = "estimate from the log, 90 % interval"
POSTERIOR = "estimate from log and prior, 90 % interval"
RANGE = "range between units"


class Estimate(NamedTuple):
    """Estimate of a constant of one motor, or medians over several motors, from logs alone."""

    value: float
    low: float  # ends of the 90 % interval
    high: float
    is_identified: bool

    def __str__(self) -> str:
        if self.is_identified:
            return f"{self.value:.3g} ({_interval(self.low, self.high)})"
        if self.low == 0.0 and np.isinf(self.high):
            return "not identified"
        return f"not identified ({_interval(self.low, self.high)})"


class ConstantSummary(NamedTuple):
    """Estimate of a constant from logs, and its distribution over motors."""

    name: str
    unit: str
    median: float
    low: float  # 5 % of the motors are below
    high: float  # 5 % are above
    identifiable: bool | None  # whether the logs identify it; None if unknown
    estimate: Estimate | None = None  # None if it is unknown or not fitted

    def __str__(self) -> str:
        estimate = f"estimate {self.estimate}, " if self.estimate else ""
        return f"{self.name} [{self.unit}]: {estimate}units {self.range_text}"

    @property
    def range_text(self) -> str:
        """Median and 5 to 95 % range of the units."""
        return f"{self.median:.3g} ({_interval(self.low, self.high)})"

    @property
    def estimate_text(self) -> str:
        """The estimate with its interval, or that the constant was not fitted."""
        return "not fitted" if self.estimate is None else str(self.estimate)


def _interval(low: float, high: float) -> str:
    if np.isinf(high):
        return f"≥ {low:.3g}"
    return f"{low:.3g} to {high:.3g}" if low else f"≤ {high:.3g}"


@dataclass(frozen=True)
class Constants:
    """A row per constant; prints as a table."""

    rows: tuple[ConstantSummary, ...]
    columns: tuple[str, ...] = COLUMNS  # titles; other columns are of a table with estimates

    @classmethod
    def of(
        cls,
        values: Mapping[str, np.ndarray],
        units: Mapping[str, str],
        identified: Mapping[str, bool | None],
        estimates: Mapping[str, Estimate] | None = None,
        source: str = "",
        title: str = ESTIMATE,
    ) -> "Constants":
        """Quantiles of samples (n,) by name; constants without ``identified`` are unknown.

        With ``estimates``, which are of fitted constants only, the table has them under ``title``;
        ``source`` states where the range between units comes from.
        """
        rows = []
        for name, samples in values.items():
            low, median, high = np.quantile(samples, [0.05, 0.5, 0.95]).tolist()
            is_identified = identified.get(name)
            estimate = None if estimates is None else estimates.get(name)
            row = ConstantSummary(name, units[name], median, low, high, is_identified, estimate)
            rows.append(row)
        if estimates is None:
            return cls(tuple(rows))
        range_title = f"{RANGE}, {source}" if source else RANGE
        return cls(tuple(rows), ("constant", "unit", title, range_title))

    def __iter__(self) -> Iterator[ConstantSummary]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, name: str) -> ConstantSummary:
        return {row.name: row for row in self.rows}[name]

    @property
    def cells(self) -> list[list[str]]:
        """Texts of the rows, in the order of the columns."""
        answers = {True: "yes", False: "no", None: "unknown"}
        cells = []
        for row in self.rows:
            if self.columns != COLUMNS:
                cells.append([row.name, row.unit, row.estimate_text, row.range_text])
                continue
            numbers = [f"{value:.3g}" for value in (row.median, row.low, row.high)]
            cells.append([row.name, row.unit, *numbers, answers[row.identifiable]])
        return cells

    def __str__(self) -> str:
        return text_table(self.columns, self.cells)

    def _repr_html_(self) -> str:  # of notebooks
        return html_table(self.columns, self.cells)


def html_of_motors(values: Mapping[str, np.ndarray]) -> str:
    """Table of constants (n,) by name: a column per motor; of many motors, of their quantiles."""
    count = len(next(iter(values.values())))
    columns = [str(motor) for motor in range(count)]
    if count > MAX_COLUMNS:
        columns = ["median", "5 %", "95 %"]
        values = {name: np.quantile(row, (0.5, 0.05, 0.95)) for name, row in values.items()}
    rows = []
    for name, row in values.items():
        rows.append([name, UNITS[name], *(f"{value:.3g}" for value in row)])
    return html_table(("constant", "unit", *columns), rows)


def named_constants(
    model: "GreyBox | LatentNetwork", z: np.ndarray, gains: np.ndarray | None
) -> dict[str, np.ndarray]:
    """(n,) constants by name [SI] of motors with latents (n, Z).

    ``gains`` are (2, n) or (2, 1), in the model's unit. Constants in units of a firmware are
    multiples of logged gains and have other names, such as ``kp_per_logged``. Motors of torque
    commands have no gains, and motors of velocity commands have kd alone. A network has a
    torque limit and, if it decodes one, an armature.
    """
    if not isinstance(model, GreyBox):
        values = {"torque_limit": np.full(len(z), model.torque_limit)}
        if model.has_armature:
            values["armature"] = model.armature(z)
        return values

    constants = model.constants(z)
    values = {name: constants[name] for name in parameters_of(model.terms)}
    if model.gain_unit == PHYSICAL_GAINS and gains is not None:
        values = with_logged_gains(values, *gains)
    if model.command_mode in ("velocity", "torque"):
        kd = values.pop("kp") * values.pop("kd_over_kp")
        if model.command_mode == "torque":
            return values
        is_in_si = not model.gain_unit or (model.gain_unit == PHYSICAL_GAINS and gains is not None)
        return {"kd" if is_in_si else f"kd{PER_LOGGED_GAIN}": kd} | values
    if model.gain_unit == PHYSICAL_GAINS and gains is not None:
        return values
    if not model.gain_unit:
        return values

    # with equal logged gains the ratio is a constant of the motor
    kd_is_logged = gains is None or not np.array_equal(*gains)
    multiples = ("kp", "kd_over_kp") if kd_is_logged else ("kp",)
    suffixes: dict[str, str] = {name: PER_LOGGED_GAIN for name in multiples}
    return {f"{name}{suffixes.get(name, '')}": value for name, value in values.items()}
