"""Deployment against a virtual robot over a real pseudo-terminal: clock, age, delay, and reaction times.

    python benchmarks/hardware.py --minutes 10 --json hardware.json

The host is this process, the robot another one. Writes a flat map:
    period_jitter_ms/p50|p99|max    |time between two commands - 10 ms|
    missed_share                    control steps that were left out, or whose command left more than 5 ms late
    telemetry_age_ms/p50|p99|max    of the measurement a command was computed from, when the command left
    end_to_end_ms/p50|p99|max       from the moment of that measurement in the robot to the command's arrival in it
    machine_late_ms/p50|p99|max     a timer in a process of its own: how late this machine woke it during the walks
    path_m, tilt_rad                how far the robot walked, second by second, and how far it leaned in the end
    faults, fault/KIND              times the walk was ended by a fault, for example a slow host, and begun again
    noisy/...                       the same with 1 % of the frames dropped and 1 % damaged, both ways
    inference_ms/p50|p99            observation, policy and generator, compiled; interpreted_ms where numba is off
    inference_ms/share_over_1ms     share of the steps that took longer; the same for interpreted_ms
    kill_to_idle_ms/max             SIGKILL of a walking host until the robot is idle; hang_to_idle_ms with SIGSTOP
    reaction_ms/FAULT               from a fault until the robot is idle (unplugged, surge: until the host says so)
    reaction_others/FAULT           trials that another fault ended, for example a slow host: repeated, not counted
A part that could not be measured (a busy machine, a fault that did not show) costs no other: it is named at the end,
and the exit code is 1.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from hardware_reactions import MOST_FAULTS, WORDS, NotMeasuredError, deploy, reactions, signal_to_idle, virtual_robot
from motorprior.exceptions import MotorPriorError, RobotFault
from motorprior.hardware.control_loop import Timing, clock_results, quantiles_ms
from motorprior.hardware.machine import BareTimers
from motorprior.hardware.motions import Walker
from motorprior.hardware.protocol import Telemetry
from motorprior.hardware.telemetry_stream import Measurement
from motorprior.locomotion.policy import Policy, zero_policy
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT

KILLS = 5
LAST_LINES = 10
NOISE = ("--robot.drop", "0.01", "--robot.corrupt", "0.01")


def trot_policy(robot: Robot, folder: Path) -> Path:
    """Zero weights: the robot's own trot, which needs no training."""
    path, wire, ones = folder / "trot.safetensors", robot.require_wire(), np.ones(robot.num_joints)
    zero = zero_policy(robot.num_joints)
    Policy(
        weights=zero.weights,
        hidden=zero.hidden,
        readout=zero.readout,
        observation_mean=zero.mean,
        observation_std=zero.std,
        kp=wire.kp * wire.torque_constant * ones,
        kd=wire.kd * wire.torque_constant * ones,
        control_dt=robot.control_dt,
        robot=robot.name,
        joint_names=robot.joint_names,
        forward=robot.require_legs().forward,
    ).save(path)
    return path


def walking(folder: Path, policy: Policy, seconds: float, *options: str) -> dict[str, float]:
    """Clock, age and delay of a walk of so many seconds; one that a fault ends is followed by another."""
    runs: list[Timing] = []
    delays, path, tilt, left, timer = [], 0.0, 0.0, seconds, BareTimers()
    faults: Counter[str] = Counter()
    while left > 1.0 and faults.total() < MOST_FAULTS:
        (folder / "run.csv").unlink(missing_ok=True)
        timing = Timing()
        with virtual_robot(folder, *options) as (port, end):
            try:
                deploy(port, policy, left, folder / "run.csv", timing)
            except RobotFault as fault:
                print(f"  {fault}", file=sys.stderr)
                faults[fault.kind] += 1
            life = end()
        runs.append(timing)
        left -= len(timing.sent) * policy.control_dt
        if len(timing.sent):
            delays.append(end_to_end(timing, life, policy.control_dt))
        path, tilt = path + life["path_m"], max(tilt, life["tilt_rad"])
    report = timer.stop()
    if not delays:
        raise NotMeasuredError("no walk was longer than its ramp")
    results = clock_results(runs, policy.control_dt) + quantiles_ms("end_to_end_ms", np.concatenate(delays))
    figures = results.to_figures()
    print(f"  {figures}", file=sys.stderr)
    figures |= {f"fault/{kind}": float(count) for kind, count in sorted(faults.items())}
    if report is not None:
        late = {"p50": report.p50, "p99": report.p99, "max": report.worst}
        figures |= {f"machine_late_ms/{name}": 1e3 * value for name, value in late.items()}
    return figures | {"path_m": path, "tilt_rad": tilt, "faults": float(faults.total())}


