"""Dynamixel servos of the X series with Protocol 2.0, such as the XL330.

Units: ROBOTIS e-Manual. The torque is limited by the goal PWM, which is in the RAM; the register
`current_limit` is in the EEPROM, and never written here. The bus watchdog is in the RAM: 20 ms per
unit, 0 is off, -1 states that it has stopped the servo, whose goals are then read-only until 0 is
written.
"""

import math
from dataclasses import replace

from motorprior.hardware.buses.frames import DYNAMIXEL_FORMAT
from motorprior.hardware.buses.rustypot_bus import ServoFamily

_REVOLUTION_PER_MINUTE = 2.0 * math.pi / 60.0  # [rad/s]
_SPEED = 0.229 * _REVOLUTION_PER_MINUTE
DYNAMIXEL_XL330 = ServoFamily(
    name="Dynamixel XL330",
    controller="Xl330PyController",
    format=DYNAMIXEL_FORMAT,
    baud_rates=(1_000_000, 57_600, 2_000_000, 3_000_000, 4_000_000, 115_200),
    counts=4096,
    registers={
        "firmware": "firmware_version",
        "voltage": "present_input_voltage",
        "temperature": "present_temperature",
        "min_voltage": "min_voltage_limit",
        "max_voltage": "max_voltage_limit",
        "max_temperature": "temperature_limit",
        "p_gain": "position_p_gain",
        "i_gain": "position_i_gain",
        "d_gain": "position_d_gain",
        "profile_speed": "profile_velocity",
        "acceleration": "profile_acceleration",
        "torque_limit": "goal_pwm",
        "bus_watchdog": "bus_watchdog",
        "min_position": "min_position_limit",
        "max_position": "max_position_limit",
        "offset": "homing_offset",
        "return_delay": "return_delay_time",
        "torque_enable": "torque_enable",
        "status": "hardware_error_status",
        "goal_position": "goal_position",
        "position": "present_position",
        "speed": "present_velocity",
        "load": "present_pwm",
        "current": "present_current",
    },
    block=("present_pwm", "present_temperature"),
    full_torque=885,
    speed_unit=_SPEED,
    profile_unit=_SPEED,
    acceleration_unit=214.577 / 60.0 * _REVOLUTION_PER_MINUTE,
    load_unit="0.113 % of the full PWM",
    current_unit="1 mA",
    conditions={0: "voltage", 2: "temperature", 3: "encoder", 4: "current", 5: "overload"},
    ram_start=64,
    fast_sync_read=True,
    status_register="hardware_error_status",
    watchdog_unit=0.02,
)
DYNAMIXEL_X430 = replace(
    DYNAMIXEL_XL330,
    name="Dynamixel X430",
    controller="Xl430PyController",
    current_unit="2.69 mA (XM430), or 0.1 % of the load (XL430)",
)
