"""A bench folder: the motor log, and bench.json with the settings that reproduce its motors."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from motorprior.artifacts import read_json
from motorprior.bench.families import FAMILIES, GEARED, TrueMotors
from motorprior.bench.fleet import Fleet, distributions_of
from motorprior.bench.recording import training_motors
from motorprior.bounds import MAX_SEED, TABLE, TEXT, integer, one_of
from motorprior.exceptions import LogError
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.readers.motor_log_file import read_parquet
from motorprior.schema import Schema

LOG, BENCH_JSON = "log.parquet", "bench.json"
_MAX_COUNT = 2**31 - 1
_REMEDY = "record the bench again"
_SCHEMA = Schema(
    {
        **dict.fromkeys(("fleet", "motor", "robot", "preset"), TEXT),
        "family": one_of(*FAMILIES),
        "parameters": TABLE,
        "motors": integer(1, _MAX_COUNT),
        "steps": integer(2, _MAX_COUNT),
        "seed": integer(0, MAX_SEED),
    },
    _REMEDY,
    optional=frozenset({"family"}),
    name="bench",
)


@dataclass(frozen=True)
class BenchSettings:
    """Settings of a bench, which reproduce its motors."""

    fleet: Fleet
    preset: str
    motors: int
    steps: int
    seed: int

    def physical_motors(self) -> TrueMotors:
        """The motors on the bench."""
        return training_motors(self.fleet, self.motors, self.seed)

    def as_json(self) -> dict[str, Any]:
        """Entries of bench.json and of a prior's provenance; the family is omitted if it is `GEARED`."""
        family = {} if self.fleet.family == GEARED.name else {"family": self.fleet.family}
        return family | {
            "fleet": self.fleet.name, "motor": self.fleet.motor, "robot": self.fleet.robot,
            "parameters": self.fleet.summary(),
            "preset": self.preset, "motors": self.motors, "steps": self.steps, "seed": self.seed,
        }  # fmt: skip


def bench_from_json(data: Any, where: str) -> BenchSettings:
    """Read what `BenchSettings.as_json` wrote.

    Raises:
        ArtifactError: unknown or missing keys, or a value out of range.
    """
    _SCHEMA.check(data, where)
    family = FAMILIES[data.get("family", GEARED.name)]
    distributions = distributions_of(data["parameters"], family, where, _REMEDY)
    fleet = Fleet(data["fleet"], data["motor"], data["robot"], distributions, family.name)
    return BenchSettings(fleet, data["preset"], data["motors"], data["steps"], data["seed"])


def read_bench(folder: Path) -> tuple[MotorLog, BenchSettings]:
    """The log and the settings of a bench folder.

    Raises:
        LogError, ArtifactError: missing, truncated or inconsistent files.
    """
    log = read_parquet(folder / LOG)
    bench = bench_from_json(read_json(folder / BENCH_JSON), str(folder / BENCH_JSON))
    if (log.num_joints, log.num_rows) != (bench.motors, bench.steps):
        raise LogError(
            f"{log.num_joints} motors x {log.num_rows} rows; {BENCH_JSON} states {bench.motors} x {bench.steps}",
            where=folder / LOG, remedy=_REMEDY,
        )  # fmt: skip
    return log, bench
