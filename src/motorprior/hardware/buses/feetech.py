"""Feetech servos with a magnetic encoder (STS), such as the STS3215.

Units: Feetech's memory table of these servos. Position, goal and speed have a sign bit 15, the load
bit 10. Bit 2 of the register `phase` selects the unit of speeds: 50 counts/s, or 1 count/s. P, I
and D are in the EEPROM, and never written here.
"""

import math
from collections.abc import Mapping

from motorprior.hardware.buses.frames import FEETECH_FORMAT
from motorprior.hardware.buses.rustypot_bus import ServoFamily

_COUNTS = 4096  # per turn
_COUNT = 2.0 * math.pi / _COUNTS  # [rad]
_FINE_SPEED = 1 << 2


def _speed_unit(registers: Mapping[str, int]) -> float:
    return _COUNT * (1.0 if registers["phase"] & _FINE_SPEED else 50.0)


FEETECH = ServoFamily(
    name="Feetech STS",
    controller="Sts3215PyController",
    format=FEETECH_FORMAT,
    baud_rates=(1_000_000, 500_000, 115_200),
    counts=_COUNTS,
    registers={
        "firmware": "firmware_major_version",
        "firmware_minor": "firmware_minor_version",
        "voltage": "present_voltage",
        "temperature": "present_temperature",
        "min_voltage": "min_voltage_limit",
        "max_voltage": "max_voltage_limit",
        "max_temperature": "max_temperature_limit",
        "phase": "phase",
        "p_gain": "p_coefficient",
        "i_gain": "i_coefficient",
        "d_gain": "d_coefficient",
        "profile_speed": "goal_speed",
        "acceleration": "acceleration",
        "dead_zone": "cw_dead_zone",
        "torque_limit": "torque_limit",
        "min_position": "min_angle_limit",
        "max_position": "max_angle_limit",
        "offset": "offset",
        "return_delay": "return_delay_time",
        "torque_enable": "torque_enable",
        "status": "status",
        "goal_position": "goal_position",
        "position": "present_position",
        "speed": "present_speed",
        "load": "present_load",
        "current": "present_current",
    },
    block=("present_position", "present_current"),
    full_torque=1000,
    speed_unit=_COUNT,
    profile_unit=_COUNT,
    acceleration_unit=100.0 * _COUNT,
    load_unit="0.1 % of the full duty cycle",
    current_unit="6.5 mA",
    conditions={0: "voltage", 1: "encoder", 2: "temperature", 3: "current", 5: "overload"},
    ram_start=40,
    speed_unit_of=_speed_unit,
)
