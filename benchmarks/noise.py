"""Robustness of a walking robot against lost and damaged frames, in simulated time and reproducible.

    python benchmarks/noise.py --hours 2 --json noise.json

The host code controls virtual robots (`simulated_port.py`) while frames are lost and damaged in
both directions. Walks of ten minutes test walking; walks of two seconds test arming, when gains are
sent. For each SHARE of lost and damaged frames:
    SHARE/walked_h                hours of walking
    SHARE/faults_per_hour         long walks ended by a fault, per hour; SHARE/refused: that did not start
    SHARE/fault/KIND              faults of a kind, in all walks
    SHARE/m_per_minute            speed
    SHARE/armed, SHARE/armings_failed   short walks, and those ended by a fault
    SHARE/other_gains             walks in which the robot got wrong gains or a wrong current limit from a damaged frame
"""

import os
import tempfile
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import tyro

import motorprior as mp
from figures import report
from motorprior.exceptions import RobotFault
from motorprior.hardware.control_loop import Timing
from motorprior.hardware.motions import gains_for, walk
from motorprior.hardware.robot_link import RobotLink
from motorprior.hardware.session import Session
from motorprior.hardware.teleop import Teleop
from motorprior.locomotion.policy_shape import PolicyShape
from motorprior.robots.shipped import DEFAULT_ROBOT
from simulated_port import SimulatedPort, on_its_clock

SPEED = 0.3  # commanded [m/s]
SHARES = (0.01, 0.03, 0.1)
LONG = 600.0
SHORT = 2.0
ROBOTS = 8


@dataclass(frozen=True)
class NoisyWalk:
    """Outcome of a walk."""

    seconds: float  # duration
    path: float  # length [m]
    fault: str | None  # kind
    other_gains: bool  # the robot did not get the gains that were sent


def trot_policy(folder: Path) -> Path:
    """File of a policy of zero weights, the robot's own trot."""
    robot = mp.load_robot(DEFAULT_ROBOT)
    path = folder / "trot.safetensors"
    wire = robot.require_wire()
    ones = np.ones(robot.num_joints)
    kp = wire.kp * wire.torque_constant * ones
    kd = wire.kd * wire.torque_constant * ones
    mp.Policy.of(robot, PolicyShape(robot.num_joints).untrained(), kp, kd).save(path)
    return path


def noisy_walk(policy: Path, share: float, seconds: float, noise_seed: int) -> NoisyWalk:
    """One walk of so many seconds, or until a fault."""
    loaded = mp.Policy.load(policy)
    timing = Timing()
    fault = None
    robot = mp.load_robot(loaded.robot)
    gains = gains_for(robot, loaded)
    port = SimulatedPort(robot, noise_seed % ROBOTS, noise_seed, drop=share, corrupt=share)
    with on_its_clock(port), RobotLink(robot, port) as link:
        try:
            steering = nullcontext(Teleop(None, None, robot.require_gait(), (SPEED, 0.0)))
            walk(Session(link, gains, timing=timing), loaded, steering, seconds)
        except RobotFault as error:
            fault = error.name
    sent = np.array([gains.kp, gains.kd, gains.max_current], dtype=np.float32)
    other = not np.array_equal(np.array(port.firmware.gains, dtype=np.float32), sent)
    return NoisyWalk(len(timing.sent) * loaded.control_dt, port.path, fault, other)


def figures(long: list[NoisyWalk], short: list[NoisyWalk]) -> dict[str, float]:
    """Figures of one noise level."""
    hours = sum(one.seconds for one in long) / 3600.0
    kinds = Counter(one.fault for one in (*long, *short) if one.fault is not None)
    return {
        "walked_h": hours,
        "faults_per_hour": sum(one.fault is not None and one.seconds > 0.0 for one in long) / hours,
        "refused": float(sum(one.seconds == 0.0 for one in long)),
        "m_per_minute": sum(one.path for one in long) / (60.0 * hours),
        "armed": float(len(short)),
        "armings_failed": float(sum(one.fault is not None for one in short)),
        "other_gains": float(sum(one.other_gains for one in (*long, *short))),
        **{f"fault/{kind}": float(count) for kind, count in sorted(kinds.items())},
    }


def measure(json: Path, hours: float = 2.0, armings: int = 300) -> None:
    """Measure ``hours`` of walking and ``armings`` short walks per noise level."""
    found: dict[str, float] = {}
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(os.cpu_count(), get_context("spawn")) as pool,
    ):
        policy = trot_policy(Path(folder))
        for share in SHARES:
            count = max(1, round(3600.0 * hours / LONG))
            seconds = 3600.0 * hours / count
            seeds = range(count, count + armings)
            long = list(pool.map(partial(noisy_walk, policy, share, seconds), range(count)))
            short = list(pool.map(partial(noisy_walk, policy, share, SHORT), seeds))
            found |= {f"{share:g}/{name}": value for name, value in figures(long, short).items()}
    report(found, json)


if __name__ == "__main__":
    tyro.cli(measure, description=__doc__)
