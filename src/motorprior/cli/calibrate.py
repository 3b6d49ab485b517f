"""``motorprior calibrate``: a fleet of physical motors from logs of a real robot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from motorprior.cli.console import TERMINAL, table
from motorprior.pipeline.replay.calibrate import FLEET, PICTURE, Calibrate, run_calibrate
from motorprior.report.tables import calibrated_constants, calibration_errors, optima


@dataclass(frozen=True)
class CalibrateCommand(Calibrate):
    """Fit a fleet of physical motors to real logs of a robot, for `motorprior bench --fleet`."""

    logs: tyro.conf.Positional[Path]


def run_calibrate_command(config: CalibrateCommand) -> None:
    """See `run_calibrate`."""
    results = run_calibrate(config, TERMINAL)
    table("Real logs: joint RMSE [mrad], start included", *calibration_errors(results))
    table("Constants of the central motor", *calibrated_constants(results))
    table("Optima", *optima(results))
    TERMINAL.note(f"{config.out / FLEET}, {config.out / PICTURE}")
