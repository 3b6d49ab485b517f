"""Make the motor cards that the package ships, from public logs.

    python benchmarks/motor_cards.py --data DIR --out src/motorprior/exports/library

DIR has the folders of `real_logs.py`. The prior of go2, so101 and xl330 is fitted to all logs but
the held-out ones (HELD_OUT and HELD_OUT_KP), which give its error, zero-shot, and the fraction of
angles in its 90 % bands after adapting to their first 10 s. The prior of pupper_v2 is fitted to a
bench of the shipped fleet, which is calibrated on public logs of a standing robot. Licences are
those of the logs.
"""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

import motorprior as mp
from figures import PROGRESS
from motorprior.exports.cards import write_card
from motorprior.logs.readers.motor_log_file import read_parquet
from real_logs import FACTOR, Settings, errors_on_log, imported, spread_windows

SOURCES = {  # licence and source
    "go2": ("BSD-3-Clause", "RX-00/sim2real-robot-identification @1a22bd0, datasets/go2"),
    "so101": ("Apache-2.0", "isaac-sim2real/sage @4ffd262, output/real/so101/custom"),
    "xl330": ("Apache-2.0", "Rhoban/bam @af22604, bam/data.bak/raw/xl330_*.json"),
}
HELD_OUT = {"go2": ("traj_5",), "so101": ("multisine", "reaching_points", "chirp_sweep")}
HELD_OUT_KP = 200.0  # of the xl330, in firmware units
RECORDED = "position_target, joint_pos [rad], joint_vel [rad/s]; loads by inverse dynamics"
LIMITS = {
    "go2": (
        "one robot, suspended; rigid gears assumed; torque limit not reached; calf friction "
        "depends on the angle"
    ),
    "so101": (
        "one arm, gains in firmware units as recorded; torque limit and speed are the "
        "description's; equal motors assumed; other searches find kp from 6.5 to 16"
    ),
    "xl330": "one servo; the spread between units is assumed",
    "pupper_v2": (
        "a calibrated fleet, not logs of single motors; backlash and gear stiffness are assumed"
    ),
}
FrontMatter = dict[str, str | float]


@dataclass(frozen=True)
class Arguments:
    """Make motor cards."""

    data: Path  # folder of the logs
    out: Path  # folder of the cards
    work: Path = Path("runs/motor_cards")  # imported logs and interrupted fits
    cards: tuple[str, ...] = ("go2", "so101", "xl330", "pupper_v2")
    # preset of the arm's and the servo's priors; the quadruped's is rigid, so that it can walk
    preset: str = "quick"
    # total length of the training segments [s]; 5 times as long for the arm, 3 for the pendulum
    seconds: float = 24.0
    logs: int | None = None  # number of logs per robot; all if not given
    motors: int = 32  # motors on the bench of pupper_v2
    steps: int = 10_000  # samples of each of these motors


def main() -> None:
    """Make the cards."""
    arguments = tyro.cli(Arguments, description=__doc__)
    for name in arguments.cards:
        if name == "pupper_v2":
            prior, about = card_of_fleet(arguments)
        else:
            prior, about = card_of_logs(name, arguments)
        prior = _without_paths(prior, arguments)
        for path in write_card(prior, arguments.out / name, about):
            print(f"{path}: {path.stat().st_size} bytes")


def card_of_logs(name: str, arguments: Arguments) -> tuple[mp.MotorPrior, FrontMatter]:
    """Prior and front matter of a robot with logs."""
    settings = Settings(arguments.data, arguments.work, logs=arguments.logs)
    test_paths = []
    training_logs = []
    for path in imported(settings, name):
        if is_held_out(name, path):
            test_paths.append(path)
        else:
            training_logs.append(read_parquet(path))

    training_log = spread_windows(training_logs, arguments.seconds * FACTOR.get(name, 1.0))
    preset = "rigid" if name == "go2" else arguments.preset
    out = arguments.work / name / "prior"
    prior = mp.fit_prior(training_log, preset, out=out, progress=PROGRESS)

    tests = [errors_on_log(prior, read_parquet(path)) for path in test_paths]
    licence, source = SOURCES[name]
    return prior, {
        "licence": licence,
        "source": source,
        "held_out_logs": ", ".join(path.stem for path in test_paths),
        "held_out_rmse_rad": float(np.mean([test["whole"]["prior"] for test in tests])),
        "held_out_coverage_90": float(np.mean([test["coverage"]["90"] for test in tests])),
        "recorded": RECORDED,
        "limits": LIMITS[name],
    }


def is_held_out(name: str, path: Path) -> bool:
    """Whether a log of a robot is a test log."""
    if name in HELD_OUT:
        return any(word in path.name for word in HELD_OUT[name])
    kp = read_parquet(path).logged_kp
    assert kp is not None
    return float(kp[0, 0]) == HELD_OUT_KP


def card_of_fleet(arguments: Arguments) -> tuple[mp.MotorPrior, FrontMatter]:
    """Prior and front matter of the shipped robot, from its fleet."""
    log = mp.record_bench("pupper_v2", motors=arguments.motors, steps=arguments.steps)
    out = arguments.work / "pupper_v2" / "prior"
    prior = mp.fit_prior(log, "rollout", out=out, progress=PROGRESS)
    return prior, {
        "licence": "Apache-2.0",
        "source": (
            "virtual bench of the fleet pupper_v2, calibrated on logs of jietan/puppersim @8dd1b19"
        ),
        "limits": LIMITS["pupper_v2"],
    }


def _without_paths(prior: mp.MotorPrior, arguments: Arguments) -> mp.MotorPrior:
    """The prior with names of logs instead of paths of this machine in its provenance."""
    text = json.dumps(prior.provenance)
    for folder in (arguments.data, arguments.work):
        text = text.replace(f"{folder}/", "").replace(f"{folder.resolve()}/", "")
    return replace(prior, provenance=json.loads(text))


if __name__ == "__main__":
    main()
