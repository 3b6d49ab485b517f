"""What a log states is told with its units, and nothing that it does not state."""

from collections.abc import Callable

import numpy as np

from motorprior.logs.motor_log import MotorLog
from motorprior.logs.stated import stated_in_words


def test_gains_registers_and_postures_are_told_with_their_units(make_log: Callable[..., MotorLog]):
    kp, kd = np.tile([20.0, 40.0], (200, 1)), np.full((200, 2), 1.5)
    posture = np.repeat([0, 3], 100)
    firmware = {"dead_zone": 0.0, "profile_acceleration": 38.9631}
    log = make_log(stated_kp=kp, stated_kd=kd, posture=posture, firmware=firmware)
    assert stated_in_words(log) == (
        "kp 20, 40 N·m/rad; kd 1.5 N·m·s/rad; profile_acceleration 38.96 rad/s²; dead_zone off; "
        "posture standing, fallen"
    )


def test_gains_of_the_firmware_have_its_units_and_many_are_a_range(make_log: Callable[..., MotorLog]):
    kp = np.arange(1.0, 6.0) * np.ones((200, 1))
    names = tuple("abcde")
    log = make_log(stated_kp=kp, gain_unit="firmware", joint_names=names, joint_pos=0 * kp, position_target=0 * kp)
    assert stated_in_words(log) == "kp 1 to 5 in units of the firmware"


def test_conditions_are_told_as_ranges(make_log: Callable[..., MotorLog]):
    volts, degrees = np.full((200, 2), 7.4), np.linspace([25.0, 25.0], [31.0, 40.0], 200)
    log = make_log(supply_voltage=volts, motor_temperature=degrees)
    assert stated_in_words(log) == "supply_voltage 7.4 V; motor_temperature 25 to 40 °C"


def test_of_a_log_that_states_nothing_there_are_no_words(make_log: Callable[..., MotorLog]):
    assert stated_in_words(make_log()) == ""
