"""How long a host may stand still while its robot walks: on the twin, in simulated time, the same figures every time.

    python benchmarks/hardware_stalls.py --policy runs/demo/walk/*/policy.safetensors --json stalls.json

While a host stands still the robot's motors hold the last target. Each trial is one walk of one of eight virtual robots
(`simulated_port.py`) that meets one stall, at a time that a seed draws, so at any phase of the gait; no bound of the
host's ends it, but in the kinds that say so. For each length of stall (``--stalls``, in ms) and each kind of trial:
    KIND/MS                share of the trials in which the robot stays upright: it never leans over 0.7 rad, which the
                           host calls a fall, neither before it is sent idle nor, walking on, for three more seconds;
                           of robots that walked before, with a third of the speed that they are told or more
    KIND/longest_ms        the longest stall up to which every robot walked before and stays upright
    KIND/speed             mean speed of these in the second before the stall [m/s]; they are told ``--forward``
    KIND/walking           share of the trials in which the robot walked before
The kinds:
    on                     the host walks on
    watched                the same with the bounds on joints that are stuck or do not follow; any fault is a fall
    down                   the host calls the stall a fault: comes to rest, sits down
    often                  the host walks on, and the stalls come every tenth control step
    again                  the host walks on, and the stalls come every 1.5 s, for nine seconds
    blind                  the host does not stand still, but no telemetry comes for so long
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from hardware import trot_policy
from motorprior.exceptions import RobotFault
from motorprior.hardware.deploy import gains_for, walk
from motorprior.hardware.protocol import Command, Telemetry
from motorprior.hardware.robot_link import RobotLink
from motorprior.hardware.session import StopRequest
from motorprior.locomotion.policy import Policy
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.robots.wire import SafetyLimits
from simulated_port import SimulatedPort, on_its_clock

STALLS = (20, 50, 80, 100, 120, 150, 200, 300, 500)
KINDS = ("on", "watched", "down", "often", "again", "blind")
ROBOTS, DRAWS, FORWARD = 8, 3, 0.4
BEGIN, SPREAD, AFTER = 5.0, 1.0, 3.0
"""The stall comes so long after the start [s], plus up to ``SPREAD``; by then the robot walks, and it walks on for
``AFTER``."""
GAP, LONG_AFTER = {"often": 0.1, "again": 1.5}, 9.0
"""From the end of a stall to the next [s], by kind, 0.1 s are ten control steps; and ``AFTER`` for "again"."""
LEAST_SPEED = 1 / 3
"""Of the speed that it is told, that a robot walks with."""


class StallingPort(SimulatedPort):
    """A robot whose host stands still, or hears nothing, for ``stall`` [s].

    Attributes:
        tilt: the largest of roll and pitch from the stall until the robot is idle [rad].
        speed: mean in the second before the stall [m/s].
    """

    def __init__(self, robot: Robot, number: int, draw: int, stall: float, kind: str):
        super().__init__(robot, number, draw)
        self._stall, self._kind, self._deaf_until = stall, kind, 0.0
        self._next = self.first = BEGIN + SPREAD * np.random.default_rng([number, draw, 0x57A11]).random()
        self.tilt, self.speed, self._was_at = 0.0, 0.0, np.zeros(2)

    def send(self, command: Command) -> float:
        """See `SimulatedPort.send`; where a stall is due, it comes before the command leaves."""
        if self.now < self.first - 1.0:
            self._was_at = self.body.live.position()[:2]
        if command.pos is not None and self.now >= self._next:
            if self.speed == 0.0:
                self.speed = math.dist(self.body.live.position()[:2], self._was_at)
            if self._kind == "blind":
                self._deaf_until = self.now + self._stall
            else:
                self.now += self._stall
            self._next = self.now + GAP.get(self._kind, math.inf)
        return super().send(command)

    def wait(self, until: float) -> list[tuple[float, Telemetry | str]]:
        """See `SimulatedPort.wait`."""
        heard = super().wait(until)
        if self.now >= self.first:
            self.tilt = max(self.tilt, *np.abs(self.body.live.state().attitude[:2]).tolist())
        return [] if self.now < self._deaf_until else heard


class StopAt(StopRequest):
    """Set at a time of the robot's clock [s]."""

    def __init__(self, port: SimulatedPort, end: float):
        super().__init__()
        self._port, self._end = port, end

    def __call__(self) -> bool:
        """See `StopRequest`."""
        if self._port.now >= self._end:
            self.reason = "time"
        return super().__call__()


