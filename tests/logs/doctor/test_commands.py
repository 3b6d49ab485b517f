"""Doctor of commands: logged too slowly, the torque of the law as feed-forward, torque off."""

import numpy as np
import pytest
from motor_logs import log_of, of_check

from motorprior.logs.doctor.checks import check_log
from motorprior.logs.motor_log import MotorLog

PERIOD = 0.005  # [s]
TIME = PERIOD * np.arange(8000)
FREQUENCY = np.array([0.13, 0.31, 0.7, 1.3])  # [Hz]
SINES = np.sin(2 * np.pi * FREQUENCY * TIME[:, None] + np.arange(4.0))
SMOOTH = (SINES / (1.0 + 2.0 * FREQUENCY)).sum(axis=1)
SLOW = np.repeat(SMOOTH[::10], 10)  # the command at 20 Hz, held


def answer(command: np.ndarray, kp: float = 200.0, kd: float = 20.0) -> np.ndarray:
    """Angle of a joint of unit inertia under a PD, at 1 ms, with encoder noise."""
    angle = np.zeros(len(command))
    q = command[0]
    dq = 0.0
    for row, target in enumerate(command):
        angle[row] = q
        for _ in range(5):
            dq += 0.001 * (kp * (target - q) - kd * dq)
            q += 0.001 * dq
    return angle + 1e-4 * np.random.default_rng(0).standard_normal(len(command))


def moved(command: np.ndarray, kd: float) -> np.ndarray:
    """Angle of a joint of unit inertia with velocity targets, or damped with torques if kd is 0."""
    angle = np.zeros(len(command))
    q = 0.0
    dq = 0.0
    for row, value in enumerate(command):
        angle[row] = q
        for _ in range(5):
            torque = kd * (value - dq) if kd else value - 30.0 * dq
            dq += 0.001 * torque
            q += 0.001 * dq
    return angle + 1e-4 * np.random.default_rng(0).standard_normal(len(command))


def mit_log(feedforward: np.ndarray) -> MotorLog:
    angle = answer(SMOOTH)
    return log_of(TIME, SMOOTH, angle, command_mode="mit", torque_feedforward=feedforward[:, None])


def test_a_command_that_was_sent_faster_than_logged_is_reported():
    (finding,) = of_check(check_log(log_of(TIME, SLOW, answer(SMOOTH))), "command_rate")

    assert finding.severity == "warning"
    assert finding.value == pytest.approx(50.0)
    assert "log every command" in finding.remedy


@pytest.mark.parametrize(
    ("mode", "channel"), [("velocity", "velocity_target"), ("torque", "torque_feedforward")]
)
@pytest.mark.parametrize("is_slow", [True, False])
def test_velocities_and_torques_that_were_sent_faster_than_logged_are_reported(
    mode: str, channel: str, is_slow: bool
):
    velocity = np.gradient(SMOOTH, TIME)
    sent = {"velocity": velocity, "torque": 30.0 * velocity}[mode]
    angle = moved(sent, kd={"velocity": 20.0, "torque": 0.0}[mode])
    logged = sent if not is_slow else np.repeat(sent[::10], 10)
    commands = {channel: logged[:, None], "command_mode": mode}

    findings = of_check(check_log(log_of(TIME, angle, angle, **commands)), "command_rate")

    assert len(findings) == is_slow


def driven(sent: dict[str, np.ndarray], kp: np.ndarray, kd: np.ndarray) -> np.ndarray:
    """Angle of a joint of unit inertia in MIT mode, at 1 ms, with encoder noise."""
    angle = np.zeros(len(TIME))
    q = sent["position_target"][0]
    dq = 0.0
    for row in range(len(TIME)):
        angle[row] = q
        for _ in range(5):
            torque = kp[row] * (sent["position_target"][row] - q)
            torque += kd[row] * (sent["velocity_target"][row] - dq)
            dq += 0.001 * (torque + sent["torque_feedforward"][row])
            q += 0.001 * dq
    return angle + 1e-4 * np.random.default_rng(0).standard_normal(len(TIME))


