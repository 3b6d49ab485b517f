"""Every fault of the table of servos in docs/hardware.md, in simulated time."""

import resource
import signal
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from servo_bench import BAR, TestBus, feetech_arm, xl330_pendulum

from motorprior.artifacts import read_json
from motorprior.commands.servo_bus import recorded_motor, recorded_robot
from motorprior.exceptions import ArtifactError, ConfigError, RobotFault
from motorprior.excitation.servo_motion import motion_range, servo_parts
from motorprior.hardware.servo_run import (
    RECORDING,
    RecordedRobot,
    ServoSettings,
    diagnose_servos,
    record_servos,
)
from motorprior.robots.servos import MotionPart
from motorprior.robots.so101.robot import SO101


@dataclass
class Incident:
    """A recording during which something happened."""

    bench: TestBus
    folder: Path
    error: Exception | None = None
    messages: list[str] = field(default_factory=list)

    @property
    def fault(self) -> str:
        """Name of the fault that ended the recording."""
        return self.error.name if isinstance(self.error, RobotFault) else repr(self.error)

    @property
    def torque_is_off(self) -> bool:
        return not any(servo.get("torque_enable") for servo in self.bench.virtual.servos)

    @property
    def sank(self) -> bool:
        """Whether the torque limit was lowered to 15 %, instead of a return to rest."""
        return round(0.15 * 885) in self.bench.torque_limits

    @property
    def outcome(self) -> str:
        return str(read_json(self.folder / "run.json")["outcome"])


def pendulum_robot(bench: TestBus) -> RecordedRobot:
    return recorded_motor(bench.chain.model, bench.chain.ids[0], BAR, bench.chain.zeros[0])


@pytest.fixture
def record(tmp_path: Path) -> Iterator[Callable[..., Incident]]:
    """Function that records a pendulum; ``happens`` is called when the first part begins."""
    with xl330_pendulum() as bench:

        def run(
            happens: Callable[[TestBus], object] = lambda _: None,
            before: Callable[[TestBus], object] = lambda _: None,
            profile: str = "keep",
            plan: Callable | None = None,
            lower: float | None = None,
        ) -> Incident:
            incident = Incident(bench, tmp_path / "run")
            robot = pendulum_robot(bench)
            if lower is not None:
                robot = replace(robot, lower=np.array([lower]))

            def show(text: str) -> None:
                incident.messages.append(text)
                if text.startswith("1 of"):
                    happens(bench)

            def parts(period: float, lower: np.ndarray, upper: np.ndarray) -> list[MotionPart]:
                motion = motion_range(robot.joint_names, lower, upper, None, 0.5)
                return servo_parts(robot.joint_names, motion, period=period, seconds=4.0)

            settings = ServoSettings(out=incident.folder, yes=True, profile=profile)
            before(bench)
            try:
                record_servos(robot, bench.client, bench.virtual, plan or parts, settings, show)
            except (RobotFault, ArtifactError, ConfigError, ValueError) as error:
                incident.error = error
            return incident

        yield run


def registers(bench: TestBus) -> list[bytes]:
    """Everything in the memory that a host can write, except the goal."""
    memories = []
    for servo in bench.virtual.servos:
        memory = bytearray(servo.memory)
        address, size = servo.table.registers["goal_position"]
        memory[address : address + size] = bytes(size)
        sensors = min(servo.table.registers[name][0] for name in ("position", "load", "moving"))
        memories.append(bytes(memory[:sensors]))
    return memories


def test_a_recording_ends_at_rest_without_torque_and_with_its_registers(record: Callable):
    memories = []

    incident = record(before=lambda bench: memories.extend(registers(bench)), profile="off")

    assert incident.error is None
    assert incident.outcome == "time"
    assert incident.torque_is_off
    assert registers(incident.bench) == memories
    assert incident.bench.eeprom_writes == 0
    assert abs(incident.bench.virtual.joint_pos()[0]) < 0.1


def of_servo(change: Callable) -> Callable[[TestBus], object]:
    return lambda bench: change(bench.virtual.servos[0])


