"""Comparison of real logs of a robot with simulated motors."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.fleet import Fleet, fleet_files, load_robot_fleet, nominal_pd
from motorprior.actuator.motor_prior import MotorPrior, prior_path, robot_gains
from motorprior.bounds import require_count, require_seed
from motorprior.priors.prior_file import load_prior
from motorprior.progress import SILENT, Progress
from motorprior.results import Result, Results, read_results, write_results
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.stage import description, is_finished, working
from motorprior.studies.log_replay import (
    PostureName,
    Replayer,
    motors_with_logged_gains,
    read_logs,
    replayers_of,
)


@dataclass(frozen=True)
class Replay:
    """Replay the commands of real logs on simulated motors."""

    logs: Path
    """A log, or a folder of logs: motor logs (.parquet), or files in the format of
    jietan/puppersim."""
    prior: Path
    """Prior to sample."""
    out: Path
    """Folder for figures.json."""
    fleet: str | None = None
    """Fleet that gives the central motor, and the ideal PD's gains; the robot's fleet if not given.
    Logged gains in N·m/rad replace the gains of both models."""
    samples: int = 20
    """Number of sets of motors that are sampled from the prior."""
    seed: int = 0
    """Seed of the sampled motors."""
    robot: str = DEFAULT_ROBOT
    """Robot: name of a shipped robot, or the .toml file of your robot (docs/your-robot.md)."""
    posture: PostureName = "auto"
    """Posture of the robot: standing, or suspended in the air. "auto" uses the posture that the log
    states; else the posture in which the fleet's central motor replays the log clearly better."""


def run_replay(config: Replay, progress: Progress = SILENT) -> Results:
    """Replay, or read the results of the finished stage.

    Raises an error for an input that cannot be used.
    """
    require_count("samples", config.samples)
    require_seed(config.seed)

    robot = load_robot(config.robot)
    fleet = load_robot_fleet(robot, config.fleet)
    folder = read_logs(config.logs, robot)
    prior = load_prior(config.prior, robot)
    inputs = [
        prior_path(config.prior),
        *fleet_files(robot, config.fleet),
        *folder.files,
        *robot.files,
    ]
    stage = description("replay", asdict(config), inputs)
    if is_finished(config.out, stage):
        return read_results(config.out)

    with working(config.out, stage):
        replayers = replayers_of(folder.logs, robot, fleet, config.posture, progress.note)
        rows = list[Result]()
        count = len(replayers)
        runs = count * (2 + 2 * config.samples)
        with progress.start(f"replay of {count} real logs", runs) as task:
            for name, replayer in replayers.items():
                simulated: dict[str, np.ndarray] = {}
                for model, actuators in _models(config, robot, fleet, replayer, prior).items():
                    joint_pos = [replayer.joint_pos(actuator) for actuator in actuators]
                    simulated[model] = np.array(joint_pos)
                    task.advance(len(actuators))
                rows += _errors(name, replayer, simulated)
        write_results(config.out, Results(rows))
    return read_results(config.out)


def _models(
    config: Replay, robot: Robot, fleet: Fleet, replayer: Replayer, prior: MotorPrior
) -> dict[str, list[Actuator]]:
    """Motors of each model, one per joint: samples, or one set."""
    rng = np.random.default_rng(config.seed)
    count = robot.num_joints
    log = replayer.log

    classes = prior.joint_classes(log)
    gains = log.gains
    if gains is None or log.gain_unit != prior.model.gain_unit:
        gains = robot_gains(prior, robot)

    fleet_samples = [
        motors_with_logged_gains(fleet.sample(count, rng), log) for _ in range(config.samples)
    ]
    return {
        "ideal_pd": [motors_with_logged_gains(nominal_pd(fleet, count), log)],
        "physical": [motors_with_logged_gains(fleet.center(count), log).actuator()],
        "physical_samples": [motors.actuator() for motors in fleet_samples],
        prior.preset: [prior.sample(classes, rng, gains) for _ in range(config.samples)],
    }


def _errors(name: str, replayer: Replayer, simulated: Mapping[str, np.ndarray]) -> list[Result]:
    """Joint RMSE of a log by model: the mean over the excited joints, and the error of each joint.

    ``simulated`` has (samples, rows, joints) angles by model [rad]. The statistics are median, 5 %
    and 95 % quantile of the samples.
    """
    rows: list[Result] = []
    for model, runs in simulated.items():
        per_joint = np.array([replayer.rmse(joint_pos) for joint_pos in runs])
        mean = np.nanmean(per_joint, axis=1)
        statistics = {"median": np.median(mean)}
        if len(runs) > 1:
            statistics["p05"] = np.quantile(mean, 0.05)
            statistics["p95"] = np.quantile(mean, 0.95)
        for statistic, value in statistics.items():
            rows.append(
                Result("real_rmse", "rad", float(value), model, statistic=statistic, log=name)
            )
        for joint in replayer.excited:
            value = float(np.median(per_joint[:, joint]))
            joint_name = replayer.log.joint_names[joint]
            row = Result(
                "real_joint_rmse",
                "rad",
                value,
                model,
                statistic="median",
                log=name,
                part=joint_name,
            )
            rows.append(row)
    return rows
