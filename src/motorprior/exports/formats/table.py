"""A table of parameters per joint: armature, damping, frictionloss, kp, kv, forcerange, delay, with their spread."""

from functools import partial

from motorprior.exports.exporter import Exporter
from motorprior.exports.plain_joint import DROPS, replayed, write_plain, write_table

EXPORTER = Exporter("table", DROPS, write_table, partial(replayed, write=write_plain))
