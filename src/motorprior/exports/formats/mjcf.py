"""The user's MJCF with a plain joint and a position actuator per motor."""

from functools import partial

from motorprior.exports.exporter import Exporter
from motorprior.exports.plain_joint import DROPS, replayed, write_plain, write_variants

EXPORTER = Exporter(
    "mjcf", DROPS, partial(write_variants, write=write_plain), partial(replayed, write=write_plain), needs_model=True
)