FAULTS = {
    "temperature": of_servo(lambda servo: setattr(servo, "temperature", 65.0)),
    "voltage": lambda bench: bench.virtual.set_supply(4.0),
    "stuck": lambda bench: bench.virtual.block(0),
    "silence": of_servo(lambda servo: setattr(servo, "answers", False)),
    "encoder": of_servo(lambda servo: setattr(servo, "jumps", True)),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_ends_the_recording_without_torque(record: Callable, fault: str):
    incident = record(FAULTS[fault])

    assert incident.fault == fault
    assert incident.outcome == fault
    if fault == "silence":  # a servo that is gone gets no command
        return
    assert incident.torque_is_off
    assert incident.sank == (fault != "temperature")  # a hot servo returns to rest


@pytest.mark.parametrize("condition", ["overload", "encoder", "current", "voltage", "temperature"])
def test_a_condition_of_the_servo_ends_the_recording(record: Callable, condition: str):
    incident = record(of_servo(lambda servo: servo.condition(condition, True)))

    assert incident.fault == condition
    assert incident.torque_is_off
    assert incident.sank


def test_a_stale_position_is_noticed(record: Callable):
    incident = record(of_servo(lambda servo: setattr(servo, "stale", True)))

    assert incident.fault in ("stuck", "tracking")
    assert incident.torque_is_off


def test_a_hot_servo_returns_to_rest_before_it_is_released(record: Callable):
    incident = record(FAULTS["temperature"])

    assert not incident.sank
    assert abs(incident.bench.virtual.joint_pos()[0]) < 0.1


def test_a_slow_host_returns_to_rest(record: Callable):
    # shorter than the patience of the watchdogs
    incident = record(lambda bench: bench.virtual.wait_until(bench.virtual.clock() + 0.15))

    assert incident.fault == "slow host"
    assert incident.torque_is_off
    assert not incident.sank
    assert abs(incident.bench.virtual.joint_pos()[0]) < 0.1


@pytest.mark.parametrize("share", [0.02, 0.05])
def test_single_lost_and_damaged_answers_do_not_end_the_recording(record: Callable, share: float):
    def disturb(bench: TestBus) -> None:
        bench.virtual.lost = share
        bench.virtual.damaged = share

    incident = record(disturb)

    assert incident.error is None
    assert "0 lost" not in incident.messages[-1]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_returns_to_rest_and_switches_the_torque_off(
    record: Callable, number: signal.Signals
):
    incident = record(lambda _: signal.raise_signal(number))

    assert incident.error is None
    assert incident.outcome == number.name
    assert incident.torque_is_off
    assert not incident.sank
    assert abs(incident.bench.virtual.joint_pos()[0]) < 0.1
    # the parts after the first were not played, and no message states them
    assert not any(text.startswith("2 of") for text in incident.messages)
    assert f"until {number.name}" in incident.messages[-1]


def test_a_second_ctrl_c_switches_the_torque_off_at_once(record: Callable):
    times = []

    def twice(bench: TestBus) -> None:
        signal.raise_signal(signal.SIGINT)
        times.append(bench.virtual.clock())
        signal.raise_signal(signal.SIGINT)

    incident = record(twice)

    assert incident.fault == "stopped"
    assert incident.torque_is_off
    assert incident.bench.virtual.clock() - times[0] < 0.1


def test_a_full_disk_returns_to_rest(record: Callable):
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)

    def fill_disk(bench: TestBus) -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, limit[1]))

    try:
        incident = record(fill_disk)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
        signal.signal(signal.SIGXFSZ, handler)

    assert isinstance(incident.error, ArtifactError)
    assert incident.torque_is_off
    assert not incident.sank
    assert abs(incident.bench.virtual.joint_pos()[0]) < 0.1


def test_an_exception_returns_to_rest(record: Callable):
    def fails(_: TestBus) -> None:
        raise ValueError("no plan")

    incident = record(fails)

    assert incident.fault == "ValueError('no plan')"
    assert incident.torque_is_off
    assert not incident.sank
    assert abs(incident.bench.virtual.joint_pos()[0]) < 0.1


