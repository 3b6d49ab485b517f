"""Deployment to a virtual robot over a pseudo-terminal, in real time: timing of the control loop, and the watchdog.

    python benchmarks/hardware.py --minutes 10 --json hardware.json

The host is this process, the robot another one. Writes a flat map:
    period_jitter_ms/p50|p99|max    |time between two commands - 10 ms|
    missed_share                    control steps that were skipped, or whose command was more than 5 ms late
    telemetry_age_ms/p50|p99|max    of the measurement that a command is computed from, when the command is sent
    faults                          walks ended by a fault, for example a slow host, and continued with another robot
    inference_ms/p50|p99            one step of the policy, compiled; interpreted_ms without numba
    kill_to_idle_ms/median|max      from SIGKILL of a walking host to an idle robot
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from figures import report
from motorprior.commands.virtual_robot import VirtualRobotSettings, make_virtual_robot
from motorprior.exceptions import RobotFault
from motorprior.hardware.control_loop import Timing, clock_figures, real_time
from motorprior.hardware.health import Measurement
from motorprior.hardware.motions import PolicyMotion, gains_for, walk
from motorprior.hardware.protocol import Telemetry
from motorprior.hardware.robot_link import Recorder, RobotLink
from motorprior.hardware.serial_link import SerialLink
from motorprior.hardware.session import Session
from motorprior.hardware.teleop import Teleop
from motorprior.locomotion.policy import Policy, zero_policy
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT

SPEED = 0.3  # commanded [m/s]
MAX_FAULTS, NUM_KILLS = 5, 5


def trot_policy(robot: Robot, folder: Path) -> Path:
    """Save a policy of zero weights, the robot's own trot; returns its path."""
    path, wire, ones = folder / "trot.safetensors", robot.require_wire(), np.ones(robot.num_joints)
    kp, kd = wire.kp * wire.torque_constant * ones, wire.kd * wire.torque_constant * ones
    Policy.of(robot, zero_policy(robot.num_joints), kp, kd).save(path)
    return path


def _run_robot(robot_name: str, connection: Connection) -> None:
    robot, _ = make_virtual_robot(load_robot(robot_name), VirtualRobotSettings())
    connection.send(robot.port)
    with real_time():
        robot.run(connection.poll)
    connection.send(robot.events)


@contextmanager
def robot_process(robot_name: str) -> Iterator[tuple[str, Callable[[], list[tuple[float, str]]]]]:
    """Run a virtual robot; yields its port, and a function that ends it and returns its events."""
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_run_robot, args=(robot_name, theirs), daemon=True)
    process.start()

    def end() -> list[tuple[float, str]]:
        ours.send("end")
        return ours.recv()

    try:
        yield ours.recv(), end
    finally:
        process.kill()
        process.join()


def walking(folder: Path, policy: Policy, seconds: float) -> dict[str, float]:
    """Timing of a walk; after a fault another robot walks for the rest of the time."""
    robot, runs, faults = load_robot(policy.robot), list[Timing](), 0
    while (rest := seconds - policy.control_dt * sum(len(run.sent) for run in runs)) > 1.0 and faults < MAX_FAULTS:
        timing, log = Timing(), folder / f"run_{len(runs)}.csv"
        with (
            robot_process(policy.robot) as (port, _),
            RobotLink(robot, SerialLink(robot, port), recorder=Recorder(robot, log)) as link,
        ):
            try:
                gains = gains_for(robot, policy)
                steering = nullcontext(Teleop(None, None, robot.require_legs(), (SPEED, 0.0)))
                walk(Session(link, gains, timing=timing), policy, steering, rest)
            except RobotFault as fault:
                print(fault, file=sys.stderr)
                faults += 1
        runs.append(timing)
    return clock_figures(runs, policy.control_dt) | {"faults": float(faults)}


def inference(policy: Policy, count: int = 5000) -> dict[str, float]:
    """Median and 99 % quantile of the time of one step of the policy [ms]."""
    robot = load_robot(policy.robot)
    motion = PolicyMotion(robot, policy)
    zeros = dict.fromkeys(("ts", "yaw", "pitch", "roll", "yaw_rate", "pitch_rate", "roll_rate"), 0.0)
    measurement = Measurement(Telemetry(**zeros, pos=robot.nominal_pose, vel=np.zeros(robot.num_joints)), 0.0, 0.0)
    motion.warm_up(measurement)
    took = []
    for _ in range(count):
        before = time.perf_counter()
        motion(measurement)
        took.append(1e3 * (time.perf_counter() - before))
    return {"p50": float(np.percentile(took, 50)), "p99": float(np.percentile(took, 99))}


def inference_interpreted(policy: Path) -> dict[str, float]:
    """The same without numba's compiler, as on a robot's computer."""
    here = f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r}); from hardware import *; "
    code = here + f"print(json.dumps(inference(Policy.load(Path({str(policy)!r})), 1000)))"
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE, check=True)
    return json.loads(done.stdout)


def kill_to_idle(folder: Path, policy: Path) -> float:
    """Milliseconds from SIGKILL of a walking host to an idle robot."""
    out = Path(tempfile.mkdtemp(dir=folder)) / "run"
    with robot_process(Policy.load(policy).robot) as (port, end):
        command = ["-m", "motorprior.hardware", "deploy", str(policy), "--port", port, "--out", str(out), "--yes"]
        host = subprocess.Popen([sys.executable, *command], stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        log = out / "run.csv"
        while host.poll() is None and not (log.is_file() and log.stat().st_size > 200_000):  # 4 s
            time.sleep(0.01)
        killed = time.monotonic()
        host.kill()
        host.wait()
        time.sleep(0.5)
        return 1e3 * (min(at for at, what in end() if what == "idle" and at >= killed) - killed)


def main() -> None:
    """Measure everything."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0, help="length of the walk [min]")
    parser.add_argument("--json", type=Path, required=True, help="file for the figures")
    parser.add_argument("--policy", type=Path, help="policy to walk with; a trot of zero weights if not given")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="motorprior-hardware-") as name:
        folder = Path(name)
        path = arguments.policy or trot_policy(load_robot(DEFAULT_ROBOT), folder)
        policy = Policy.load(path)
        figures = walking(folder, policy, 60.0 * arguments.minutes)
        figures |= {f"inference_ms/{name}": value for name, value in inference(policy).items()}
        figures |= {f"interpreted_ms/{name}": value for name, value in inference_interpreted(path).items()}
        took = [kill_to_idle(folder, path) for _ in range(NUM_KILLS)]
        figures |= {"kill_to_idle_ms/median": float(np.median(took)), "kill_to_idle_ms/max": max(took)}
    report(figures, arguments.json)


if __name__ == "__main__":
    main()
