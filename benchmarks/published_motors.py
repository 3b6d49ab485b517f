"""What others publish for one servo, the Feetech STS3215, on held-out logs of an SO-101, next to a prior.

    python benchmarks/published_motors.py --data DIR --out runs/published

DIR has the folders of `real_logs.py`. Errors are RMSE of free runs over whole held-out logs, means
over joints [rad]. Published models are plain joints; where a constant is not published, the one
with the least error on these very logs is taken, so their figures are lower bounds. figures.json:
published/MODEL, and published/coverage90, the fraction of angles in the 90 % bands of the adapted
prior. published.png: the errors, a dot per log.
"""

from pathlib import Path

import numpy as np
import tyro
from matplotlib.figure import Figure

import motorprior as mp
from figures import report
from motor_cards import HELD_OUT
from motorprior.actuator.grey_box import GreyBoxActuator
from motorprior.artifacts import write_json
from motorprior.exports.bam import motors_of, rigid_gear
from motorprior.logs.readers.motor_log_file import read_parquet
from real_logs import Settings, imported, tested

# armature [kg·m²], dry friction [N·m], kp [N·m/rad], damping [N·m·s/rad], torque limit [N·m]; None:
# not published
PUBLISHED = {
    "TheRobotStudio": (0.028, 0.052, 17.8, 0.60, 3.35),
    "NVIDIA": (0.068, 0.347, 48.0, None, 3.35),
    "DeepMind": (0.109, 1e-4, None, None, 3.35),
}
# parameters m1 of the STS3215 at 7.4 V in better-actuator-models 1.0.2, and P coefficients of its
# firmware
BAM = {
    "kt": 1.21164, "R": 2.67617, "armature": 0.0284034, "friction_base": 0.052393, "friction_viscous": 0.0590852,
    "model": "m1", "actuator": "sts3215",
}  # fmt: skip
BAM_GAINS = (16.0, 32.0)
KP = (10.0, 17.8, 30.0, 48.0, 80.0)
KD = (0.3, 0.6, 1.0, 1.7, 3.0)


def plain(
    armature: float, friction: float, kp: float, kd: float, limit: float, count: int
) -> GreyBoxActuator:
    """Motors that are a plain joint with a position servo."""
    values = {
        "kp": kp,
        "kd": kd,
        "velocity_filter": 1e-4,
        "delay": 0.0,
        "torque_limit": limit,
        "armature": armature,
        "coulomb": friction,
        "stribeck_torque": 0.0,
        "viscous_damping": 0.0,
        "load_friction": 0.0,
        "encoder_zero": 0.0,
        **rigid_gear(armature),
    }
    return motors_of({name: np.full(count, value) for name, value in values.items()})


def candidates(count: int, folder: Path) -> dict[str, GreyBoxActuator]:
    """Motors as MODEL/CHOICE, one for every choice of constants that are not published."""
    found = {
        f"{name}/{p} {d}": plain(armature, friction, p, d, limit, count)
        for name, (armature, friction, kp, kd, limit) in PUBLISHED.items()
        for p in (KP if kp is None else (kp,))
        for d in (KD if kd is None else (kd,))
    }
    path = folder / "sts3215_m1.json"
    write_json(path, BAM)
    return found | {f"BAM m1/{kp}": mp.read_motor(path, kp=kp, count=count) for kp in BAM_GAINS}


def draw(errors: dict[str, list[float]], path: Path) -> None:
    """A bar per model [mrad], and a dot per log."""
    figure = Figure(figsize=(6.0, 0.4 * len(errors) + 0.8), layout="constrained")
    axes = figure.subplots()
    models = sorted(errors, key=lambda model: -np.mean(errors[model]))
    for row, (model, values) in enumerate((model, errors[model]) for model in models):
        axes.barh(
            row, 1e3 * np.mean(values), color="C0" if model in ("prior", "adapted") else "0.7"
        )
        axes.plot(1e3 * np.array(values), np.full(len(values), row), "k.", markersize=4)
    axes.set_yticks(range(len(models)), models)
    axes.set(xlabel="joint RMSE on held-out logs of an SO-101 [mrad]")
    figure.savefig(path, dpi=110)


def measure(data: Path, out: Path = Path("runs/published")) -> None:
    """Measure, print and write; see the module docstring."""
    prior = mp.from_pretrained("so101")
    paths = imported(Settings(data, out), "so101")
    logs = [
        read_parquet(path) for path in paths if any(word in path.name for word in HELD_OUT["so101"])
    ]
    models = candidates(logs[0].num_joints, out)
    found = [tested(prior, log, models) for log in logs]
    errors = {name: [each["whole"][name] for each in found] for name in (*models, "prior")}
    errors["adapted"] = [each["rest"]["adapted"] for each in found]
    best: dict[str, list[float]] = {}
    for name, values in sorted(errors.items(), key=lambda each: np.mean(each[1])):
        best.setdefault(name.split("/")[0], values)  # the choice with the smallest error
    draw(best, out / "published.png")
    figures = {f"published/{model}": float(np.mean(values)) for model, values in best.items()}
    figures["published/coverage90"] = float(np.mean([each["coverage"]["90"] for each in found]))
    report(figures, out / "figures.json")


if __name__ == "__main__":
    tyro.cli(measure, description=__doc__)
