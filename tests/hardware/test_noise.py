"""Noise on the line, in simulated time: minutes of walking in seconds, and the same ones every time."""

import gc
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import noise
from motorprior.artifacts import read_json
from motorprior.hardware.robot_link import RobotLink
from motorprior.logs.formats.robot_run import Mode
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from noise import figures, main, noisy_walk
from simulated_port import SimulatedPort, on_its_clock


@pytest.mark.parametrize("life", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_with_three_percent_lost_and_three_damaged_it_walks_on(trot: Path, life: int):
    """A gain or current limit that is repeated while it walks, and damaged, ended such walks within a minute or two."""
    walk = noisy_walk(trot, 0.03, 180.0, life)
    assert walk.fault is None
    assert walk.seconds == pytest.approx(180.0, abs=0.1) and walk.path > 30.0


def test_a_walk_in_simulated_time_repeats_to_the_last_bit(trot: Path):
    assert noisy_walk(trot, 0.05, 3.0, 2) == noisy_walk(trot, 0.05, 3.0, 2)


def test_a_line_that_loses_nearly_everything_is_a_fault(trot: Path):
    """And the figures say which."""
    walk = noisy_walk(trot, 0.6, 10.0, 0)
    assert walk.fault == "stale telemetry"
    assert figures([noisy_walk(trot, 0.0, 1.0, 0)], [walk])["fault/stale telemetry"] == 1.0


def test_no_step_leaves_garbage_that_nobody_collects(trot: Path):
    """The collector is off while a robot moves: cycles would fill the memory of a long walk."""

    def left_by(seconds: float) -> int:
        gc.collect()
        gc.disable()
        try:
            noisy_walk(trot, 0.02, seconds, 0)
            return gc.collect()
        finally:
            gc.enable()

    left_by(0.5)
    short, long = left_by(0.5), left_by(6.0)
    assert long - short < 50, "550 control steps more"


class _Wiretap(SimulatedPort):
    """Keeps what was sent."""

    def __init__(self) -> None:
        super().__init__(PUPPER_V2, 0)
        self.keys: list[str] = []

    def send(self, command):
        self.keys += [name for name, value in vars(command).items() if value is not None]
        return super().send(command)


def test_gains_go_over_the_line_with_the_first_targets_only():
    port = _Wiretap()
    with on_its_clock(port), RobotLink(PUPPER_V2, port) as robot:
        robot.receive(0.1)
        robot.arm(spec.WIRE_KP, spec.WIRE_KD, spec.MAX_CURRENT)
        for _ in range(50):
            robot.send(spec.NOMINAL_POSE, Mode.RAMP)
            robot.receive(port.now + 0.01)
        sent = list(port.keys)
    law = ["kp", "kd", "max_current", "pos"]
    assert sent == 3 * law + 47 * ["pos"]


@pytest.mark.slow
def test_the_benchmark_tells_of_every_share(trot: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    out = tmp_path / "noise.json"
    words = ["--hours", "0.001", "--armings", "2", "--workers", "1", "--policy", str(trot), "--json", str(out)]
    monkeypatch.setattr(sys, "argv", ["noise", *words])
    main()
    found = read_json(out)
    assert found["0.01/walked_h"] == pytest.approx(0.001, rel=0.01) and found["0.1/armed"] == 2.0
    assert {name.split("/")[0] for name in found} == {"0.01", "0.03", "0.1"}


class _Doubled(SimulatedPort):
    """Doubles kp in the last of the commands with gains."""

    laws = 0

    def send(self, command):
        if command.kp is not None:
            self.laws += 1
            if self.laws == 3:
                command = replace(command, kp=2.0 * command.kp)
        return super().send(command)


def test_a_gain_that_was_damaged_is_counted_though_it_walks(trot: Path, monkeypatch: pytest.MonkeyPatch):
    assert not noisy_walk(trot, 0.0, 1.0, 0).other_gains
    monkeypatch.setattr(noise, "SimulatedPort", _Doubled)
    damaged = noisy_walk(trot, 0.0, 1.0, 0)
    assert damaged.other_gains and damaged.fault is None
    assert figures([damaged], [damaged])["other_gains"] == 2.0
