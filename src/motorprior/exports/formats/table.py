"""A table of parameters per joint: armature, damping, frictionloss, kp, kv, forcerange, delay, with their spread."""

from __future__ import annotations

from pathlib import Path

from motorprior.exports.exporter import Exporter, Request
from motorprior.exports.plain_joint import DROPS, replayed, write_plain, write_table

TABLE = "motors.json"


def write(request: Request) -> list[Path]:
    """motors.json: samples, quantiles and correlations."""
    write_table(request, request.out / TABLE)
    return [request.out / TABLE]


EXPORTER = Exporter(
    "table", "table of parameters", DROPS, write,
    replay=lambda values, given: replayed(values, given, write_plain),
)  # fmt: skip
