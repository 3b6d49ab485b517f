"""How much noise on the line a walking robot stands, in simulated time: hours in minutes, the same figures every time.

    python benchmarks/noise.py --hours 2 --json noise.json

The host's own code walks virtual robots (`simulated_port.py`) while the line loses and damages frames, both ways.
Walks of ten minutes, and of two seconds: these are for the arming, when gains go over the line. For each share of lost
and of damaged frames:
    SHARE/walked_h                hours under way
    SHARE/faults_per_hour         long walks ended by a fault under way, per hour; SHARE/refused: before they began
    SHARE/fault/KIND              faults of a kind, in all walks, long and short
    SHARE/m_per_minute            way walked
    SHARE/armed, SHARE/armings_failed   short walks, and those ended by a fault
    SHARE/other_gains             walks, long or short, with other gains or another current limit in the robot than were
                                  sent: the last of these commands that arrived was damaged (that none arrived does not
                                  count, for the virtual robot begins with these gains)
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from hardware import SPEED, trot_policy
from motorprior.exceptions import RobotFault
from motorprior.hardware.control_loop import Timing
from motorprior.hardware.deploy import gains_for, walk
from motorprior.hardware.robot_link import RobotLink
from motorprior.hardware.session import StopRequest
from motorprior.locomotion.policy import Policy
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from simulated_port import SimulatedPort, on_its_clock

SHARES = (0.01, 0.03, 0.1)
LONG, SHORT = 600.0, 2.0
ROBOTS = 8


@dataclass(frozen=True)
class Walk:
    """Attributes: seconds under way, path [m], fault (its kind, or None), other_gains in the robot than were sent."""

    seconds: float
    path: float
    fault: str | None
    other_gains: bool


def noisy_walk(policy: Path, share: float, seconds: float, life: int) -> Walk:
    """One walk of so many seconds, or until a fault ends it."""
    loaded, timing, fault = Policy.load(policy), Timing(), None
    robot = load_robot(loaded.robot)
    gains = gains_for(robot, loaded)
    port = SimulatedPort(robot, life % ROBOTS, life, drop=share, corrupt=share)
    with on_its_clock(port), RobotLink(robot, port) as link:
        try:
            walk(link, loaded, gains, StopRequest(), command=(SPEED, 0.0), seconds=seconds, timing=timing)
        except RobotFault as error:
            fault = error.kind
    sent = np.float32([gains.kp, gains.kd, gains.max_current])
    other = not np.array_equal(np.float32(port.firmware.gains), sent)
    return Walk(len(timing.sent) * loaded.control_dt, port.path, fault, other)


def figures(long: list[Walk], short: list[Walk]) -> dict[str, float]:
    """What a share of noise did."""
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


def main() -> None:
    """Measure all shares."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=2.0, help="to walk with each share of noise [h]")
    parser.add_argument("--armings", type=int, default=300, help="short walks with each share of noise")
    parser.add_argument("--json", type=Path, required=True, help="file for the figures")
    parser.add_argument("--policy", type=Path, help="policy to walk with; a trot of zero weights if not given")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="processes")
    arguments = parser.parse_args()
    found: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as folder, ProcessPoolExecutor(arguments.workers, get_context("spawn")) as pool:
        policy = arguments.policy or trot_policy(load_robot(DEFAULT_ROBOT), Path(folder))
        for share in SHARES:
            count = max(1, round(3600.0 * arguments.hours / LONG))
            seconds, lives = 3600.0 * arguments.hours / count, range(count, count + arguments.armings)
            long = list(pool.map(partial(noisy_walk, policy, share, seconds), range(count)))
            short = list(pool.map(partial(noisy_walk, policy, share, SHORT), lives))
            found |= {f"{share:g}/{name}": value for name, value in figures(long, short).items()}
            arguments.json.write_text(json.dumps(found, indent=1, sort_keys=True) + "\n")
    for key, value in found.items():
        print(f"{key:32} {value:10.4f}")


if __name__ == "__main__":
    main()
