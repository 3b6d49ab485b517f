"""Tables of motor constants: unit, median, range between units, and whether the logs identify them."""

import html
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from motorprior.actuator.geared_motor_step import PER_LOGGED, with_logged_gains
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.optional_terms import CONSTANTS
from motorprior.logs.motor_log import PHYSICAL_GAINS
from motorprior.texts import text_table

if TYPE_CHECKING:
    from motorprior.actuator.latent import LatentNetwork

NUM_SAMPLES = 1000  # samples for the quantiles of a distribution
_PER_UNIT = "of the firmware's gain"
UNITS = {
    "kp": "N·m/rad", "kd_over_kp": "s", "velocity_filter": "s", "delay": "s", "torque_limit": "N·m",
    "armature": "kg·m²", "coulomb": "N·m", "stribeck_torque": "N·m", "viscous_damping": "N·m·s/rad",
    "load_friction": "1", "gear_stiffness": "N·m/rad", "backlash": "rad", "gear_damping": "N·m·s/rad",
    "encoder_zero": "rad", f"kp{PER_LOGGED}": f"N·m/rad per unit {_PER_UNIT}",
    f"kd_over_kp{PER_LOGGED}": f"s per unit {_PER_UNIT}", **{each.name: each.unit for each in CONSTANTS.values()},
}  # fmt: skip
COLUMNS = ("constant", "unit", "median", "5 %", "95 %", "identifiable")
_PICTURES = "motorprior.report.plots"  # a layer above: imported only to draw a picture


class ConstantSummary(NamedTuple):
    """A constant over the units of a fleet."""

    name: str
    unit: str
    median: float
    low: float  # 5 % of the units are below
    high: float  # 5 % are above
    identifiable: bool | None  # whether the logs identify it; None if unknown

    def __str__(self) -> str:
        return f"{self.name}: {self.median:.3g} {self.unit}, 5 to 95 % of the units {self.low:.3g} to {self.high:.3g}"


@dataclass(frozen=True)
class Constants:
    """A row per constant; prints as a table."""

    rows: tuple[ConstantSummary, ...]
    columns: tuple[str, ...] = COLUMNS  # titles

    @classmethod
    def of(
        cls,
        values: Mapping[str, np.ndarray],
        units: Mapping[str, str],
        identified: Mapping[str, bool | None],
    ) -> "Constants":
        """Quantiles of samples (n,) by name; constants without ``identified`` are unknown."""
        found = []
        for name, samples in values.items():
            low, median, high = np.quantile(samples, [0.05, 0.5, 0.95]).tolist()
            found.append(
                ConstantSummary(name, units[name], median, low, high, identified.get(name))
            )
        return cls(tuple(found))

    def __iter__(self) -> Iterator[ConstantSummary]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, name: str) -> ConstantSummary:
        return {row.name: row for row in self.rows}[name]

    @property
    def cells(self) -> list[list[str]]:
        """Texts of the rows, in the order of the columns."""
        words = {True: "yes", False: "no", None: "unknown"}
        return [
            [row.name, row.unit, *(f"{value:.3g}" for value in row[2:5]), words[row.identifiable]]
            for row in self.rows
        ]

    def __str__(self) -> str:
        return text_table(self.columns, self.cells)

    def _repr_html_(self) -> str:  # of notebooks
        return f"<pre>{html.escape(str(self))}</pre>"


def named_constants(
    model: "GreyBox | LatentNetwork", z: np.ndarray, gains: np.ndarray | None
) -> dict[str, np.ndarray]:
    """(n,) constants by name [SI] of motors with latents (n, Z), at gains (2, n) or (2, 1) in the model's unit.

    Those in units of a firmware are multiples with names of their own, such as ``kp_per_logged``. A
    network has a torque limit and, if it decodes one, an armature.
    """
    if not isinstance(model, GreyBox):
        limit = {"torque_limit": np.full(len(z), model.torque_limit)}
        return limit | ({"armature": model.armature(z)} if model.has_armature else {})
    values = model.constants(z)
    if model.gain_unit == PHYSICAL_GAINS and gains is not None:
        return with_logged_gains(values, *gains)
    if not model.gain_unit:
        return values
    kd_is_logged = gains is None or not np.array_equal(*gains)  # else the ratio is one of the motor
    multiples = ("kp", "kd_over_kp") if kd_is_logged else ("kp",)
    return {
        f"{name}{PER_LOGGED}" if name in multiples else name: value
        for name, value in values.items()
    }


def plot_response(motors: Any, title: str, period: float) -> Any:
    """A figure of the responses of motors to a step; see `report.plots.step_responses`."""
    return import_module(_PICTURES).step_responses(motors, title, period)
