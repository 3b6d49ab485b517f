"""`record` and `doctor` on virtual servo buses, and bad input."""

from collections.abc import Callable
from pathlib import Path

import pytest

from motorprior.hardware import serial_link
from motorprior.logs.load_log import load_log

pytest.importorskip("rustypot", reason="pip install rustypot")


def test_a_recorded_servo_becomes_a_log_with_its_load_and_registers(
    motorprior: Callable, tmp_path: Path
):
    motor = ("--motor", "XL330-M288", "--bar", "0.1m,0.25kg", "--seconds", 4)
    done = motorprior("record", "--virtual", *motor, "--yes", "--out", tmp_path / "run")

    assert done.code == 0, done.err
    assert "XL330M288" in done.err

    recording = tmp_path / "run" / "run.servolog"
    log = load_log(recording)

    assert log.duration == pytest.approx(4.0, abs=0.1)
    assert log.gains is not None
    assert log.gains[0].tolist() == [400.0]
    assert log.firmware["profile_acceleration"] == 0.0
    assert log.firmware["output_encoder"] == 1.0
    assert log.load_inertia is not None

    for command in (("logs", "check", recording), ("logs", "import", recording)):
        out = ("--out", tmp_path / "log") if "import" in command else ()
        done = motorprior(*command, *out)
        assert done.code == 0, done.err


def test_the_doctor_states_servos_and_joint_angles(motorprior: Callable):
    done = motorprior("doctor", "--virtual", "--robot", "so101", "--seconds", 1)

    assert done.code == 0, done.err
    assert done.err.count("STS3215") == 6
    assert "elbow_flex: +1." in done.err


def test_the_doctor_states_one_servo(motorprior: Callable):
    done = motorprior("doctor", "--virtual", "--motor", "XL330-M288", "--id", 7, "--seconds", 1)

    assert done.code == 0, done.err
    assert "servo 7: XL330M288" in done.err
    assert "pendulum: +0.000 rad" in done.err


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("record --motor STS3215 --virtual --yes", "--bar"),
        ("record --motor STS3215 --bar 0.1m --virtual --yes", "bar '0.1m'"),
        ("record --motor STS3215 --bar 0m,1kg --virtual --yes", "bar '0m,1kg'"),
        ("record --motor STS9999 --bar 0.1m,1kg --virtual --yes", "STS9999"),
        ("record --bar 0.1m,1kg --virtual --yes", "--bar has no effect"),
        ("record --robot so101 --joint elbow_flex --virtual --yes", "--joint has no effect"),
        ("record --robot so101 --standing --virtual --yes", "--standing has no effect"),
        ("record --profile off --virtual --yes", "--profile has no effect"),
        ("record --robot so101 --virtual --port /dev/x --yes", "--port /dev/x and --virtual"),
        ("record --robot so101 --port /dev/ttyNONE --yes", "/dev/ttyNONE (No such file"),
        ("record --robot so101 --port /dev/null --yes", "this is no serial port"),
        ("record --robot so101 --virtual --yes --seconds 5", "seconds 5 is too short"),
        ("record --robot so101 --virtual --yes --amplitude 1.5", "comes closer than 5 mm"),
        ("record --robot so101 --virtual", "no terminal to confirm at"),
        ("record --robot so101 --plan --amplitude 1.5", "comes closer than 5 mm"),
        ("record --robot so101 --plan --free-space 0.3", "away from the base"),
        ("record --robot so101 --plan --free-space -1", "--free-space -1 is not"),
        ("record --free-space 0.3 --virtual --yes", "--free-space has no effect"),
    ],
)
def test_bad_input_is_one_line(motorprior: Callable, tmp_path: Path, command: str, words: str):
    out = ("--out", tmp_path / "run") if "record" in command else ()
    done = motorprior(*command.split(), *out)

    assert done.code == 2
    assert words in done.err
    assert "Traceback" not in done.err
    assert not (tmp_path / "run" / "run.servolog").exists()


def test_without_a_port_the_message_names_the_option(
    motorprior: Callable, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(serial_link, "_usb_ports", list)

    done = motorprior("record", "--robot", "so101", "--yes")

    assert done.code == 2
    assert "give --port, such as" in done.err


def test_what_no_bus_is_needed_for_is_refused_before_it_is_opened(
    motorprior: Callable, tmp_path: Path
):
    port = ("record", "--robot", "so101", "--port", "/dev/ttyNONE", "--yes", "--out", tmp_path)

    assert "too short for 6 joints" in motorprior(*port, "--seconds", 5).err

    (tmp_path / "run.servolog").write_text("my only recording")
    assert "exists already" in motorprior(*port).err
    assert (tmp_path / "run.servolog").read_text() == "my only recording"