def test_a_target_that_is_not_finite_returns_to_rest(record: Callable):
    def fails(period: float, *_: np.ndarray) -> list[MotionPart]:
        targets = np.linspace(0.0, 0.4, 100)[:, None]
        targets[60:] = np.nan
        return [MotionPart("bad", targets)]

    incident = record(plan=fails)

    assert incident.fault == "impossible command"
    assert incident.torque_is_off
    assert not incident.sank
    assert abs(incident.bench.virtual.joint_pos()[0]) < 0.1


def test_a_joint_that_does_not_follow_its_first_motion_gets_no_full_torque(record: Callable):
    incident = record(before=lambda bench: bench.virtual.block(0))

    assert incident.fault == "first motion"
    assert incident.torque_is_off
    assert not any(message.startswith("1 of") for message in incident.messages)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (of_servo(lambda servo: servo.condition("overload", True)), "overload"),
        (of_servo(lambda servo: servo.set("torque_enable", 1)), "torque on"),
        (of_servo(lambda servo: setattr(servo, "answers", False)), "silence"),
    ],
)
def test_nothing_is_written_to_a_robot_that_is_not_ready(
    record: Callable, change: Callable, fault: str
):
    memories = []

    def prepare(bench: TestBus) -> None:
        change(bench)
        memories.extend(registers(bench))

    incident = record(before=prepare)

    assert incident.fault == fault
    assert registers(incident.bench) == memories
    assert not incident.folder.exists()


def test_a_moving_robot_gets_no_torque(record: Callable):
    def drop(bench: TestBus) -> None:
        client = bench.client
        client.ids = bench.chain.ids
        client.write_goals(client.read().counts + 600)
        client.set_torque(True)
        bench.virtual.wait_until(bench.virtual.clock() + 1.0)
        client.set_torque(False)

    incident = record(before=drop)

    assert incident.fault == "moving"
    assert incident.torque_is_off


def test_a_robot_outside_its_limits_gets_no_torque(record: Callable):
    incident = record(lower=0.3)

    assert incident.fault == "position"
    assert incident.torque_is_off
    assert incident.bench.torque_limits == []


def test_nothing_is_written_without_a_motion_to_play(record: Callable):
    def refused(period: float, *_: np.ndarray) -> list[MotionPart]:
        raise ConfigError("collision")

    incident = record(plan=refused)

    assert isinstance(incident.error, ConfigError)
    assert incident.bench.torque_limits == []


def test_the_torque_is_low_until_the_first_motion_has_followed(record: Callable):
    limits = []

    def plan(period: float, lower: np.ndarray, upper: np.ndarray) -> list[MotionPart]:
        return [MotionPart("still", np.zeros((100, 1)))]

    def note(bench: TestBus) -> None:
        limits.append(bench.virtual.servos[0].get("torque_limit"))

    incident = record(plan=plan, happens=note)

    assert incident.error is None
    assert limits == [885]
    assert incident.bench.torque_limits[:2] == [pytest.approx(0.4 * 885, abs=1), 885]


def test_a_recording_is_not_overwritten(record: Callable, tmp_path: Path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / RECORDING).write_text("mine")

    incident = record()

    assert isinstance(incident.error, ArtifactError)
    assert (tmp_path / "run" / RECORDING).read_text() == "mine"


def test_the_same_seed_gives_the_same_recording(tmp_path: Path):
    texts = []
    for number in range(2):
        with xl330_pendulum() as bench:
            robot = pendulum_robot(bench)
            settings = ServoSettings(out=tmp_path / str(number), yes=True)

            def plan(period: float, *_: np.ndarray) -> list[MotionPart]:
                return [MotionPart("sine", 0.3 * np.sin(np.arange(0.0, 6.0, 0.05))[:, None])]

            path = record_servos(robot, bench.client, bench.virtual, plan, settings, lambda _: None)
            texts.append(path.read_text())

    assert texts[0] == texts[1]


