"""Benches, and their folders: the motor log, and bench.json with the settings that reproduce its motors."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from motorprior.actuator.families import FAMILIES, GEARED, TrueMotors
from motorprior.actuator.fleet import Fleet, distributions_of, load_robot_fleet
from motorprior.artifacts import read_json, write_json
from motorprior.bench.recording import bench_preset, record, training_motors
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
    """Read what `BenchSettings.as_json` wrote; ArtifactError for other keys, or a value out of range."""
    _SCHEMA.check(data, where)
    family = FAMILIES[data.get("family", GEARED.name)]
    distributions = distributions_of(data["parameters"], family, where, _REMEDY)
    fleet = Fleet(data["fleet"], data["motor"], data["robot"], distributions, family.name)
    return BenchSettings(fleet, data["preset"], data["motors"], data["steps"], data["seed"])


def read_bench(folder: Path) -> tuple[MotorLog, BenchSettings]:
    """The log and the settings of a bench folder; LogError or ArtifactError for missing or inconsistent files.

    Robot and motor of the log are those of the fleet.
    """
    log = read_parquet(folder / LOG)
    bench = bench_from_json(read_json(folder / BENCH_JSON), str(folder / BENCH_JSON))
    if (log.num_joints, log.num_rows) != (bench.motors, bench.steps):
        stated = f"{BENCH_JSON} states {bench.motors} x {bench.steps}"
        problem = f"{log.num_joints} motors x {log.num_rows} rows; {stated}"
        raise LogError(problem, where=folder / LOG, remedy=_REMEDY)
    return replace(
        log, source=str(folder / LOG), robot=bench.fleet.robot, motor=bench.fleet.motor
    ), bench


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
        excitation: a name of `EXCITATIONS`, or a file of `fit_excitation` with its loads, played in
            every segment instead of the preset's.
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
    population = load_robot_fleet(robot, fleet)
    chosen = bench_preset(preset).for_robot(robot)
    chosen = chosen if excitation is None else replace(chosen, kinds=(str(excitation),))
    settings = BenchSettings(population, preset, motors, steps, seed)
    if out is None:
        log = record(settings.physical_motors(), chosen, steps, seed, population)
        return replace(log, robot=population.robot)  # no bench.json names it
    out = Path(out)
    played = [Path(name) for name in chosen.kinds if name.endswith(".safetensors")]
    wanted = description("bench", settings.as_json(), [*robot.files, *played], asdict(chosen))
    if not is_finished(out, wanted):
        title = f"bench {preset}: {motors} motors, {steps} steps"
        with working(out, wanted), progress.start(title, 1) as task:
            (out / BENCH_JSON).unlink(missing_ok=True)  # it may be of other motors
            write_log(
                out / LOG, record(settings.physical_motors(), chosen, steps, seed, population)
            )
            write_json(out / BENCH_JSON, settings.as_json())
            task.advance()
    return read_bench(out)[0]
