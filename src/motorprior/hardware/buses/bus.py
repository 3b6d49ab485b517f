"""The interface of a servo bus. A bus is one file, and an entry with its opener in `registry`."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np


class Clock(Protocol):
    """The time of a bus."""

    def clock(self) -> float:
        """The time [s]."""
        ...

    def wait_until(self, end: float) -> None:
        """Return at ``end`` [s]."""

    def written(self) -> None:
        """An instruction without answer was written."""


class MonotonicClock:
    """The monotonic clock of this computer."""

    def clock(self) -> float:
        """See `Clock`."""
        return time.monotonic()

    def wait_until(self, end: float) -> None:
        """See `Clock`."""
        time.sleep(max(0.0, end - time.monotonic()))

    def written(self) -> None:
        """See `Clock`."""


@dataclass(frozen=True)
class ServoInfo:
    """What one servo states about itself."""

    id: int
    model: str
    firmware: str
    voltage: float  # [V]
    temperature: float  # [°C]
    min_voltage: float  # [V]
    max_voltage: float  # [V]
    max_temperature: float  # at which it switches its torque off [°C]
    gains: tuple[int, int, int]  # P, I and D in its own units
    profile_speed: float  # limit of its trajectory profile [rad/s]; 0: off
    profile_acceleration: float  # [rad/s²]; 0: off
    dead_zone: float  # [rad]; 0: off
    torque_limit: float  # share of its full torque, in (0, 1]
    position_limits: tuple[int, int]  # smallest and largest goal [counts]
    offset: int  # homing offset [counts]
    return_delay: float  # [s]
    torque_on: bool
    conditions: tuple[str, ...]  # conditions that keep its torque off, such as "overload"


class Readings(NamedTuple):
    """One reading of all servos, (n,) each, in the servos' own directions."""

    begin: float  # time before the request [s]
    end: float  # time after the last answer [s]
    counts: np.ndarray  # of the encoders
    speed: np.ndarray  # [rad/s]
    load: np.ndarray  # in `ServoBus.load_unit`
    current: np.ndarray  # in `ServoBus.current_unit`
    voltage: np.ndarray  # [V]
    temperature: np.ndarray  # [°C]
    conditions: np.ndarray  # bits; 0: none


class NoAnswer(Exception):
    """A servo did not answer, or its answer was damaged."""


class ServoBus(Protocol):
    """Servos of one kind on an open port. Values are ordered as ``ids``.

    Every write is to the servos' RAM: the settings of their EEPROM stay as they are.

    Attributes:
        ids: the servos that the other methods address.
        counts: encoder counts per turn.
        load_unit: unit of loads.
        current_unit: unit of currents.
    """

    ids: tuple[int, ...]
    counts: int
    load_unit: str
    current_unit: str

    def scan(self, ids: Sequence[int]) -> list[ServoInfo]:
        """The servos with these ids that answer."""
        ...

    def read(self) -> Readings:
        """Read the sensors of all servos; raises NoAnswer or OSError (the port is gone)."""
        ...

    def write_goals(self, counts: np.ndarray) -> None:
        """Write (n,) goal positions [counts]; raises OSError if the port is gone."""

    def set_torque(self, on: bool) -> None:
        """Switch the torque of all servos."""

    def set_torque_limit(self, share: np.ndarray) -> None:
        """Limit the torque to (n,) shares of the full torque."""

    def set_profile(self, speed: np.ndarray, acceleration: np.ndarray) -> None:
        """Set (n,) limits of the trajectory profile [rad/s, rad/s²]; 0: off."""

    def set_bus_watchdog(self, seconds: np.ndarray) -> None:
        """Stop servos that hear no instruction for (n,) times [s]; 0: off.

        Releases a servo that has stopped. Nothing happens where servos have no bus watchdog.
        """

    def release_frame(self, infos: Sequence[ServoInfo]) -> bytes:
        """The bytes that switch all torques off and restore the registers, for the watchdog."""
        ...

    def condition_names(self, bits: int) -> tuple[str, ...]:
        """Names of the conditions in a status."""
        ...

    def close(self) -> None:
        """Release the port."""
