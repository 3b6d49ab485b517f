"""A recording is what happened, survives its writer, and is a motor log."""

from pathlib import Path

import numpy as np
from telemetry import telemetry

from motorprior.hardware.commands import run_record
from motorprior.hardware.robot_link import Recorder
from motorprior.hardware.settings import RecordSettings
from motorprior.hardware.telemetry_stream import Measurement
from motorprior.logs.doctor.checks import check_log
from motorprior.logs.readers.robot_run import Mode, read_robot_run
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from simulated_port import SimulatedPort, on_its_clock

LAG = 0.0025  # between a measurement and the command that follows it [s]


def measured(time: float) -> Measurement:
    pos = spec.NOMINAL_POSE + 0.2 * np.sin(3.0 * time)
    frame = telemetry(ts=round(1e3 * time), roll=0.01, pos=pos, vel=0.6 * np.cos(3.0 * time) * np.ones(12))
    return Measurement(frame, 100.0 + time, 100.0 + time)


def target_at(step: int) -> np.ndarray:
    return spec.NOMINAL_POSE + 0.2 * np.sin(0.03 * step + 0.1)


def recorded(path: Path) -> Path:
    """Each command is sent LAG after a measurement, at 100 Hz."""
    recorder = Recorder(PUPPER_V2, path)
    for step in range(200):
        recorder.write(measured(0.01 * step))
        recorder.sent(100.0 + 0.01 * step + LAG, target_at(step), Mode.EXCITE)
    recorder.close()
    return path


def test_a_row_holds_the_command_in_force_when_it_was_measured(tmp_path: Path):
    log = read_robot_run(recorded(tmp_path / "run.csv"), PUPPER_V2)
    assert log.num_rows == 199, "before the first command there is nothing to record"
    np.testing.assert_allclose(log.time, 0.01 * np.arange(1, 200), atol=1e-9)
    np.testing.assert_allclose(log.position_target[10], target_at(10), atol=1e-6)
    np.testing.assert_allclose(log.joint_pos[10], spec.NOMINAL_POSE + 0.2 * np.sin(0.33), atol=1e-6)
    assert log.joint_torque is None and log.joint_names == spec.JOINT_NAMES
    assert check_log(log, PUPPER_V2).usable


def test_a_cut_last_line_does_not_count(tmp_path: Path):
    path = recorded(tmp_path / "run.csv")
    path.write_bytes(path.read_bytes()[:-7])
    assert read_robot_run(path, PUPPER_V2).num_rows == 198


def test_pauses_and_other_modes_start_new_segments(tmp_path: Path):
    recorder = Recorder(PUPPER_V2, tmp_path / "run.csv")
    for step in range(400):
        mode = Mode.RAMP if step < 100 else Mode.WALK if step < 200 else Mode.EXCITE
        if not 300 <= step < 310:
            recorder.write(measured(0.01 * step))
        recorder.sent(100.0 + 0.01 * step + LAG, target_at(step), mode)
    recorder.close()
    log = read_robot_run(tmp_path / "run.csv", PUPPER_V2)
    assert [part.stop - part.start for part in log.segment_slices()] == [100, 99, 90]


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
        settings = RecordSettings(tmp_path, excitation="sine", seconds=2.0, yes=True)
        run_record(PUPPER_V2, port.port, settings, lambda _: None)
    log = read_robot_run(tmp_path / "run.csv", PUPPER_V2, period=0.001)
    first, count, acted = round(1e3 * log.time[0]), log.num_rows - 20, np.array(port.targets)
    errors = {
        late: float(np.sqrt(np.mean((log.position_target[10 : 10 + count] - acted[first + 10 + late :][:count]) ** 2)))
        for late in range(-4, 5)
    }
    assert min(errors, key=lambda late: errors[late]) == 0, errors
