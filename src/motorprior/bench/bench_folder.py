"""Benches and their folders: a motor log, and bench.json with the settings of its motors."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from motorprior.actuator.distribution import distributions_of
from motorprior.actuator.families import FAMILIES, GEARED, TrueMotors
from motorprior.actuator.fleet import Fleet, load_robot_fleet
from motorprior.artifacts import read_json, write_json
from motorprior.bench.recording import BenchSchedule, bench_schedule, record, training_motors
from motorprior.bounds import MAX_SEED, TABLE, TEXT, integer, one_of, require_count, require_seed
from motorprior.exceptions import LogError
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.readers.motor_log_file import read_parquet, write_log
from motorprior.progress import SILENT, Progress
from motorprior.robots.load import as_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.schema import Schema
from motorprior.stage import description, is_finished, working

LOG = "log.parquet"
BENCH_JSON = "bench.json"
_MAX_COUNT = 2**31 - 1
_REMEDY = "record the bench again"
_SCHEMA = Schema(
    {
        "fleet": TEXT,
        "motor": TEXT,
        "robot": TEXT,
        "preset": TEXT,
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
        """Entries of bench.json and of a prior's provenance.

        The family is omitted if it is `GEARED`.
        """
        family = {}
        if self.fleet.family != GEARED.name:
            family["family"] = self.fleet.family
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


def bench_from_json(data: Any, where: str) -> BenchSettings:
    """Read what `BenchSettings.as_json` wrote.

    Raises ArtifactError for other keys, or a value out of range.
    """
    _SCHEMA.check(data, where)
    family = FAMILIES[data.get("family", GEARED.name)]
    distributions = distributions_of(data["parameters"], family, where, _REMEDY)
    fleet = Fleet(data["fleet"], data["motor"], data["robot"], distributions, family.name)
    return BenchSettings(fleet, data["preset"], data["motors"], data["steps"], data["seed"])


def read_bench(folder: Path) -> tuple[MotorLog, BenchSettings]:
    """The log and the settings of a bench folder.

    The log states robot and motor of the fleet. Raises LogError or ArtifactError for missing or
    inconsistent files.
    """
    log = read_parquet(folder / LOG)
    bench = bench_from_json(read_json(folder / BENCH_JSON), str(folder / BENCH_JSON))
    if (log.num_joints, log.num_rows) != (bench.motors, bench.steps):
        raise LogError(
            f"{log.num_joints} motors x {log.num_rows} rows; {BENCH_JSON} states "
            f"{bench.motors} x {bench.steps}",
            where=folder / LOG,
            remedy=_REMEDY,
        )

    fleet = bench.fleet
    log = replace(log, source=str(folder / LOG), robot=fleet.robot, motor=fleet.motor)
    return log, bench


def record_bench(
    robot: Robot | str | Path = DEFAULT_ROBOT,
    fleet: Fleet | str | Path | None = None,
    *,
    motors: int = 32,
    steps: int = 10_000,
    preset: str = "rollout",
    seed: int = 0,
    excitation: str | Path | None = None,
    out: str | Path | None = None,
    progress: Progress = SILENT,
) -> MotorLog:
    """Record physical motors of a fleet on a virtual dynamometer.

    Args:
        robot: for the loads of the motors; a name, the path of a .toml file, or the result of
            `load_robot`.
        fleet: population of the motors; the robot's own if not given.
        motors: number of motors.
        steps: samples per motor.
        preset: excitation: rollout (sinusoids, steps, gaits, impacts, 2 ms), adapt (the same,
            shorter), narrow (sinusoids on one load, 2 ms), paper (sinusoids on one load, 10 ms).
        seed: of the motors and their excitation; the log is deterministic.
        excitation: sine, steps, gait, impacts, creep, chirp or multisine, or a file of
            `fit_excitation` with its loads, played in every segment instead of the preset's.
        out: folder for log.parquet and bench.json; a repeated call reads them. Nothing is written
            without it.
        progress: where to report to.

    Returns:
        A log of joints motor_000, motor_001, … with torques and loads.

    Raises:
        ConfigError: a number out of range, an unknown preset, or a fleet of another robot.
        ArtifactError: a robot or a fleet that cannot be read, or ``out`` that cannot be written.
    """
    require_count("motors", motors)
    require_count("steps", steps, 2)
    require_seed(seed)
    robot = as_robot(robot)
    settings = BenchSettings(load_robot_fleet(robot, fleet), preset, motors, steps, seed)
    schedule = bench_schedule(preset).for_robot(robot)
    if excitation is not None:
        schedule = replace(schedule, excitations=(str(excitation),))
    if out is None:
        # `read_bench` states the robot of a bench with a folder
        return replace(_recorded(settings, schedule), robot=settings.fleet.robot)

    out = Path(out)
    files = [Path(name) for name in schedule.excitations if name.endswith(".safetensors")]
    inputs = [*robot.files, *files]
    stage = description("bench", settings.as_json(), inputs, asdict(schedule))
    if not is_finished(out, stage):
        title = f"bench {preset}: {motors} motors, {steps} steps"
        with working(out, stage), progress.start(title, 1) as task:
            (out / BENCH_JSON).unlink(missing_ok=True)  # it may be of other motors
            write_log(out / LOG, _recorded(settings, schedule))
            write_json(out / BENCH_JSON, settings.as_json())
            task.advance()
    return read_bench(out)[0]


def _recorded(settings: BenchSettings, schedule: BenchSchedule) -> MotorLog:
    """A new recording of the motors."""
    motors = settings.physical_motors()
    return record(motors, schedule, settings.steps, settings.seed, settings.fleet)
