"""What others publish for one servo, the Feetech STS3215, on held-out logs, next to a prior.

    python benchmarks/published_motors.py --data DIR --out runs/published

DIR has the folders of `real_logs.py`; the logs are of an SO-101. Errors are RMSE of free runs
over whole held-out logs, means over joints [rad]. Published models are plain joints. Where a
constant is not published, the value with the smallest error on these very logs is taken, so their
figures are lower bounds.

figures.json: published/MODEL, and published/coverage90, the fraction of angles in the 90 % bands of
the adapted prior. published.png: the errors, a dot per log.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

import motorprior as mp
from figures import run_benchmark
from motor_cards import is_held_out
from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.artifacts import write_json
from motorprior.exports.bam import motors_of, rigid_gear
from motorprior.logs.readers.motor_log_file import read_parquet
from real_logs import Settings as LogSettings
from real_logs import errors_on_log, imported


class PlainServo(NamedTuple):
    """Constants of a plain joint with a position servo; None: not published."""

    armature: float  # [kg·m²]
    friction: float  # dry friction [N·m]
    kp: float | None  # [N·m/rad]
    kd: float | None  # [N·m·s/rad]
    torque_limit: float  # [N·m]


PUBLISHED = {
    "TheRobotStudio": PlainServo(0.028, 0.052, 17.8, 0.60, 3.35),
    "NVIDIA": PlainServo(0.068, 0.347, 48.0, None, 3.35),
    "DeepMind": PlainServo(0.109, 1e-4, None, None, 3.35),
}
# choices of constants that are not published
KP = (10.0, 17.8, 30.0, 48.0, 80.0)
KD = (0.3, 0.6, 1.0, 1.7, 3.0)

# parameters m1 of the STS3215 at 7.4 V in better-actuator-models 1.0.2
BAM = {
    "kt": 1.21164,
    "R": 2.67617,
    "armature": 0.0284034,
    "friction_base": 0.052393,
    "friction_viscous": 0.0590852,
    "model": "m1",
    "actuator": "sts3215",
}
BAM_KP = (16.0, 32.0)  # P coefficients of its firmware


@dataclass(frozen=True)
class Settings:
    """Compare published models of a servo with a prior."""

    data: Path  # folder of the logs
    out: Path = Path("runs/published")  # run folder
    logs: int | None = None  # number of held-out logs; all if not given


def compute(settings: Settings) -> dict[str, float]:
    """The figures of all models; draws the picture."""
    prior = mp.from_pretrained("so101")
    log_settings = LogSettings(settings.data, settings.out, logs=settings.logs)
    held_out = imported(log_settings, "so101", partial(is_held_out, "so101"))
    logs = [read_parquet(path) for path in held_out]

    models = candidates(logs[0].num_joints, settings.out)
    tests = [errors_on_log(prior, log, models) for log in logs]
    errors = {}
    for name in (*models, "prior"):
        errors[name] = [test["whole"][name] for test in tests]
    errors["adapted"] = [test["rest"]["adapted"] for test in tests]

    best = best_choices(errors)
    draw(best, settings.out / "published.png")
    figures = {f"published/{model}": float(np.mean(values)) for model, values in best.items()}
    coverages = [test["coverage"]["90"] for test in tests]
    figures["published/coverage90"] = float(np.mean(coverages))
    return figures


def candidates(count: int, folder: Path) -> dict[str, GreyBoxActuator]:
    """Motors as MODEL/CHOICE, one for every choice of constants that are not published."""
    models = {}
    for name, servo in PUBLISHED.items():
        for kp, kd in _choices(servo):
            models[f"{name}/{kp} {kd}"] = plain(servo._replace(kp=kp, kd=kd), count)

    path = folder / "sts3215_m1.json"
    write_json(path, BAM)
    for kp in BAM_KP:
        models[f"BAM m1/{kp}"] = mp.read_motor(path, kp=kp, count=count)
    return models


def _choices(servo: PlainServo) -> Iterator[tuple[float, float]]:
    """Values of kp and kd of a servo."""
    for kp in KP if servo.kp is None else (servo.kp,):
        for kd in KD if servo.kd is None else (servo.kd,):
            yield kp, kd


def plain(servo: PlainServo, count: int) -> GreyBoxActuator:
    """Motors that are a plain joint with a position servo."""
    assert servo.kp is not None and servo.kd is not None
    values = {
        "kp": servo.kp,
        "kd": servo.kd,
        "velocity_filter": 1e-4,
        "delay": 0.0,
        "torque_limit": servo.torque_limit,
        "armature": servo.armature,
        "coulomb": servo.friction,
        "stribeck_torque": 0.0,
        "viscous_damping": 0.0,
        "load_friction": 0.0,
        "encoder_zero": 0.0,
        **rigid_gear(servo.armature),
    }
    return motors_of({name: np.full(count, value) for name, value in values.items()})


def best_choices(errors: Mapping[str, list[float]]) -> dict[str, list[float]]:
    """Errors of each model with the choice that has the smallest mean error."""
    best: dict[str, list[float]] = {}
    for name in sorted(errors, key=lambda name: float(np.mean(errors[name]))):
        model = name.split("/")[0]
        best.setdefault(model, errors[name])
    return best


def draw(errors: Mapping[str, list[float]], path: Path) -> None:
    """A bar per model [mrad], and a dot per log."""
    figure = Figure(figsize=(6.0, 0.4 * len(errors) + 0.8), layout="constrained")
    axes = figure.subplots()
    models = sorted(errors, key=lambda model: -np.mean(errors[model]))
    for row, model in enumerate(models):
        milli = 1e3 * np.array(errors[model])
        color = "C0" if model in ("prior", "adapted") else "0.7"
        axes.barh(row, np.mean(milli), color=color)
        axes.plot(milli, np.full(len(milli), row), "k.", markersize=4)
    axes.set_yticks(range(len(models)), models)
    axes.set(xlabel="joint RMSE on held-out logs of an SO-101 [mrad]")
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    run_benchmark(Settings, compute, __doc__)
