"""Getting up is slow, and so is sitting down, once: a fault on the way goes on with what is left of it."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motorprior.exceptions import RobotFault
from motorprior.hardware.control_loop import ControlLoop
from motorprior.hardware.motions import Motion, played
from motorprior.hardware.recorder import Recorder
from motorprior.hardware.session import Gains, StopRequest, run_armed
from motorprior.hardware.telemetry_stream import Measurement
from motorprior.logs.formats.robot_run import Mode
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.robot import PUPPER_V2

WIRE = PUPPER_V2.require_wire()


def test_who_sits_down_does_not_walk_again(virtual: Callable, host: Callable, sits: Callable, tmp_path: Path):
    """A battery that runs flat on the way down: the rest of the way, not the gait's end once more."""
    pupper, begun = virtual(), 0
    robot = host(pupper.port, recorder=Recorder(PUPPER_V2, tmp_path / "run.csv"))
    robot.limits = replace(robot.limits, slow_speed=1.5)

    def wind_down() -> Motion:
        nonlocal begun
        begun += 1
        rows = iter(20 * [spec.NOMINAL_POSE])

        def target(_: Measurement) -> np.ndarray | None:
            row = next(rows, None)
            if row is None:
                pupper.break_down("flat")
            return row

        return target

    with pytest.raises(RobotFault, match="battery"):
        run_armed(robot, Gains.of(WIRE), StopRequest(), lambda _: None, wind_down=wind_down)
    modes = [int(row.split(",")[1]) for row in (tmp_path / "run.csv").read_text().splitlines()[1:]]
    assert begun == 1 and modes == sorted(modes) and modes[-1] == Mode.CROUCH
    assert sits(pupper)


def test_the_way_up_is_slow_whatever_the_motion_says(
    virtual: Callable, host: Callable, monkeypatch: pytest.MonkeyPatch
):
    """The gate keeps the ramp's speed too, not only the ramp."""
    pupper = virtual()
    robot, row = host(pupper.port), []
    robot.limits = replace(robot.limits, slow_speed=1.5)
    start = robot.check().telemetry.pos
    monkeypatch.setattr(
        "motorprior.hardware.session._to_nominal", lambda *_: played(np.tile(spec.NOMINAL_POSE, (10, 1)))
    )

    def work(_: ControlLoop) -> None:
        row.append(robot.target)

    run_armed(robot, Gains.of(WIRE), StopRequest(), work, crouch=False)
    assert np.abs(spec.NOMINAL_POSE - start).max() > 0.5, "ten steps are too few for it"
    assert np.abs(row[0] - start).max() <= 10 * 2 * spec.CONTROL_DT * 1.5 + 0.05
