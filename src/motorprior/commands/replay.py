"""Comparison of real logs of a robot with simulated motors."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import write_tensors
from motorprior.bench.fleet import Fleet, fleet_files, load_robot_fleet, nominal_pd
from motorprior.bounds import require_count, require_seed
from motorprior.exceptions import LogError
from motorprior.identification.prior_file import gains_for, load_prior
from motorprior.logs.doctor.checks import check_log
from motorprior.logs.doctor.excitation import excited_joints
from motorprior.logs.log_folder import LogFolder, read_log_folder
from motorprior.logs.motor_log import MotorLog
from motorprior.progress import SILENT, Progress, Task
from motorprior.results import Result, Results
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.stage import description, is_finished, read_results, working, write_results
from motorprior.studies.log_replay import LogReplay, Replayer, prepare, with_logged_gains
from motorprior.studies.posture import PostureName, replayers_of

TRACES = "traces.safetensors"


@dataclass(frozen=True)
class Replay:
    """Replay the commands of real logs on simulated motors and compare the joint angles."""

    logs: Path
    """A log, or a folder of logs: motor logs (.parquet), or files in the format of jietan/puppersim."""
    prior: Path
    """Prior to sample."""
    out: Path
    """Folder for figures.json and the traces of the report."""
    fleet: str | None = None
    """Fleet of the central motor and of the ideal PD's gains; gains in the log [N·m/rad] replace both."""
    draws: int = 20
    """Samples of the robot's motors from the prior."""
    seed: int = 0
    """Draws the motors."""
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md)."""
    posture: PostureName = "auto"
    """Posture of the robot: standing, or suspended in the air. "auto" uses that in the log, or the one in
    which the fleet's central motor replays it clearly better."""


def run_replay(config: Replay, progress: Progress = SILENT) -> Results:
    """Check and replay, or read the results of the finished stage.

    Raises:
        LogError, ArtifactError, ConfigError: a log, prior, fleet or setting that cannot be used.
    """
    require_count("draws", config.draws)
    require_seed(config.seed)
    robot = load_robot(config.robot)
    load_robot_fleet(robot, config.fleet)
    folder, prepared = read_logs(config.logs, robot)
    for name, log in folder.logs.items():
        for finding in check_log(log, robot.limits).findings:
            if finding.severity != "info":
                progress.note(f"log {name}: {finding.severity}: {finding.message}")
    prior = load_prior(config.prior, robot)
    inputs = [config.prior, *fleet_files(robot, config.fleet), *folder.files, *robot.files]
    wanted = description("replay", asdict(config), inputs)
    if not is_finished(config.out, wanted):
        with working(config.out, wanted):
            _replay_all(config, robot, folder.logs, prepared, prior, progress)
    return read_results(config.out)


def read_logs(path: Path, robot: Robot) -> tuple[LogFolder, dict[str, MotorLog]]:
    """A log, or all logs of a folder; and by name without repeated measurements.

    Raises:
        LogError: a log that cannot be read or replayed.
    """
    try:
        folder = read_log_folder(path, robot)
    except LogError as error:
        if error.argument != "columns":
            raise
        remedy = "import the logs with `motorprior logs import --columns` (docs/your-motors.md), and give the new files"
        raise LogError(error.problem, where=error.where, remedy=remedy) from error
    return folder, {name: prepare(log, robot, f"{path}, log {name}") for name, log in folder.logs.items()}


def _replay_all(
    config: Replay,
    robot: Robot,
    logs: dict[str, MotorLog],
    prepared: dict[str, MotorLog],
    prior: MotorPrior,
    progress: Progress,
) -> None:
    measured = Results()
    traces: dict[str, np.ndarray] = {}
    fleet = load_robot_fleet(robot, config.fleet)
    replayers = replayers_of(logs, prepared, robot, fleet, config.posture, progress.note)
    with progress.start(f"replay of {len(logs)} real logs", len(logs) * (2 + 2 * config.draws)) as task:
        for name in logs:
            results = _replay_models(config, robot, fleet, replayers[name], prior, task)
            measured += _errors(name, prepared[name], results)
            traces |= _log_traces(name, robot, prepared[name], results)
    write_results(config.out, measured)
    write_tensors(
        config.out / TRACES,
        traces,
        {"logs": sorted(logs), "prior": prior.preset, "joint_names": list(robot.joint_names)},
    )


def _replay_models(
    config: Replay, robot: Robot, fleet: Fleet, replayer: Replayer, prior: MotorPrior, task: Task
) -> dict[str, list[LogReplay]]:
    rng = np.random.default_rng(config.seed)
    count, log = robot.num_joints, replayer.prepared
    drawn = [with_logged_gains(fleet.sample(count, rng), log) for _ in range(config.draws)]
    models: dict[str, list[Actuator]] = {
        "ideal_pd": [with_logged_gains(nominal_pd(fleet, count), log)],
        "physical": [with_logged_gains(fleet.center(count), log).actuator()],
        "physical_draws": [motors.actuator() for motors in drawn],
        prior.preset: [prior.sample(count, rng, gains_for(prior, robot, log)) for _ in range(config.draws)],
    }
    results: dict[str, list[LogReplay]] = {}
    for name, actuators in models.items():
        for actuator in actuators:
            results.setdefault(name, []).append(replayer.run(actuator))
            task.advance()
    return results


def _errors(name: str, log: MotorLog, results: dict[str, list[LogReplay]]) -> Results:
    """Joint RMSE: the mean over excited joints, and each; of samples median, 5 % and 95 % quantile."""
    rows: list[Result] = []
    for model, runs in results.items():
        per_joint = np.array([run.rmse for run in runs])
        mean = np.nanmean(per_joint, axis=1)
        statistics = {"median": np.median(mean)}
        if len(runs) > 1:
            statistics |= {"p05": np.quantile(mean, 0.05), "p95": np.quantile(mean, 0.95)}
        for statistic, value in statistics.items():
            rows.append(Result("real_rmse", "rad", float(value), model, statistic=statistic, log=name))
        for joint in excited_joints(log):
            value, part = float(np.median(per_joint[:, joint])), log.joint_names[joint]
            rows.append(Result("real_joint_rmse", "rad", value, model, statistic="median", log=name, part=part))
    return Results.of(rows)


def plotted_joint(robot: Robot, log: MotorLog) -> int:
    """The joint of a log to plot: the first excited knee, or else the first excited joint."""
    excited = excited_joints(log)
    last = {leg.joints[-1] for leg in robot.legs}
    knees = [joint for joint in excited if joint in last]
    return int(knees[0] if knees else excited[0])


def _log_traces(name: str, robot: Robot, log: MotorLog, results: dict[str, list[LogReplay]]) -> dict[str, np.ndarray]:
    """The plotted joint of a log, for the report; samples as median and 90 % band."""
    joint = plotted_joint(robot, log)
    traces = {
        f"{name}/joint": np.array(joint),
        f"{name}/time": log.time,
        f"{name}/target": log.position_target[:, joint],
        f"{name}/measured": log.joint_pos[:, joint],
    }
    for model, runs in results.items():
        curves = np.array([run.joint_pos[:, joint] for run in runs])
        traces[f"{name}/model/{model}"] = np.median(curves, axis=0)
        if model not in ("ideal_pd", "physical", "physical_draws"):
            traces[f"{name}/low"], traces[f"{name}/high"] = np.quantile(curves, [0.05, 0.95], axis=0)
    return traces
