"""The command calibrate: errors and constants of the fitted fleet are printed."""

from motorprior.cli.terminal import print_table
from motorprior.commands.calibrate import FLEET, PICTURE, Calibrate, run_calibrate
from motorprior.progress import Progress
from motorprior.report.tables import calibrated_constants, calibration_errors


def run(config: Calibrate, progress: Progress) -> None:
    """Fit the fleet and print its errors and constants."""
    results = run_calibrate(config, progress)
    print_table("Real logs: joint RMSE [mrad], start included", *calibration_errors(results))
    print_table("Constants of the central motor", *calibrated_constants(results))
    progress.note(f"{config.out / FLEET}, {config.out / PICTURE}")
