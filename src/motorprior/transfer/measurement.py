"""One measured number and what it is of: a row of a tidy table."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Measurement:
    """One row.

    Attributes:
        quantity: what was measured.
        unit: of the value; "1" for a share.
        model: what was trained or fitted.
        motor_set: the motors it was measured on.
        seed: number of the policy among those of its model.
        value: the number.
    """

    quantity: str
    unit: str
    model: str
    motor_set: str
    seed: int
    value: float
