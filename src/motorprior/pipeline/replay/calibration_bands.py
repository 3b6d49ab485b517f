"""Bands of a calibrated fleet, or of a prior of it, over the logs: picture and coverage."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.actuator.latent import LatentActuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.actuator.optional_terms import HALF_WARM
from motorprior.bench.fleet import Fleet
from motorprior.logs.motor_log import CONDITIONS, MotorLog, channels
from motorprior.pipeline.motor_choice import gains_for
from motorprior.pipeline.prior_file import recipe_of
from motorprior.pipeline.progress import Task
from motorprior.pipeline.replay.replay import shown_joint
from motorprior.report.plots_motor import Band, LogPanel, calibration
from motorprior.report.plots_style import png_bytes
from motorprior.results import Result, Results
from motorprior.robots.robot import Robot
from motorprior.transfer.fleet_problem import FleetProblem
from motorprior.transfer.log_replay import Replayer, with_logged_gains

LEVELS = (90, 50)  # bands of a prior [%]


def draw_bands(
    problem: FleetProblem, center: np.ndarray, fleet: Fleet, draws: int, seed: int, task: Task
) -> tuple[bytes, Results]:
    """Replay every log on ``draws`` robots of the fleet.

    Args:
        problem: logs and robot.
        center: (unknowns,) of the fit.
        fleet: the fitted one.
        draws: samples of the robot's motors.
        seed: of the samples.
        task: advances with every log.

    Returns:
        The picture, a PNG, and per log the share of the angles of moved joints within the bands.
    """
    rng, panels, covered = np.random.default_rng(seed), [], []
    for name, replayer in problem.replayers.items():
        runs = _fleet_runs(replayer, problem.robot, fleet, draws, rng)
        low, high = np.quantile(runs, [0.05, 0.95], axis=0)
        central = replayer.joint_pos(problem.actuator(name, center))
        panels.append(_panel(name, problem.robot, replayer, central, [Band("fleet, 90 % of draws", low, high)]))
        covered.append(Result("calibrate_coverage90", "1", _inside(replayer, low, high), log=name))
        task.advance()
    return png_bytes(calibration(panels)), Results.of(covered)


def draw_prior_bands(
    replayers: Mapping[str, Replayer], robot: Robot, fleet: Fleet, prior: MotorPrior, draws: int, seed: int, task: Task
) -> tuple[bytes, Results]:
    """`draw_bands` of a prior: its LEVELS and its central motor, with the fleet's 90 % band as lines."""
    from motorprior.identification.judging.coverage import band

    rng, panels, covered = np.random.default_rng(seed), [], []
    for name, replayer in replayers.items():
        low, high = np.quantile(_fleet_runs(replayer, robot, fleet, draws, rng), [0.05, 0.95], axis=0)
        bands, gains = [Band("fleet, 90 % of draws", low, high, False)], gains_for(prior, robot, replayer.prepared)
        under = HALF_WARM._replace(**_conditions(prior, replayer.prepared))
        motors = (replace(prior.sample(robot.num_joints, rng, gains), conditions=under) for _ in range(draws))
        runs = _runs(replayer, list(motors))
        for level in LEVELS:
            low, high = band(runs, level)
            bands.append(Band(f"prior, {level} %", low, high))
            covered.append(Result(f"calibrate_coverage{level}", "1", _inside(replayer, low, high), "prior", log=name))
        nowhere = np.zeros((robot.num_joints, prior.network.num_latents))
        central = replayer.joint_pos(LatentActuator(prior.network, nowhere, under, gains))
        panels.append(_panel(name, robot, replayer, central, bands))
        task.advance()
    return png_bytes(calibration(panels)), Results.of(covered)


def _conditions(prior: MotorPrior, log: MotorLog) -> dict[str, np.ndarray]:
    """Supply voltage and temperature of the log, relative to the prior's."""
    from motorprior.identification.training_data.windows import relative_conditions

    if not CONDITIONS.keys() & channels(log).keys():
        return {}
    supply, warmer = relative_conditions(log, recipe_of(prior, "the prior").usual_conditions)
    return {"supply": supply, "warmer": warmer}


def _fleet_runs(replayer: Replayer, robot: Robot, fleet: Fleet, draws: int, rng: np.random.Generator) -> np.ndarray:
    drawn = [with_logged_gains(fleet.sample(robot.num_joints, rng), replayer.prepared) for _ in range(draws)]
    return _runs(replayer, [motors.actuator() for motors in drawn])


def _runs(replayer: Replayer, motors: Sequence[Actuator]) -> np.ndarray:
    """(draws, T, joints) angles."""
    return np.array([replayer.joint_pos(each) for each in motors])


def _inside(replayer: Replayer, low: np.ndarray, high: np.ndarray) -> float:
    """Share of the compared angles of moved joints between two edges (T, joints)."""
    measured = replayer.prepared.joint_pos
    return float(((measured >= low) & (measured <= high))[replayer.compared][:, replayer.excited].mean())


def _panel(name: str, robot: Robot, replayer: Replayer, central: np.ndarray, bands: Sequence[Band]) -> LogPanel:
    """Of the plotted joint of a log; angles and edges are (T, joints)."""
    log = replayer.prepared
    joint = shown_joint(robot, log)
    target, measured, center = (each[:, joint] for each in (log.position_target, log.joint_pos, central))
    own = tuple(Band(each.label, each.low[:, joint], each.high[:, joint], each.is_filled) for each in bands)
    return LogPanel(f"log {name}, {log.joint_names[joint]}", log.time, target, measured, center, own)
