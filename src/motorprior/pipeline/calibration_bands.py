"""Logs inside the bands of a calibrated fleet: a picture, and the share of the readings that the bands hold."""

from __future__ import annotations

import numpy as np

from motorprior.bench.fleet import Fleet
from motorprior.pipeline.progress import Task
from motorprior.pipeline.replay import shown_joint
from motorprior.report.plots_calibrate import LogPanel, calibration
from motorprior.report.plots_style import png_bytes
from motorprior.results import Result, Results
from motorprior.transfer.fleet_problem import FleetProblem

_BAND = (0.05, 0.95)


def draw_bands(
    problem: FleetProblem, center: np.ndarray, fleet: Fleet, draws: int, seed: int, task: Task
) -> tuple[bytes, Results]:
    """Replay every log on ``draws`` robots of the fleet.

    Args:
        problem: logs and robot.
        center: (unknowns,) of the fit.
        fleet: the fitted one.
        draws: of all motors of the robot.
        seed: of the draws.
        task: told of every log.

    Returns:
        The picture, a PNG, and per log the share of the angles of moved joints within the bands.
    """
    rng, panels, covered = np.random.default_rng(seed), [], []
    for name in problem.replayers:
        panel, share = _log_bands(problem, name, center, fleet, draws, rng)
        panels.append(panel)
        covered.append(Result("calibrate_coverage90", "1", share, log=name))
        task.advance()
    return png_bytes(calibration(panels)), Results.of(covered)


def _log_bands(
    problem: FleetProblem, name: str, center: np.ndarray, fleet: Fleet, draws: int, rng: np.random.Generator
) -> tuple[LogPanel, float]:
    replayer, count = problem.replayers[name], problem.robot.num_joints
    log = replayer.prepared
    runs = np.array([replayer.joint_pos(fleet.sample(count, rng).actuator()) for _ in range(draws)])
    low, high = np.quantile(runs, _BAND, axis=0)
    inside = ((log.joint_pos >= low) & (log.joint_pos <= high))[replayer.compared][:, replayer.excited]
    joint, central = shown_joint(problem.robot, log), replayer.joint_pos(problem.motors(center).actuator())
    columns = (each[:, joint] for each in (log.position_target, log.joint_pos, central, low, high))
    return LogPanel(f"log {name}, {log.joint_names[joint]}", log.time, *columns), float(inside.mean())
