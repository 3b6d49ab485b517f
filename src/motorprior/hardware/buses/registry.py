"""Names of servos. To add a bus, add a file with its `ServoFamily` or `ServoBus`, and an entry."""

from typing import NamedTuple

from motorprior.exceptions import ConfigError
from motorprior.hardware.buses.dynamixel import DYNAMIXEL_X430, DYNAMIXEL_XL330
from motorprior.hardware.buses.feetech import FEETECH
from motorprior.hardware.buses.rustypot_bus import ServoFamily


class ServoKind(NamedTuple):
    """A servo that a user names."""

    family: ServoFamily
    motor: str  # in logs and priors


SERVOS = {
    "STS3215": ServoKind(FEETECH, "Feetech STS3215"),
    "STS3250": ServoKind(FEETECH, "Feetech STS3250"),
    "XL330-M288": ServoKind(DYNAMIXEL_XL330, "XL330-M288"),
    "XL330-M077": ServoKind(DYNAMIXEL_XL330, "XL330-M077"),
    "XL430-W250": ServoKind(DYNAMIXEL_X430, "XL430-W250"),
    "XM430-W350": ServoKind(DYNAMIXEL_X430, "XM430-W350"),
}


def servo_kind(name: str) -> ServoKind:
    """The servo of this name; raises ConfigError for an unknown one."""
    if name not in SERVOS:
        raise ConfigError(
            f"servo {name!r} is unknown", remedy=f"use one of {', '.join(SERVOS)}", argument="motor"
        )
    return SERVOS[name]