def stop_by_silence(bench: TestBus) -> None:
    """A host that moves a servo slowly dies with its watchdog, or its cable is pulled."""
    client = bench.client
    client.ids = bench.chain.ids
    goal = client.read().counts + 600.0
    client.set_profile(np.array([1.0]), np.array([5.0]))
    client.write_goals(client.read().counts)
    client.set_torque(True)
    client.set_bus_watchdog(np.array([0.5]))
    client.write_goals(goal)
    bench.virtual.wait_until(bench.virtual.clock() + 2.0)


def test_servos_that_hear_nothing_stop_where_they_are():
    with xl330_pendulum() as bench:
        start = bench.virtual.joint_pos()
        stop_by_silence(bench)
        stopped = bench.virtual.joint_pos()
        servo = bench.virtual.servos[0]

        assert servo.get("bus_watchdog") == -1
        assert servo.get("torque_enable") == 1
        # 600 counts are 0.92 rad; at 1 rad/s it is half-way after 0.5 s
        assert 0.2 < (stopped - start)[0] < 0.6

        bench.client.write_goals(bench.client.read().counts + 300.0)
        bench.virtual.wait_until(bench.virtual.clock() + 0.5)

        np.testing.assert_allclose(bench.virtual.joint_pos(), stopped, atol=0.05)


def test_feetech_servos_that_hear_nothing_go_to_their_goal():
    with feetech_arm() as bench:
        client = bench.client
        client.ids = bench.chain.ids
        ones = np.ones(len(client.ids))
        goal = client.read().counts + 300.0 * (np.arange(6) == 0)
        client.set_profile(0.0 * ones, 5.0 * ones)
        client.write_goals(client.read().counts)
        client.set_torque(True)
        client.set_bus_watchdog(0.5 * ones)  # they have none
        client.write_goals(goal)
        bench.virtual.wait_until(bench.virtual.clock() + 2.0)

        assert client.read().counts[0] == pytest.approx(goal[0], abs=15)


def test_servos_that_a_silence_has_stopped_are_refused_released_and_recorded(record: Callable):
    incident = record(before=stop_by_silence)

    assert incident.fault == "torque on"
    bench = incident.bench

    diagnose_servos(
        pendulum_robot(bench), bench.client, bench.virtual, 1.0, idle=True, show=lambda _: None
    )
    bench.virtual.wait_until(bench.virtual.clock() + 3.0)

    assert incident.torque_is_off
    assert bench.virtual.servos[0].get("bus_watchdog") == 0
    again = record()

    assert again.error is None
    assert again.torque_is_off


def test_servos_have_a_bus_watchdog_during_a_recording(record: Callable):
    values = []

    def note(bench: TestBus) -> None:
        values.append(bench.virtual.servos[0].get("bus_watchdog"))

    incident = record(note)

    assert values == [25], "0.5 s in units of 20 ms"
    assert incident.bench.virtual.servos[0].get("bus_watchdog") == 0


def test_a_homing_offset_excludes_the_bus_watchdog(record: Callable):
    values = []

    def note(bench: TestBus) -> None:
        values.append(bench.virtual.servos[0].get("bus_watchdog"))

    record(note, before=of_servo(lambda servo: servo.set("offset", 100)))

    assert values == [0]


@pytest.mark.slow
def test_an_arm_is_recorded_and_a_joint_that_is_held_ends_it(tmp_path: Path):
    with feetech_arm() as bench:
        robot = replace(recorded_robot(SO101))
        settings = ServoSettings(out=tmp_path / "run", yes=True)

        def plan(period: float, lower: np.ndarray, upper: np.ndarray) -> list[MotionPart]:
            motion = motion_range(robot.joint_names, lower, upper, SO101.nominal_pose, 0.5)
            return servo_parts(robot.joint_names, motion, period=period, seconds=40.0)

        def show(text: str) -> None:
            if text.startswith("5 of"):
                bench.virtual.block(1)

        with pytest.raises(RobotFault, match="shoulder_lift"):
            record_servos(robot, bench.client, bench.virtual, plan, settings, show)
    assert bench.eeprom_writes == 0
