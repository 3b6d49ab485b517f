"""A fleet of physical motors fitted to logs of a real robot, by replaying their commands."""

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from motorprior.actuator.fleet import Fleet, fleet_files, load_robot_fleet, write_fleet
from motorprior.bounds import require_count, require_seed
from motorprior.evaluation.bands import band
from motorprior.evaluation.free_runs import Trace
from motorprior.progress import SILENT, Progress
from motorprior.results import Result, Results, read_results, write_results
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.stage import description, is_finished, working
from motorprior.studies.calibration import Calibration, FleetProblem, calibrate, calibrated_fleet
from motorprior.studies.log_replay import (
    PostureName,
    motors_with_logged_gains,
    read_logs,
    replayers_of,
)

FLEET = "fleet.toml"
PICTURE = "calibration.png"


@dataclass(frozen=True)
class Calibrate:
    """Fit a fleet of physical motors to real logs of a robot."""

    logs: Path
    """A log, or a folder of logs: motor logs (.parquet), or files in the format of
    jietan/puppersim."""
    out: Path
    """Folder for fleet.toml, figures.json and calibration.png."""
    robot: str = DEFAULT_ROBOT
    """Robot: name of a shipped robot, or the .toml file of your robot (docs/your-robot.md)."""
    fleet: str | None = None
    """Initial fleet, from which constants that the logs do not identify differ little; the robot's
    fleet if not given."""
    posture: PostureName = "auto"
    """Posture of the robot: standing, or suspended in the air. "auto" uses the posture that the log
    states; else the posture in which the fleet's central motor replays the log clearly better."""
    starts: int = 3
    """Number of searches. The first starts from the fleet's centre, the others from samples of a
    Gaussian around the centre."""
    iterations: int = 6
    """Maximum iterations of each search."""
    samples: int = 20
    """Number of sets of motors, sampled from the fitted fleet, that give the bands of angles."""
    seed: int = 0
    """Seed of the searches' starts and of the sampled motors."""


def run_calibrate(config: Calibrate, progress: Progress = SILENT) -> Results:
    """Calibrate, or read the results of the finished stage.

    Raises an error for a log, a fleet or a setting that cannot be used.
    """
    for name in ("starts", "iterations", "samples"):
        require_count(name, getattr(config, name))
    require_seed(config.seed)

    robot = load_robot(config.robot)
    fleet = load_robot_fleet(robot, config.fleet)
    folder = read_logs(config.logs, robot)
    inputs = [*fleet_files(robot, config.fleet), *folder.files, *robot.files]
    stage = description("calibrate", asdict(config), inputs)
    if is_finished(config.out, stage):
        return read_results(config.out)

    with working(config.out, stage):
        replayers = replayers_of(folder.logs, robot, fleet, config.posture, progress.note)
        problem = FleetProblem(fleet, robot, replayers)
        calibration = calibrate(problem, config.starts, config.iterations, config.seed, progress)
        fitted = calibrated_fleet(problem, calibration)

        logs = ", ".join(replayers)
        heading = f"Fitted by `motorprior calibrate` to the logs {logs}; spread is between motors."
        write_fleet(config.out / FLEET, fitted, _sources(problem, calibration), heading)

        coverage = _coverage(config, problem, calibration, fitted, progress)
        errors = _errors(problem, calibration)
        constants = _constants(problem, calibration, fitted)
        write_results(config.out, Results([*errors, *coverage, *constants]))
    return read_results(config.out)


def _coverage(
    config: Calibrate,
    problem: FleetProblem,
    calibration: Calibration,
    fleet: Fleet,
    progress: Progress,
) -> list[Result]:
    """Share of the measured angles in the 90 % bands of the fitted fleet.

    Plots one joint of each log.
    """
    # here, since they import matplotlib
    from motorprior.report.plots import draw_traces
    from motorprior.report.plots_style import png_bytes

    rng = np.random.default_rng(config.seed)
    traces = []
    coverage = []
    with progress.start(f"{config.samples} samples of the fleet", len(problem.replayers)) as task:
        for name, replayer in problem.replayers.items():
            log = replayer.log
            motors = [
                motors_with_logged_gains(fleet.sample(log.num_joints, rng), log)
                for _ in range(config.samples)
            ]
            samples = [replayer.joint_pos(sample.actuator()) for sample in motors]
            low, high = band(np.array(samples), 90)
            is_inside = (log.joint_pos >= low) & (log.joint_pos <= high)
            share = float(is_inside[replayer.compared][:, replayer.excited].mean())
            coverage.append(Result("calibrate_coverage90", "1", share, log=name))

            central = replayer.joint_pos(problem.actuator(name, calibration.center))
            joint = replayer.excited[-1]
            trace = Trace(
                log=name,
                joint=log.joint_names[joint],
                time=log.time,
                target=log.position_target[:, joint],
                measured=log.joint_pos[:, joint],
                models={
                    "central motor": central[:, joint],
                    "5 %": low[:, joint],
                    "95 %": high[:, joint],
                },
            )
            traces.append(trace)
            task.advance()
    (config.out / PICTURE).write_bytes(png_bytes(draw_traces(traces)))
    return coverage


def _sources(problem: FleetProblem, calibration: Calibration) -> dict[str, str]:
    """Source of each constant in the fitted fleet, for its file."""
    logs = ", ".join(problem.replayers)
    sources = dict.fromkeys(problem.fleet.parameters, f"as in fleet {problem.fleet.name}")
    for name in problem.logged & sources.keys():
        sources[name] += "; the logs contain the gains"
    for parameter, error in zip(problem.parameters, calibration.error, strict=True):
        result = f"not identified, near {problem.fleet.name}"
        if parameter.is_identifiable(error):
            result = "identified"
        sources[parameter.name] = f"{result}: replay of the logs {logs}"
    return sources


def _errors(problem: FleetProblem, calibration: Calibration) -> list[Result]:
    """Joint RMSE of every log and the mean over the logs.

    The models are the initial centre, the fitted one, and the one that is fitted without this log,
    each of the last two also with a motor per joint.
    """
    rows: list[Result] = []
    for name in problem.replayers:
        # centre, and offsets of single motors
        fits = {
            "start": (problem.mean, None),
            "center": (calibration.center, None),
            "per_motor": (calibration.center, calibration.offsets),
        }
        if calibration.left_out:
            center, offsets = calibration.left_out[name]
            fits["left_out"] = (center, None)
            fits["per_motor_left_out"] = (center, offsets)
        for model, (center, offsets) in fits.items():
            rmse = problem.rmse(name, center, offsets)
            rows.append(Result("calibrate_rmse", "rad", rmse, model, log=name))

    results = Results(rows)
    for model in results.distinct("model"):
        rows.append(Result("calibrate_rmse", "rad", results.mean(model=model), model))
    return rows


def _constants(problem: FleetProblem, calibration: Calibration, fleet: Fleet) -> list[Result]:
    """Fitted value and standard errors of every constant; errors of the logarithm if lognormal."""
    rows = []
    for parameter, x, error in zip(
        problem.parameters, calibration.center, calibration.error, strict=True
    ):
        share = "1" if parameter.is_log else parameter.unit
        values = {
            "center": (parameter.unit, parameter.value(x)),
            "start": (parameter.unit, parameter.value(parameter.mean)),
            "error": (share, error),
            "prior_std": (share, parameter.deviation),
            "spread": (share, fleet.parameters[parameter.name].values["spread"]),
            "identified": ("1", parameter.is_identifiable(error)),
        }
        for key, (unit, value) in values.items():
            rows.append(Result(f"calibrate_{key}", unit, float(value), part=parameter.name))
    return rows