def trial(policy: Policy, number: int, draw: int, stall: float, kind: str, forward: float) -> tuple[bool, float]:
    """Whether virtual robot ``number`` stays upright, and its speed before the ``stall`` [s]: 0 if it ended before."""
    robot = load_robot(policy.robot)
    port = StallingPort(robot, number, draw, stall, kind)
    limits = bounds(robot.require_wire().safety, stall, kind)
    with on_its_clock(port), RobotLink(robot, port, limits) as link:
        try:
            stop = StopAt(port, port.first + (LONG_AFTER if kind == "again" else AFTER))
            walk(link, policy, gains_for(robot, policy), stop, command=(forward, 0.0))
        except RobotFault as fault:
            if fault.kind != "slow host":
                return False, port.speed
    return port.tilt < limits.max_tilt, port.speed


def bounds(limits: SafetyLimits, stall: float, kind: str) -> SafetyLimits:
    """Bounds of which none ends a walk for a stall [s], but that of "down"; nor for what it does to the joints."""
    never = math.inf
    tick_delay = 0.5 * stall if kind == "down" else never
    limits = replace(limits, tick_delay=tick_delay, late_ticks=100, stalled_time=never, telemetry_age=never)
    return limits if kind == "watched" else replace(limits, stuck_time=never, tracking_time=never)


def shares(policies: list[Policy], kind: str, stalls: Sequence[int], draws: int, forward: float) -> dict[str, float]:
    """The figures of one kind of trial; stalls in ms, in order."""
    found, speeds, longest, count, well = {}, [], 0, 0, True
    for stall in stalls:
        trials = [
            trial(policy, number, draw, 1e-3 * stall, kind, forward)
            for policy in policies
            for number in range(ROBOTS)
            for draw in range(draws)
        ]
        walked = [(upright, speed) for upright, speed in trials if speed >= LEAST_SPEED * forward]
        found[f"{kind}/{stall}"] = float(np.mean([upright for upright, _ in walked] or [False]))
        speeds += [speed for _, speed in walked]
        count += len(trials)
        well = well and len(walked) == len(trials) and found[f"{kind}/{stall}"] == 1.0
        if well:
            longest = stall
    found |= {f"{kind}/longest_ms": float(longest), f"{kind}/speed": float(np.mean(speeds or [0.0]))}
    return found | {f"{kind}/walking": len(speeds) / count}


def main() -> None:
    """Measure every kind."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--policy", type=Path, nargs="*", help="policies to walk with; a trot of zero weights if none")
    parser.add_argument("--kinds", nargs="*", choices=KINDS, default=KINDS, help="kinds of trial")
    parser.add_argument("--stalls", type=int, nargs="*", default=STALLS, help="their lengths, in order [ms]")
    parser.add_argument("--draws", type=int, default=DRAWS, help="trials per policy, robot and length")
    parser.add_argument("--forward", type=float, default=FORWARD, help="speed that the robots are told [m/s]")
    parser.add_argument("--json", type=Path, required=True, help="file for the figures")
    arguments = parser.parse_args()
    found: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as folder:
        paths = arguments.policy or [trot_policy(load_robot(DEFAULT_ROBOT), Path(folder))]
        policies = [Policy.load(path) for path in paths]
        for kind in arguments.kinds:
            found |= shares(policies, kind, arguments.stalls, arguments.draws, arguments.forward)
            arguments.json.write_text(json.dumps(found, indent=1, sort_keys=True) + "\n")
    for key, value in found.items():
        print(f"{key:20} {value:8.3f}")


if __name__ == "__main__":
    main()
