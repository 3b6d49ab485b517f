"""``motorprior replay`` and ``calibrate``: real logs of a robot and simulated motors."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from motorprior.cli.console import TERMINAL, table
from motorprior.commands.calibrate import FLEET, PICTURE, Calibrate, run_calibrate
from motorprior.commands.replay import Replay, run_replay
from motorprior.report.tables import calibrated_constants, calibration_errors, optima, replay_models, replay_rows
from motorprior.results import Results


@dataclass(frozen=True)
class ReplayCommand(Replay):
    """Replay the commands of real logs on simulated motors and compare the joint angles."""

    logs: tyro.conf.Positional[Path]


@dataclass(frozen=True)
class CalibrateCommand(Calibrate):
    """Fit a fleet of physical motors to real logs of a robot, for `motorprior bench --fleet`."""

    logs: tyro.conf.Positional[Path]


def replay(config: ReplayCommand) -> None:
    """See `run_replay`."""
    show_replay(run_replay(config, TERMINAL))


def show_replay(results: Results) -> None:
    """Print the table."""
    models = replay_models(results)
    table("Real logs: joint RMSE [mrad], start included", ["log", "joint", *models], replay_rows(results))


def calibrate(config: CalibrateCommand) -> None:
    """See `run_calibrate`."""
    results = run_calibrate(config, TERMINAL)
    table("Real logs: joint RMSE [mrad], start included", *calibration_errors(results))
    table("Constants of the central motor", *calibrated_constants(results))
    table("Optima", *optima(results))
    TERMINAL.note(f"{config.out / FLEET}, {config.out / PICTURE}")
