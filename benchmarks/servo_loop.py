"""From servos on a virtual bus to constants with intervals: do the intervals hold the truth?

    python benchmarks/servo_loop.py --out runs/servo_loop --seconds 120 --json servo_loop.json

For an SO-101 (six STS3215), and for an STS3215 and an XL330 that swing a pendulum: `motorprior
record --virtual` in a process of its own, `mp.load_log` and `mp.fit_prior`. The truth are the
constants of the virtual motors, which have a physics that the learned model lacks in part (dead
zone, presliding, encoder steps).
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

import motorprior as mp
from motorprior import robots
from motorprior.hardware.buses.virtual_bus import SENSE_PERIOD
from motorprior.simulation.simulated_servos import draw_servos

PENDULUM = Path(robots.__file__).parent / "pendulum"
# constants that the learned and the virtual motors share
COMPARED = (
    "kp",
    "viscous_damping",
    "delay",
    "torque_limit",
    "armature",
    "coulomb",
    "load_friction",
    "gear_stiffness",
    "backlash",
)
# options of `motorprior record`, robot, and fleet of the virtual motors
BENCHES: dict[str, tuple[tuple[str, ...], str | None, str]] = {
    "sts3215": (
        ("--motor", "STS3215", "--bar", "0.2m,0.5kg"),
        None,
        str(PENDULUM / "sts3215.toml"),
    ),
    "so101": (("--robot", "so101"), "so101", "so101_servos"),
    "xl330": (
        ("--motor", "XL330-M288", "--bar", "0.1m,0.25kg"),
        None,
        str(PENDULUM / "xl330_m288.toml"),
    ),
}


def record(name: str, seed: int, seconds: float, profile: str, out: Path) -> Path:
    """The recording of virtual servos number ``seed``; one that exists is used again."""
    recording = out / "run.servolog"
    if not recording.exists():
        options, _, _ = BENCHES[name]
        virtual = ("--virtual", "--virtual-robot.seed", str(seed))
        command = [sys.executable, "-m", "motorprior", "record", *virtual, *options, "--yes"]
        command += ["--seconds", str(seconds), "--profile", profile, "--out", str(out)]
        subprocess.run(command, check=True)
    return recording


def truth(name: str, seed: int, joints: int) -> dict[str, np.ndarray]:
    """(n,) constants of the virtual motors, with the gains of their registers.

    The delay includes the lag of the current, and the mean waits for a tick of the firmware and for
    the next reading of the sensors: a log cannot tell them apart.
    """
    motors = draw_servos(mp.load_fleet(BENCHES[name][2]), joints, seed)
    values = {key: np.array(getattr(motors, key)) for key in COMPARED}
    values["delay"] += motors.current_time + 0.5 * motors.servo_period + 0.5 * SENSE_PERIOD
    return values


def intervals(prior: mp.MotorPrior, log: mp.MotorLog) -> dict[str, np.ndarray]:
    """(2, n) ends of the 90 % intervals of the constants, from the log alone."""
    ends = dict(prior.intervals(90.0))
    if "kp_per_logged" in ends:
        assert log.gains is not None
        ends["kp"] = ends["kp_per_logged"] * log.gains[0]
    return {name: ends[name] for name in COMPARED}


def run(name: str, seed: int, args: argparse.Namespace) -> dict[str, Any]:
    """One bench from nothing to constants."""
    folder = args.out / f"{name}_{seed}_{args.profile}"
    begin = time.perf_counter()
    recording = record(name, seed, args.seconds, args.profile, folder / "recording")
    recorded = time.perf_counter()
    log = mp.load_log(recording, robot=BENCHES[name][1])
    prior = mp.fit_prior(log, args.preset, out=folder / "prior", progress=mp.Lines(sys.stderr))
    fitted = time.perf_counter()

    values = truth(name, seed, log.num_joints)
    held = {}
    for key, (low, high) in intervals(prior, log).items():
        held[key] = (low <= values[key]) & (values[key] <= high)
        for index, joint in enumerate(log.joint_names):
            mark = "" if held[key][index] else "  outside"
            interval = f"≥ {low[index]:.4g}"
            if np.isfinite(high[index]):
                interval = f"{low[index]:.4g} to {high[index]:.4g}"
            text = f"{values[key][index]:.4g} in {interval}"
            print(f"{name} {seed} {joint} {key}: {text}{mark}")
    share = float(np.mean(list(held.values())))
    figures = {
        "coverage": share,
        "coverage_by_constant": {key: float(np.mean(value)) for key, value in held.items()},
        "replay_rmse_mrad": 1e3 * float(prior.metrics.replay_rmse or np.nan),
        "recorded_seconds": log.duration,
        "recording_minutes": (recorded - begin) / 60.0,
        "fit_minutes": (fitted - recorded) / 60.0,
    }
    print(json.dumps({f"{name}_{seed}": figures}, indent=1))
    return figures


def main() -> None:
    """Run all benches."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("runs/servo_loop"))
    parser.add_argument("--benches", nargs="+", default=list(BENCHES), choices=list(BENCHES))
    parser.add_argument("--seeds", type=int, default=1, help="number of virtual robots")
    parser.add_argument("--seconds", type=float, default=120.0, help="of a recording")
    parser.add_argument(
        "--profile", default="off", choices=("keep", "off"), help="acceleration limit of the servos"
    )
    parser.add_argument("--preset", default="quick")
    parser.add_argument("--json", type=Path, help="file for the figures")
    args = parser.parse_args()

    figures = {}
    for name in args.benches:
        for seed in range(args.seeds):
            key = f"{name}_{seed}"
            figures[key] = run(name, seed, args)
    if args.json:
        args.json.write_text(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
