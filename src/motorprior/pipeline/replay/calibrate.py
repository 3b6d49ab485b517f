"""A fleet of physical motors fitted to logs of a real robot, by replaying their commands."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.fleet import write_fleet
from motorprior.bounds import require_count, require_seed
from motorprior.pipeline.motor_choice import load_robot_fleet
from motorprior.pipeline.prior_file import load_prior
from motorprior.pipeline.progress import SILENT, Progress
from motorprior.pipeline.replay.log_postures import PostureName, replayers_of
from motorprior.pipeline.replay.replay import read_logs
from motorprior.pipeline.stage import description, fleet_files, is_finished, read_results, working, write_results
from motorprior.results import Result, Results
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.transfer.calibration import Calibration, calibrate, calibrated_fleet, is_identifiable, searches
from motorprior.transfer.fleet_problem import FleetProblem
from motorprior.transfer.log_replay import Replayer

FLEET, PICTURE, PRIOR_BANDS = "fleet.toml", "calibration.png", "prior"


@dataclass(frozen=True)
class Calibrate:
    """Fit a fleet of physical motors to real logs of a robot."""

    logs: Path
    """A log, or a folder of logs: motor logs (.parquet), or files in the format of jietan/puppersim."""
    out: Path
    """Folder for fleet.toml, figures.json and calibration.png."""
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md)."""
    fleet: str | None = None
    """Initial fleet; constants that the logs do not identify stay near it. The robot's own if not given."""
    prior: Path | None = None
    """Prior identified on a bench of the fitted fleet: also plot its 50 and 90 % bands over the logs."""
    posture: PostureName = "auto"
    """Posture of the robot: standing on its feet, or suspended ("hung"). "auto" uses that in the log, or the one in
    which the fleet's central motor replays it clearly better."""
    starts: int = 3
    """Searches: the first from the fleet's centre, the others from samples of a Gaussian around it."""
    iterations: int = 6
    """Of each search, at most."""
    draws: int = 20
    """Samples of the robot's motors from the fitted fleet, for the bands."""
    seed: int = 0
    """Seed of the starts and the motors."""


def run_calibrate(config: Calibrate, progress: Progress = SILENT) -> Results:
    """Calibrate, or read the results if the folder holds them already.

    Raises:
        LogError, ArtifactError, ConfigError: a log, fleet, prior or setting that cannot be used.
    """
    for name in ("starts", "iterations", "draws"):
        require_count(name, getattr(config, name))
    require_seed(config.seed)
    robot = load_robot(config.robot)
    fleet, prior = load_robot_fleet(robot, config.fleet), config.prior and load_prior(config.prior, robot)
    folder, prepared = read_logs(config.logs, robot)
    files = [*folder.files, *robot.files]
    settings = {name: value for name, value in asdict(config).items() if name != "prior"}
    wanted = description("calibrate", settings, [*fleet_files(robot, config.fleet), *files])
    ready = cache(lambda: replayers_of(folder.logs, prepared, robot, fleet, config.posture, progress))
    if not is_finished(config.out, wanted):
        with working(config.out, wanted):
            _calibrate(config, FleetProblem(fleet, robot, ready()), progress)
    if config.prior is None or prior is None:
        return read_results(config.out)
    bands = config.out / PRIOR_BANDS
    wanted = description("calibrate", settings, [config.prior, config.out / FLEET, *files])
    if not is_finished(bands, wanted):
        with working(bands, wanted):
            _draw_prior(config, bands, ready(), robot, prior, progress)
    return read_results(config.out) + read_results(bands)


def _draw_prior(
    config: Calibrate, folder: Path, replayers: dict[str, Replayer], robot: Robot, prior: MotorPrior, progress: Progress
) -> None:
    """The bands of a prior and of the fitted fleet: picture and coverage."""
    from motorprior.pipeline.replay.calibration_bands import draw_prior_bands

    fleet = load_robot_fleet(robot, str(config.out / FLEET))
    with progress.start(f"{config.draws} draws of the prior", len(replayers)) as task:
        picture, covered = draw_prior_bands(replayers, robot, fleet, prior, config.draws, config.seed, task)
    (folder / PICTURE).write_bytes(picture)
    write_results(folder, covered)


