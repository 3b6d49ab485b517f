"""Does the servo's encoder measure its rotor or its output shaft? Errors at gains left out.

    python benchmarks/encoder_place.py --data DIR --out runs/encoder_place

DIR has the folder xl330 of `real_logs.py`. A prior (preset quick) is fitted to the logs of all
gains but one, with either place of the encoder, and tested on the logs of the gain left out.
figures.json contains

    PLACE/GAIN/prior             mean error of free runs over whole logs [rad]
    PLACE/GAIN/gear_stiffness    and kp_per_register, armature, torque_limit: fitted constants, SI

Eight fits of about a minute.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import motorprior as mp
from figures import PROGRESS, run_benchmark
from motorprior.actuator.grey_box import GreyBox
from motorprior.logs.readers.motor_log_file import read_parquet
from real_logs import FACTOR, errors_on_log, imported, spread_windows
from real_logs import Settings as RealLogSettings

REGISTERS = {"rotor": {}, "output": {"output_encoder": 1.0}}  # registers of a log by place
CONSTANTS = {
    "kp": "kp_per_register",
    "armature": "armature",
    "torque_limit": "torque_limit",
    "gear_stiffness": "gear_stiffness",
}


@dataclass(frozen=True)
class Settings:
    """Compare both places of the encoder."""

    data: Path  # folder with xl330/
    out: Path  # run folder
    seconds: float = 24.0  # a third of the total length of the training segments [s]
    logs: int | None = None  # number of logs; all if not given


def compute(settings: Settings) -> dict[str, float]:
    """Errors and constants by place of the encoder and gain that was left out."""
    real_logs = RealLogSettings(settings.data, settings.out, logs=settings.logs)
    logs_of_gain: dict[float, list[mp.MotorLog]] = {}
    for path in imported(real_logs, "xl330"):
        log = read_parquet(path)
        assert log.logged_kp is not None
        logs_of_gain.setdefault(float(log.logged_kp[0, 0]), []).append(log)

    figures = {}
    for place, registers in REGISTERS.items():
        for held_out in logs_of_gain:
            training = []
            for gain, logs in logs_of_gain.items():
                if gain != held_out:
                    training += with_registers(logs, registers)
            log = spread_windows(training, FACTOR["xl330"] * settings.seconds)
            folder = settings.out / place / f"{held_out:g}"
            prior = mp.fit_prior(log, "quick", out=folder, progress=PROGRESS)
            test = with_registers(logs_of_gain[held_out], registers)
            for name, value in figures_of(prior, test).items():
                figures[f"{place}/{held_out:g}/{name}"] = value
    return figures


def with_registers(logs: Sequence[mp.MotorLog], registers: dict[str, float]) -> list[mp.MotorLog]:
    """The logs with these registers."""
    return [replace(log, firmware=registers) for log in logs]


def figures_of(prior: mp.MotorPrior, test_logs: Sequence[mp.MotorLog]) -> dict[str, float]:
    """Mean error on the test logs, and the constants of the fitted motor."""
    errors = [errors_on_log(prior, log)["whole"]["prior"] for log in test_logs]
    assert isinstance(prior.model, GreyBox)
    constants = prior.model.constants(prior.mean)
    figures = {"prior": float(np.mean(errors))}
    for name, shown in CONSTANTS.items():
        figures[shown] = float(constants[name][0])
    return figures


if __name__ == "__main__":
    run_benchmark(Settings, compute, __doc__)