@pytest.mark.parametrize("is_slow", [True, False])
@pytest.mark.parametrize("mode", ["mit", "velocity"])
def test_slow_commands_are_found_at_gains_that_ramp_and_between_steps(mode: str, is_slow: bool):
    ramp = np.minimum(1.0, 0.1 + TIME / 4.0)
    kp = 200.0 * ramp if mode == "mit" else 0.0 * ramp
    kd = 20.0 * ramp
    steps = 0.6 * np.sign(np.sin(2.0 * np.pi * 0.21 * TIME))
    still = np.abs(np.sin(2.0 * np.pi * 0.11 * TIME)) < 0.3
    target = np.where(still, 0.0, SMOOTH) + steps
    velocity = np.gradient(SMOOTH, TIME) if mode == "mit" else np.gradient(SMOOTH, TIME) + steps
    sent = {
        "position_target": target,
        "velocity_target": velocity,
        "torque_feedforward": 5.0 * np.sin(3.0 * TIME) if mode == "mit" else 0.0 * TIME,
    }
    angle = driven(sent, kp, kd)

    logged = {name: np.repeat(values[::10], 10) for name, values in sent.items()}
    columns = {name: values[:, None] for name, values in (logged if is_slow else sent).items()}
    target = columns.pop("position_target")[:, 0] if mode == "mit" else angle
    if mode == "mit":
        columns["logged_kp"] = kp[:, None]
    log = log_of(TIME, target, angle, command_mode=mode, logged_kd=kd[:, None], **columns)

    assert len(of_check(check_log(log), "command_rate")) == is_slow


SENT = {
    "position_target": SMOOTH,
    "velocity_target": np.gradient(SMOOTH, TIME),
    "torque_feedforward": 30.0 * np.sin(3.0 * TIME),
}


@pytest.mark.parametrize("knows_load", [True, False])
@pytest.mark.parametrize(
    ("channel", "factor", "check"),
    [
        ("velocity_target", -1.0, "velocity_target"),
        ("velocity_target", 57.3, "velocity_target"),
        ("velocity_target", 1.0 / 6.28, "velocity_target"),
        ("torque_feedforward", -1.0, "commanded_torque"),
        ("torque_feedforward", 1000.0, "commanded_torque"),
        ("torque_feedforward", 1.0, ""),
    ],
)
def test_commands_of_another_sign_or_unit_are_reported(
    channel: str, factor: float, check: str, knows_load: bool
):
    kp = np.full(len(TIME), 200.0)
    kd = np.full(len(TIME), 20.0)
    angle = driven(SENT, kp, kd)
    columns = {name: values[:, None] for name, values in SENT.items()}
    columns[channel] = factor * columns[channel]
    del columns["position_target"]
    ones = np.ones_like(angle)[:, None]
    if knows_load:
        columns |= {"load_inertia": ones, "external_torque": 0.0 * ones}
    gains = {"logged_kp": 200.0 * ones, "logged_kd": 20.0 * ones}
    log = log_of(TIME, SMOOTH, angle, command_mode="mit", **gains, **columns)

    report = check_log(log)

    for name in ("velocity_target", "commanded_torque"):
        findings = of_check(report, name)
        assert len(findings) == (name == check)
        if findings and channel == "velocity_target":
            assert findings[0].value == pytest.approx(-1.0 if factor < 0 else factor, rel=0.1)
        elif findings:
            assert findings[0].value == pytest.approx(1.0 / factor, rel=0.1)


@pytest.mark.parametrize("factor", [-1.0, 57.3])
def test_velocity_commands_are_compared_with_the_motion(factor: float):
    sent = np.gradient(SMOOTH, TIME)
    angle = moved(sent, kd=20.0)

    def findings(target: np.ndarray) -> list:
        log = log_of(TIME, angle, angle, command_mode="velocity", velocity_target=target[:, None])
        return of_check(check_log(log), "velocity_target")

    assert findings(factor * sent)
    assert findings(np.gradient(angle, TIME))  # the measured velocity
    assert not findings(sent)


def test_a_torque_command_of_another_sign_is_reported_without_a_load():
    sent = 30.0 * np.gradient(SMOOTH, TIME)
    angle = moved(sent, kd=0.0)

    for sign in (1.0, -1.0):
        columns = {"command_mode": "torque", "torque_feedforward": sign * sent[:, None]}
        log = log_of(TIME, angle, angle, **columns)
        assert len(of_check(check_log(log), "commanded_torque")) == (sign < 0.0)


@pytest.mark.parametrize(("command", "kp"), [(SLOW, 200.0), (SLOW, 40.0), (SMOOTH, 200.0)])
def test_a_command_that_was_logged_as_it_was_sent_is_not(command: np.ndarray, kp: float):
    log = log_of(TIME, command, answer(command, kp))

    assert not of_check(check_log(log), "command_rate")


