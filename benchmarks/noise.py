"""Robustness of a walking robot against lost and damaged frames, in simulated time.

    python benchmarks/noise.py --hours 2 --json noise.json

The host code controls virtual robots (`simulated_port.py`) while frames are lost and damaged in
both directions. Walks of ten minutes test walking; walks of two seconds test arming, when gains are
sent. For each SHARE of lost and damaged frames:
    SHARE/walked_h                hours of walking
    SHARE/faults_per_hour         long walks ended by a fault, per hour
    SHARE/refused                 long walks that did not start
    SHARE/fault/NAME              walks ended by this fault
    SHARE/m_per_minute            speed
    SHARE/armed                   short walks
    SHARE/armings_failed          short walks ended by a fault
    SHARE/other_gains             walks in which the robot got wrong gains or a wrong current limit
                                  from a damaged frame
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

SPEED = 0.3  # commanded speed [m/s]
LONG_SECONDS = 600.0
SHORT_SECONDS = 2.0
ROBOTS = 8  # virtual robots


@dataclass(frozen=True)
class Settings:
    """Settings of the benchmark."""

    json: Path  # file of the figures
    hours: float = 2.0  # hours of walking per share
    armings: int = 300  # short walks per share
    shares: tuple[float, ...] = (0.01, 0.03, 0.1)  # shares of lost and of damaged frames
    processes: int | None = None  # walks at a time; the number of cores if not given


@dataclass(frozen=True)
class NoisyWalk:
    """Outcome of a walk."""

    seconds: float  # duration [s]
    path: float  # length of the path [m]
    fault: str | None  # name of the fault
    other_gains: bool  # the robot did not get the gains that were sent


def trot_policy(folder: Path) -> Path:
    """File of a policy of zero weights, which is the robot's own trot."""
    robot = mp.load_robot(DEFAULT_ROBOT)
    path = folder / "trot.safetensors"
    wire = robot.require_wire()
    kp = np.full(robot.num_joints, wire.kp * wire.torque_constant)
    kd = np.full(robot.num_joints, wire.kd * wire.torque_constant)
    trot = PolicyShape(robot.num_joints).untrained()
    mp.Policy.of(robot, trot, kp, kd).save(path)
    return path


def noisy_walk(policy: Path, share: float, seconds: float, noise_seed: int) -> NoisyWalk:
    """One walk of some seconds, or until a fault; ``share`` of the frames is lost or damaged."""
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
    received = np.array(port.firmware.gains, dtype=np.float32)
    walked_seconds = len(timing.sent) * loaded.control_dt
    return NoisyWalk(walked_seconds, port.path, fault, not np.array_equal(received, sent))


def figures_of(long_walks: list[NoisyWalk], short_walks: list[NoisyWalk]) -> dict[str, float]:
    """Figures of one share of lost and damaged frames."""
    hours = sum(walk.seconds for walk in long_walks) / 3600.0
    path = sum(walk.path for walk in long_walks)
    interrupted = sum(walk.fault is not None and walk.seconds > 0.0 for walk in long_walks)
    refused = sum(walk.seconds == 0.0 for walk in long_walks)
    figures = {
        "walked_h": hours,
        "faults_per_hour": interrupted / hours,
        "refused": float(refused),
        "m_per_minute": path / (60.0 * hours),
        "armed": float(len(short_walks)),
        "armings_failed": float(sum(walk.fault is not None for walk in short_walks)),
        "other_gains": float(sum(walk.other_gains for walk in (*long_walks, *short_walks))),
    }
    faults = Counter(walk.fault for walk in (*long_walks, *short_walks) if walk.fault is not None)
    for fault, count in sorted(faults.items()):
        figures[f"fault/{fault}"] = float(count)
    return figures


def compute(settings: Settings) -> dict[str, float]:
    """Figures of all shares."""
    num_long_walks = max(1, round(3600.0 * settings.hours / LONG_SECONDS))
    long_seconds = 3600.0 * settings.hours / num_long_walks
    long_seeds = range(num_long_walks)
    short_seeds = range(num_long_walks, num_long_walks + settings.armings)

    figures: dict[str, float] = {}
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(settings.processes or os.cpu_count(), get_context("spawn")) as pool,
    ):
        policy = trot_policy(Path(folder))
        for share in settings.shares:
            long_walk = partial(noisy_walk, policy, share, long_seconds)
            short_walk = partial(noisy_walk, policy, share, SHORT_SECONDS)
            long_walks = list(pool.map(long_walk, long_seeds))
            short_walks = list(pool.map(short_walk, short_seeds))
            for name, value in figures_of(long_walks, short_walks).items():
                figures[f"{share:g}/{name}"] = value
    return figures


if __name__ == "__main__":
    values = tyro.cli(Settings, description=__doc__)
    report(compute(values), values.json)
