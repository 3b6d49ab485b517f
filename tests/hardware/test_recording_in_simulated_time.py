"""A recording in simulated time: when each target acted on the robot, and the default excitations."""

from pathlib import Path

import numpy as np
import pytest

from motorprior.artifacts import read_json
from motorprior.hardware.commands import run_record
from motorprior.hardware.settings import RecordSettings
from motorprior.logs.formats.robot_run import read_robot_run
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from simulated_port import SimulatedPort, on_its_clock


class _Witness(SimulatedPort):
    """It stores the targets that the motors had in every millisecond."""

    def __init__(self) -> None:
        self.targets: list[np.ndarray] = []
        super().__init__(PUPPER_V2, 0, suspended=True, period=5)
        advance = self.body.advance

        def remembered(milliseconds: int, drive) -> None:
            self.targets += [PUPPER_V2.require_wire().joint_signs * drive.target] * milliseconds
            advance(milliseconds, drive)

        self.body.advance = remembered


def test_targets_on_a_grid_are_those_that_acted(tmp_path: Path):
    port = _Witness()
    with on_its_clock(port):
        run_record(PUPPER_V2, port.port, RecordSettings(tmp_path, "sine", seconds=4.0, yes=True), lambda _: None)
    log = read_robot_run(tmp_path / "run.csv", PUPPER_V2, period=0.001)
    first, count, acted = round(1e3 * log.time[0]), log.num_rows - 20, np.array(port.targets)
    errors = {
        late: float(np.sqrt(np.mean((log.position_target[10 : 10 + count] - acted[first + 10 + late :][:count]) ** 2)))
        for late in range(-4, 5)
    }
    assert min(errors, key=lambda late: errors[late]) == 0, errors


@pytest.mark.parametrize(
    ("excitation", "standing", "speed", "fastest"),
    [(None, False, None, 40.0), (None, True, None, 8.0), ("steps", False, 3.0, 3.0)],
)
def test_steps_are_fast_in_the_air_only(tmp_path: Path, excitation, standing, speed, fastest):
    port = SimulatedPort(PUPPER_V2, 0, suspended=not standing)
    settings = RecordSettings(tmp_path, excitation, seconds=1.0, speed=speed, standing=standing, yes=True)
    with on_its_clock(port):
        run_record(PUPPER_V2, port.port, settings, lambda _: None)
    facts = read_json(tmp_path / "run.json")
    assert facts["safety"]["target_speed"] == facts["settings"]["speed"] == fastest
    assert facts["settings"]["excitation"] == (excitation or ("multisine" if standing else "varied"))
    assert facts["settings"]["amplitude"] == (0.1 if standing else 0.4)
