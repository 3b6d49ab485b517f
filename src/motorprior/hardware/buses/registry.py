"""Names of servos. To add a bus, add a file with its `ServoBus` and opener, and an entry here."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from motorprior.exceptions import ConfigError
from motorprior.hardware.buses.bus import Clock, ServoBus
from motorprior.hardware.buses.dynamixel import DYNAMIXEL_X430, DYNAMIXEL_XL330
from motorprior.hardware.buses.feetech import FEETECH


class BusOpener(Protocol):
    """Opens a bus; a `ServoFamily` for rustypot's buses."""

    def open(
        self,
        port: str,
        clock: Clock,
        ids: Sequence[int],
        baud_rate: int | None = None,
        timeout: float = 0.03,
    ) -> ServoBus:
        """The bus at a port, on which one of the servos ``ids`` answers within ``timeout`` [s].

        Raises RobotFault if there is none. ``baud_rate`` is the user's; None: the usual ones.
        """
        ...


class ServoKind(NamedTuple):
    """A servo that a user names."""

    family: BusOpener
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
