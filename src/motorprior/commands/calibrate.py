"""A fleet of physical motors fitted to logs of a real robot, by replaying their commands."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from motorprior.bench.fleet import Fleet, fleet_files, load_robot_fleet, write_fleet
from motorprior.bounds import require_count, require_seed
from motorprior.commands.replay import plotted_joint, read_logs
from motorprior.progress import SILENT, Progress, Task
from motorprior.results import Result, Results
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.stage import description, is_finished, read_results, working, write_results
from motorprior.studies.calibration import Calibration, calibrate, calibrated_fleet, is_identifiable, num_searches
from motorprior.studies.fleet_problem import FleetProblem
from motorprior.studies.log_replay import with_logged_gains
from motorprior.studies.posture import PostureName, replayers_of

FLEET, PICTURE = "fleet.toml", "calibration.png"


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
    posture: PostureName = "auto"
    """Posture of the robot: standing, or suspended in the air. "auto" uses that in the log, or the one in
    which the fleet's central motor replays it clearly better."""
    starts: int = 3
    """Searches: the first from the fleet's centre, the others from samples of a Gaussian around it."""
    iterations: int = 6
    """Maximum of each search."""
    draws: int = 20
    """Samples of the robot's motors from the fitted fleet, for the bands."""
    seed: int = 0
    """Seed of the starts and the motors."""


def run_calibrate(config: Calibrate, progress: Progress = SILENT) -> Results:
    """Calibrate, or read the results of the finished stage.

    Raises:
        LogError, ArtifactError, ConfigError: a log, fleet or setting that cannot be used.
    """
    for name in ("starts", "iterations", "draws"):
        require_count(name, getattr(config, name))
    require_seed(config.seed)
    robot = load_robot(config.robot)
    fleet = load_robot_fleet(robot, config.fleet)
    folder, prepared = read_logs(config.logs, robot)
    inputs = [*fleet_files(robot, config.fleet), *folder.files, *robot.files]
    wanted = description("calibrate", asdict(config), inputs)
    if not is_finished(config.out, wanted):
        with working(config.out, wanted):
            replayers = replayers_of(folder.logs, prepared, robot, fleet, config.posture, progress.note)
            _calibrate(config, FleetProblem(fleet, robot, replayers), progress)
    return read_results(config.out)


def _calibrate(config: Calibrate, problem: FleetProblem, progress: Progress) -> None:
    names = list(problem.replayers)
    with progress.start(f"calibrate on {len(names)} real logs", num_searches(len(names), config.starts)) as task:
        found = calibrate(problem, config.starts, config.iterations, config.seed, task.advance)
    fleet = calibrated_fleet(problem, found)
    heading = f"Fitted by `motorprior calibrate` to the logs {', '.join(names)}; spread is between motors."
    write_fleet(config.out / FLEET, fleet, _sources(problem, found), heading)
    with progress.start(f"{config.draws} draws of the fleet", len(names)) as task:
        picture, covered = draw_bands(problem, found.center, fleet, config.draws, config.seed, task)
    (config.out / PICTURE).write_bytes(picture)
    write_results(config.out, _errors(problem, found) + covered + _constants(problem, found) + _motors(problem, found))


def draw_bands(
    problem: FleetProblem, center: np.ndarray, fleet: Fleet, draws: int, seed: int, task: Task
) -> tuple[bytes, Results]:
    """Replay every log on samples of a fleet.

    Args:
        problem: logs and robot.
        center: (unknowns,) of the fit.
        fleet: the fitted one.
        draws: samples of the robot's motors.
        seed: of the samples.
        task: advances with every log.

    Returns:
        A PNG with the 90 % band of the plotted joint of every log, and per log the share of the measured angles of
        excited joints within the bands.
    """
    from motorprior.report.plots_motor import LogPanel, calibration  # here: they import matplotlib
    from motorprior.report.plots_style import png_bytes

    rng, panels, covered, count = np.random.default_rng(seed), [], [], problem.robot.num_joints
    for name, replayer in problem.replayers.items():
        log = replayer.prepared
        motors = [with_logged_gains(fleet.sample(count, rng), log).actuator() for _ in range(draws)]
        low, high = np.quantile([replayer.joint_pos(each) for each in motors], [0.05, 0.95], axis=0)
        inside = ((log.joint_pos >= low) & (log.joint_pos <= high))[replayer.compared][:, replayer.excited]
        covered.append(Result("calibrate_coverage90", "1", float(inside.mean()), log=name))
        joint = plotted_joint(problem.robot, log)
        central = replayer.joint_pos(problem.actuator(name, center))
        columns = (each[:, joint] for each in (log.position_target, log.joint_pos, central, low, high))
        panels.append(LogPanel(f"log {name}, {log.joint_names[joint]}", log.time, *columns))
        task.advance()
    return png_bytes(calibration(panels)), Results.of(covered)


def _sources(problem: FleetProblem, found: Calibration) -> dict[str, str]:
    """Source of each constant, for the fleet's file."""
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
