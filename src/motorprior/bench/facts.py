"""A bench folder: the motor log, and the facts from which the same motors can be drawn again."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.actuator.true_motors import TrueMotors
from motorprior.artifacts import read_json
from motorprior.bench.families import FAMILIES, GEARED
from motorprior.bench.fleet import Fleet, fleet_of
from motorprior.bounds import LARGEST_SEED, require_count
from motorprior.exceptions import ArtifactError, ConfigError, LogError
from motorprior.logs.formats.parquet_io import read_parquet
from motorprior.logs.motor_log import MotorLog
from motorprior.schema import TABLE, TEXT, Schema, integer, one_of

MOST_MOTORS = 4096  # Largest number of motors of a bench
MOST_STEPS = 1_000_000  # Largest number of samples per motor
MOST_SAMPLES = 20_000_000  # Largest number of samples of all motors together, about 3 GB of memory during the recording
LOG, FACTS = "log.parquet", "bench.json"
MOTORS_STREAM = 11  # Tag of the random stream that draws a bench's motors
_AGAIN = "record the bench again"
# Keys of bench.json
_FACTS = Schema(
    {
        **dict.fromkeys(("fleet", "motor", "robot", "preset"), TEXT),
        "family": one_of(*FAMILIES),
        "parameters": TABLE,
        "motors": integer(1, MOST_MOTORS),
        "steps": integer(2, MOST_STEPS),
        "seed": integer(0, LARGEST_SEED),
    },
    _AGAIN,
    optional=frozenset({"family"}),
)


@dataclass(frozen=True)
class BenchFacts:
    """Facts of a bench from which its motors can be drawn again."""

    fleet: Fleet
    preset: str
    motors: int
    steps: int
    seed: int

    def physical_motors(self) -> TrueMotors:
        """The motors that stood on the bench."""
        return training_motors(self.fleet, self.motors, self.seed)

    def as_json(self) -> dict[str, Any]:
        """For bench.json and for a prior's provenance; a family is named where it is not `GEARED`."""
        family = {} if self.fleet.family == GEARED.name else {"family": self.fleet.family}
        return family | {
            "fleet": self.fleet.name,
            "motor": self.fleet.motor,
            "robot": self.fleet.robot,
            "parameters": self.fleet.summary(),
            "preset": self.preset,
            "motors": self.motors,
            "steps": self.steps,
            "seed": self.seed,
        }


def require_bench_size(motors: int, steps: int, steps_name: str = "steps") -> None:
    """Refuse a bench with no samples or too many.

    Args:
        motors: number of motors.
        steps: samples per motor.
        steps_name: name of ``steps`` in the error.

    Raises:
        ConfigError: names the argument and its bounds.
    """
    require_count("motors", motors, 1, MOST_MOTORS)
    require_count(steps_name, steps, 2, MOST_STEPS)
    if motors * steps > MOST_SAMPLES:
        raise ConfigError(
            f"motors {motors} times {steps_name} {steps} is above {MOST_SAMPLES} samples",
            remedy="give fewer motors or fewer steps",
            argument="motors",
        )


def training_motors(fleet: Fleet, motors: int, seed: int) -> TrueMotors:
    """The motors of a bench with this seed; held-out motors come from another random stream."""
    return fleet.sample(motors, np.random.default_rng([seed, MOTORS_STREAM]))


def facts_from_json(data: Any, where: str) -> BenchFacts:
    """Read what `BenchFacts.as_json` wrote.

    Raises:
        ArtifactError: unknown or missing keys, or facts from which no motors can be drawn.
    """
    if not isinstance(data, dict):
        raise ArtifactError("the facts of its bench are missing", where=where, remedy=_AGAIN)
    try:
        _FACTS.check(data, None)
        family = FAMILIES[data.get("family", GEARED.name)]
        fleet = fleet_of(data["fleet"], data["motor"], data["robot"], data["parameters"], "parameters", family)
        require_bench_size(data["motors"], data["steps"])
    except (ArtifactError, ConfigError) as error:
        problem = f"{error.where}: {error.problem}" if error.where else error.problem
        raise ArtifactError(
            f"the motors of its bench cannot be drawn again ({problem})", where=where, remedy=_AGAIN
        ) from error
    return BenchFacts(fleet, data["preset"], data["motors"], data["steps"], data["seed"])


def read_bench(folder: Path) -> tuple[MotorLog, BenchFacts]:
    """The log and the facts of a bench folder.

    Raises:
        LogError, ArtifactError: missing, truncated or inconsistent files.
    """
    log = read_parquet(folder / LOG)
    facts = facts_from_json(read_json(folder / FACTS), str(folder / FACTS))
    found, wanted = (log.num_joints, log.num_rows), (facts.motors, facts.steps)
    if found != wanted:
        raise LogError(
            f"{found[0]} motors x {found[1]} rows, {FACTS} says {wanted[0]} x {wanted[1]}", where=folder / LOG,
            remedy=_AGAIN,
        )  # fmt: skip
    return log, facts
