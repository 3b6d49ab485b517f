"""The user's MJCF with a plain joint and a position actuator per motor."""

from __future__ import annotations

from pathlib import Path

from motorprior.exports.exporter import Exporter, Request
from motorprior.exports.plain_joint import DROPS, replayed, write_plain, write_variants


def write(request: Request) -> list[Path]:
    """K variants of the model, and motors.json."""
    return write_variants(request, write_plain)


EXPORTER = Exporter(
    "mjcf", "MJCF, one joint per motor", DROPS, write,
    replay=lambda values, given: replayed(values, given, write_plain), needs_model=True,
)  # fmt: skip