def _calibrate(config: Calibrate, problem: FleetProblem, progress: Progress) -> None:
    names = list(problem.replayers)
    with progress.start(f"calibrate on {len(names)} real logs", searches(len(names), config.starts)) as task:
        found = calibrate(problem, config.starts, config.iterations, config.seed, task.advance)
    fleet = calibrated_fleet(problem, found)
    heading = f"Fitted by `motorprior calibrate` to the logs {', '.join(names)}; spread is between motors."
    write_fleet(config.out / FLEET, fleet, _sources(problem, found), heading)
    from motorprior.pipeline.replay.calibration_bands import draw_bands  # imports matplotlib

    with progress.start(f"{config.draws} draws of the fleet", len(names)) as task:
        picture, covered = draw_bands(problem, found.center, fleet, config.draws, config.seed, task)
    (config.out / PICTURE).write_bytes(picture)
    write_results(config.out, _errors(problem, found) + covered + _constants(problem, found) + _motors(problem, found))


def _sources(problem: FleetProblem, found: Calibration) -> dict[str, str]:
    """Source of each number."""
    sources = dict.fromkeys(problem.fleet.parameters, f"as in fleet {problem.fleet.name}")
    for name in problem.logged & sources.keys():
        sources[name] += "; the logs contain the gains"
    logs = ", ".join(problem.replayers)
    for unknown, error in zip(problem.unknowns, found.error, strict=True):
        result = "identified" if is_identifiable(unknown, error) else f"not identified, near fleet {problem.fleet.name}"
        spread = "" if unknown.name in found.motors.spread else f"; spread as in fleet {problem.fleet.name}"
        sources[unknown.name] = f"{result}: replay of the logs {logs}{spread}"
    return sources


def _errors(problem: FleetProblem, found: Calibration) -> Results:
    """Joint RMSE of every log and their mean: initial, fitted, fitted without that log, with a motor per joint."""
    rows = []
    for name in problem.replayers:
        values = {
            "start": problem.rmse(name, problem.prior.mean),
            "center": problem.rmse(name, found.center),
            "per_motor": problem.rmse(name, found.center, found.motors.offsets),
        }
        if found.left_out:
            values["left_out"] = problem.rmse(name, found.left_out[name])
            values["per_motor_left_out"] = problem.rmse(name, found.left_out[name], found.motors.left_out[name])
        rows += [Result("calibrate_rmse", "rad", v, model, log=name) for model, v in values.items()]
    results = Results.of(rows)
    means = [Result("calibrate_rmse", "rad", results.mean(model=m), m) for m in results.distinct("model")]
    return results + Results.of(means)


def _constants(problem: FleetProblem, found: Calibration) -> Results:
    """Fitted value and standard errors of every constant, and all optima; of logarithms if lognormal."""
    rows, fleet = [], calibrated_fleet(problem, found)
    for unknown, x, error in zip(problem.unknowns, found.center, found.error, strict=True):
        unit, name = problem.unit(unknown), unknown.name
        share = "1" if unknown.is_log else unit
        rows += [
            Result("calibrate_center", unit, unknown.value(x), part=name),
            Result("calibrate_start", unit, unknown.value(unknown.mean), part=name),
            Result("calibrate_error", share, float(error), part=name),
            Result("calibrate_belief", share, unknown.deviation, part=name),
            Result("calibrate_spread", share, fleet.parameters[name].values["spread"], part=name),
            Result("calibrate_identified", "1", float(is_identifiable(unknown, error)), part=name),
        ]
    for place, optimum in enumerate(found.optima, start=1):
        rows.append(Result("calibrate_cost", "1", optimum.cost, model=f"optimum_{place}"))
        for unknown, x in zip(problem.unknowns, optimum.x, strict=True):
            value, model = unknown.value(x), f"optimum_{place}"
            rows.append(Result("calibrate_optimum", problem.unit(unknown), value, model, part=unknown.name))
    return Results.of(rows)


def _motors(problem: FleetProblem, found: Calibration) -> Results:
    """Constants that differ between motors, per joint that moved; `model` is the constant."""
    rows, each_motor = [], found.motors.offsets.reshape(len(problem.joints), len(problem.differing))
    for joint, offsets in zip(problem.joints, each_motor, strict=True):
        for place, offset in zip(problem.differing, offsets, strict=True):
            unknown, part = problem.unknowns[place], problem.robot.joint_names[joint]
            value = unknown.value(found.center[place] + offset)
            rows.append(Result("calibrate_motor", problem.unit(unknown), value, unknown.name, part=part))
    return Results.of(rows)