def test_a_feed_forward_torque_that_is_the_torque_of_the_law_is_an_error():
    angle = answer(SMOOTH)
    law = 80.0 * (SMOOTH - angle) - 2.5 * np.gradient(angle, TIME)

    (finding,) = of_check(check_log(mit_log(law)), "feedforward")

    assert finding.severity == "error"
    assert "80" in finding.message
    assert not of_check(check_log(mit_log(3.0 * np.sin(SMOOTH))), "feedforward")


def test_a_joint_whose_torque_goes_off_is_reported_with_its_row():
    driven = answer(SMOOTH, 2000.0, 60.0)
    angle = driven.copy()
    falling = np.exp(-4.0 * (TIME[5600:] - TIME[5600]))
    angle[5600:] = -1.5 + (angle[5600] + 1.5) * falling

    findings = of_check(check_log(log_of(TIME, SMOOTH, angle)), "torque_off")

    assert len(findings) == 1
    assert findings[0].row == pytest.approx(5600, abs=150)
    assert not of_check(check_log(log_of(TIME, SMOOTH, driven)), "torque_off")


@pytest.mark.parametrize("is_on", [True, False])
def test_a_joint_that_feed_forward_torques_move_against_its_target_has_torque(is_on: bool):
    angle = answer(SMOOTH, 2000.0, 60.0)
    torque = np.repeat(np.random.default_rng(3).uniform(-8.0, 8.0, 200), 40)  # for 0.2 s each
    q = angle[5600]
    dq = 0.0
    for row in range(5600, len(angle)):
        angle[row] = q
        for _ in range(5):
            dq += 0.001 * (is_on * torque[row] - 9.0 * (q + 1.5) - 3.0 * dq)
            q += 0.001 * dq
    commands = {"command_mode": "mit", "torque_feedforward": torque[:, None]}

    findings = of_check(check_log(log_of(TIME, SMOOTH, angle, **commands)), "torque_off")

    assert len(findings) == (not is_on)


@pytest.mark.parametrize("mode", ["mit", "torque"])
@pytest.mark.parametrize(
    ("rows", "period", "rows_between_gaps", "rows_of_segment"),
    [(35, 0.002, 35, 35), (600, 0.001, 60, 600), (700, 0.001, 700, 70), (24, 0.02, 24, 24)],
    ids=["short", "gaps", "segments", "slow"],
)
def test_a_torque_in_a_short_window_is_not_judged(
    mode: str, rows: int, period: float, rows_between_gaps: int, rows_of_segment: int
):
    count = np.arange(rows)
    time = period * (count + 50 * (count // rows_between_gaps))
    target = 0.5 * np.sin(20.0 * time)
    angle = 0.5 * np.sin(20.0 * time - 0.3)
    commands = {"command_mode": mode, "torque_feedforward": np.cos(50.0 * time)[:, None]}

    segment = count // rows_of_segment
    report = check_log(log_of(time, target, angle, segment=segment, **commands))

    assert not of_check(report, "commanded_torque")


def test_slow_commands_are_compared_in_a_window_shorter_than_the_longest_delay():
    count = np.arange(600)
    time = 0.001 * (count + 50 * (count // 60))
    smooth = 0.5 * np.sin(60.0 * time)
    held = smooth[count // 3 * 3]
    angle = smooth + 1e-4 * np.cos(900.0 * time)

    assert not of_check(check_log(log_of(time, held, angle)), "command_rate")


def test_a_command_that_is_never_far_from_a_step_is_not_called_slow():
    changes = np.tile([0.3, 0.01, -0.3, -0.01], 100)
    command = np.repeat(np.cumsum(changes), 5)  # every other change is a step
    time = PERIOD * np.arange(len(command))

    assert not of_check(check_log(log_of(time, command, answer(command))), "command_rate")


def test_a_torque_is_not_blamed_for_a_position_target_of_another_sign():
    kp = np.full(len(TIME), 200.0)
    kd = np.full(len(TIME), 20.0)
    angle = driven(SENT, kp, kd)
    torque = {"torque_feedforward": SENT["torque_feedforward"][:, None]}
    gains = {"logged_kp": kp[:, None], "logged_kd": kd[:, None]}
    log = log_of(TIME, -SMOOTH, angle, command_mode="mit", **gains, **torque)

    assert not of_check(check_log(log), "commanded_torque")