def end_to_end(timing: Timing, life: dict, period: float) -> np.ndarray:
    """From a measurement in the robot to the arrival of the command computed from it [s]; lost commands left out."""
    sent, measured = np.asarray(timing.sent), life["started"] + np.asarray(timing.stamp)
    arrived = np.asarray(life["target_times"])
    after = np.minimum(np.searchsorted(arrived, sent - 5e-4), len(arrived) - 1)  # the robot may read while we return
    found = (arrived[after] >= sent - 5e-4) & (arrived[after] < sent + 0.5 * period)
    return (arrived[after] - measured)[found]


def inference(policy: Policy, count: int = 5000) -> dict[str, float]:
    """Time of one step of the policy."""
    robot = load_robot(policy.robot)
    walker = Walker(robot, policy)
    zeros = dict.fromkeys(("ts", "yaw", "pitch", "roll", "yaw_rate", "pitch_rate", "roll_rate"), 0.0)
    measurement = Measurement(Telemetry(**zeros, pos=robot.nominal_pose, vel=np.zeros(robot.num_joints)), 0.0, 0.0)
    walker.warm_up(measurement)
    took = []
    for _ in range(count):
        before = time.perf_counter()
        walker(measurement)
        took.append(1e3 * (time.perf_counter() - before))
    over = float(np.mean(np.array(took) > 1.0))
    return {"p50": float(np.percentile(took, 50)), "p99": float(np.percentile(took, 99)), "share_over_1ms": over}


def inference_interpreted(policy: Path) -> dict[str, float]:
    """The same without numba's compiler, as on a robot's computer."""
    here = f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r}); from hardware import *; "
    code = here + f"print(json.dumps(inference(Policy.load(Path({str(policy)!r})), 1000)))"
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE, check=True)
    return json.loads(done.stdout)


def parts(folder: Path, path: Path, seconds: float) -> dict[str, Callable[[], dict[str, float]]]:
    """What to measure, by name; each part gives its figures."""
    policy = Policy.load(path)
    single = {"hang_to_idle_ms": partial(signal_to_idle, folder, path, signal.SIGSTOP)}
    return {
        "walk": lambda: walking(folder, policy, seconds),
        "walk with noise": lambda: named("noisy", walking(folder, policy, seconds, *NOISE)),
        "inference": lambda: named("inference_ms", inference(policy)),
        "inference, interpreted": lambda: named("interpreted_ms", inference_interpreted(path)),
        "kill_to_idle_ms": lambda: named("kill_to_idle_ms", kills(folder, path)),
        **{name: lambda name=name, measure=measure: {name: measure()} for name, measure in single.items()},
        **{f"reaction_ms/{name}": measure for name, measure in reactions(folder, path).items()},
    }


def named(prefix: str, figures: dict[str, float]) -> dict[str, float]:
    """The same figures as PREFIX/NAME."""
    return {f"{prefix}/{name}": value for name, value in figures.items()}


def kills(folder: Path, path: Path) -> dict[str, float]:
    """SIGKILL of a walking host, several times."""
    took = [signal_to_idle(folder, path, signal.SIGKILL) for _ in range(KILLS)]
    return {"max": max(took), "median": float(np.median(took))}


def last_lines(folder: Path) -> str:
    """The last lines that the other processes printed."""
    words = folder / WORDS
    lines = words.read_text(errors="replace").splitlines()[-LAST_LINES:] if words.is_file() else []
    return "".join(f"    {line}\n" for line in lines)


def measure(
    folder: Path, wanted: dict[str, Callable[[], dict[str, float]]], found: Callable[[dict[str, float]], None]
) -> list[str]:
    """Part by part, each handed to ``found`` at once; returns the parts that failed, and says why."""
    failed = []
    for name, part in wanted.items():
        (folder / WORDS).unlink(missing_ok=True)
        try:
            found(part())
        except (NotMeasuredError, MotorPriorError, OSError, subprocess.SubprocessError) as error:
            print(f"not measured: {name}: {error}\n{last_lines(folder)}", file=sys.stderr)
            failed.append(name)
    return failed


def main() -> None:
    """Measure everything; twice the minutes asked for, and about five more."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0, help="length of each walk, without and with noise [min]")
    parser.add_argument("--json", type=Path, required=True, help="file for the figures")
    parser.add_argument("--policy", type=Path, help="policy to walk with; a trot of zero weights if not given")
    arguments = parser.parse_args()
    figures: dict[str, float] = {}

    def keep(found: dict[str, float]) -> None:
        figures.update(found)
        arguments.json.write_text(json.dumps(figures, indent=1, sort_keys=True) + "\n")

    with tempfile.TemporaryDirectory(prefix="motorprior-hardware-") as name:
        folder = Path(name)
        wanted = parts(
            folder, arguments.policy or trot_policy(load_robot(DEFAULT_ROBOT), folder), 60.0 * arguments.minutes
        )
        failed = measure(folder, wanted, keep)
    for key, value in figures.items():
        print(f"{key:32} {value:10.4f}")
    if failed:
        raise SystemExit(f"not measured: {', '.join(failed)}")


if __name__ == "__main__":
    main()
