"""Make the motor cards that the package ships, from public logs.

    python benchmarks/motor_cards.py --data DIR --out src/motorprior/exports/library

DIR has the folders of `real_logs.py`. The prior of go2, so101 and xl330 is fitted to all logs but
those held out (HELD_OUT and HELD_OUT_GAIN), which give its error, zero-shot, and the fraction of
angles in its 90 % bands after adapting to their first 10 s. That of pupper_v2 is fitted to a bench
of the shipped fleet, which is calibrated on public logs of a standing robot. Licences are those of
the logs.
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
from real_logs import FACTOR, Settings, imported, spread_windows, tested

SOURCES = {  # licence and source
    "go2": ("BSD-3-Clause", "RX-00/sim2real-robot-identification @1a22bd0, datasets/go2"),
    "so101": ("Apache-2.0", "isaac-sim2real/sage @4ffd262, output/real/so101/custom"),
    "xl330": ("Apache-2.0", "Rhoban/bam @af22604, bam/data.bak/raw/xl330_*.json"),
}
HELD_OUT = {"go2": ("traj_5",), "so101": ("multisine", "reaching_points", "chirp_sweep")}
HELD_OUT_GAIN = 200.0  # of the xl330, in firmware units
LIMITS = {
    "go2": "one robot, suspended; rigid gears assumed; torque limit not reached; calf friction depends on the angle",
    "so101": "one arm, gains in firmware units as recorded; torque limit and speed limit barely reached",
    "xl330": "one servo; the spread between units is assumed",
    "pupper_v2": "a calibrated fleet, not logs of single motors; backlash and gear stiffness are assumed",
}


@dataclass(frozen=True)
class Arguments:
    """Make motor cards."""

    data: Path  # folder of the logs
    out: Path  # folder of the cards
    work: Path = Path("runs/motor_cards")  # imported logs and interrupted fits
    cards: tuple[str, ...] = ("go2", "so101", "xl330", "pupper_v2")
    # of the arms' and the servo's; the quadruped's is rigid, so that it can walk
    preset: str = "quick"


def card_of_logs(name: str, arguments: Arguments) -> tuple[mp.MotorPrior, dict[str, str | float]]:
    """Prior and front matter of a robot with logs."""
    licence, source = SOURCES[name]
    paths = imported(Settings(arguments.data, arguments.work), name)
    test = [path for path in paths if _is_held_out(name, path)]
    train = spread_windows(
        [read_parquet(path) for path in paths if path not in test], 24.0 * FACTOR.get(name, 1.0)
    )
    preset = "rigid" if name == "go2" else arguments.preset
    prior = mp.fit_prior(train, preset, out=arguments.work / name / "prior", progress=PROGRESS)
    found = [tested(prior, read_parquet(path)) for path in test]
    return prior, {
        "licence": licence,
        "source": source,
        "held_out_logs": ", ".join(path.stem for path in test),
        "held_out_rmse_rad": float(np.mean([each["whole"]["prior"] for each in found])),
        "held_out_coverage_90": float(np.mean([each["coverage"]["90"] for each in found])),
        "recorded": "position_target, joint_pos [rad], joint_vel [rad/s]; loads by inverse dynamics",
        "limits": LIMITS[name],
    }


def _is_held_out(name: str, path: Path) -> bool:
    if name in HELD_OUT:
        return any(word in path.name for word in HELD_OUT[name])
    kp = read_parquet(path).logged_kp
    assert kp is not None
    return float(kp[0, 0]) == HELD_OUT_GAIN


def card_of_fleet(arguments: Arguments) -> tuple[mp.MotorPrior, dict[str, str | float]]:
    """Prior and front matter of the shipped robot, from its fleet."""
    log = mp.record_bench("pupper_v2", motors=32, steps=10_000)
    prior = mp.fit_prior(
        log, "rollout", out=arguments.work / "pupper_v2" / "prior", progress=PROGRESS
    )
    source = "virtual bench of the fleet pupper_v2, calibrated on logs of jietan/puppersim @8dd1b19"
    return prior, {"licence": "Apache-2.0", "source": source, "limits": LIMITS["pupper_v2"]}


def _without_paths(prior: mp.MotorPrior, arguments: Arguments) -> mp.MotorPrior:
    """The prior with names of logs instead of paths of this machine in its provenance."""
    text = json.dumps(prior.provenance)
    for path in (
        arguments.data,
        arguments.data.resolve(),
        arguments.work,
        arguments.work.resolve(),
    ):
        text = text.replace(f"{path}/", "")
    return replace(prior, provenance=json.loads(text))


def main() -> None:
    """Make the cards."""
    arguments = tyro.cli(Arguments, description=__doc__)
    for name in arguments.cards:
        prior, about = (
            card_of_fleet(arguments) if name == "pupper_v2" else card_of_logs(name, arguments)
        )
        for path in write_card(_without_paths(prior, arguments), arguments.out / name, about):
            print(f"{path}: {path.stat().st_size} bytes")


if __name__ == "__main__":
    main()
