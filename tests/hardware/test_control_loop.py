"""How well a clock was kept is counted as it says."""

from types import SimpleNamespace

import numpy as np
import pytest

from motorprior.hardware import control_loop
from motorprior.hardware.control_loop import ControlLoop, Timing, clock_results
from motorprior.hardware.protocol import Telemetry
from motorprior.hardware.telemetry_stream import Measurement
from motorprior.logs.formats.robot_run import Mode
from motorprior.robots.pupper_v2.robot import PUPPER_V2

WIRE = PUPPER_V2.require_wire()
ZEROS = dict.fromkeys(("ts", "yaw", "pitch", "roll", "yaw_rate", "pitch_rate", "roll_rate"), 0.0)


class Clock:
    """Time passes when somebody waits or works; also the robot that lives by it, and is always well."""

    def __init__(self):
        self.now, self.pauses = 100.0, 0

    def monotonic(self) -> float:
        return self.now

    def receive(self, until: float) -> None:
        self.now = max(self.now, until)

    def check(self) -> Measurement:
        return Measurement(Telemetry(**ZEROS, pos=np.zeros(12), vel=np.zeros(12)), self.now - 0.0015, self.now - 0.002)

    def send(self, target: np.ndarray, mode: Mode) -> float:
        return self.now

    def resume_after_pause(self) -> None:
        self.pauses += 1


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(control_loop, "time", SimpleNamespace(monotonic=made.monotonic))
    return made


def play(clock: Clock, work: list[float], after: dict[int, float] | None = None) -> Timing:
    """One step per entry, which computes for so long [s]; what follows its command may take time too."""
    timing, step = Timing(), -1

    def motion(_: Measurement) -> np.ndarray | None:
        nonlocal step
        step += 1
        if step == len(work):
            return None
        clock.now += work[step]
        return np.zeros(12)

    def after_step(_: Measurement) -> None:
        clock.now += (after or {}).get(step, 0.0)

    loop = ControlLoop(clock, WIRE.safety, 0.01, lambda: False)  # pyright: ignore[reportArgumentType]
    loop.play(motion, Mode.WALK, after_step, timing)
    return timing


def test_a_command_that_leaves_late_is_missed_also_if_its_step_began_in_time(clock: Clock):
    figures = clock_results([play(clock, [0.0] * 5 + [0.009] + [0.0] * 4)], 0.01).to_figures()
    assert figures["missed_share"] == pytest.approx(0.1)
    assert figures["period_jitter_ms/max"] == pytest.approx(9.0, abs=0.1)


def test_steps_that_are_left_out_are_missed(clock: Clock):
    timing = play(clock, [0.0] * 10, after={4: 0.025})
    assert timing.skipped == 2 and clock_results([timing], 0.01).to_figures()["missed_share"] == pytest.approx(2 / 12)


def test_figures_of_a_clock_equal_arithmetic():
    timing = Timing()
    timing.sent.extend([0.010, 0.020, 0.031, 0.041, 0.061])
    timing.late.extend([0.0, 0.001, 0.006, 0.0, 0.0])
    timing.age.extend([0.002] * 4 + [0.012])
    timing.skipped = 1
    figures = clock_results([timing], 0.01).to_figures()
    assert figures["period_jitter_ms/max"] == pytest.approx(10.0)
    assert figures["period_jitter_ms/p50"] == pytest.approx(0.5)
    assert figures["missed_share"] == pytest.approx(2 / 6)  # one 6 ms late, one left out, of six
    assert (figures["telemetry_age_ms/p50"], figures["telemetry_age_ms/max"]) == pytest.approx((2.0, 12.0))
    assert not clock_results([Timing()], 0.01)
