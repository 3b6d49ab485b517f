"""Injected faults of line, encoders, motors and cables, each from a stated time on."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from motorprior.exceptions import ConfigError
from motorprior.hardware.framing import COMMAND_FRAMING
from motorprior.hardware.virtual.firmware import LARGEST_CURRENT, Sensors
from motorprior.robots.robot import Robot

KINDS = (
    *("frozen", "jumping", "stalled", "dead", "hot_current", "hot_motor", "surge"),
    *("tilted", "numb", "blind", "flat", "mute", "lagging", "deaf", "restart", "unplugged"),
)
_WITH_JOINT = KINDS[:7]
_FORM = re.compile(r"(?P<kind>\w+?)(:(?P<joint>\w+))?(@(?P<at>[0-9.]+))?$")
JUMP = 0.8
"""[rad] to either side, in turn at every frame."""
LAG = 0.5
"""[s] by which telemetry comes later, for every second that the fault lasts: buffers fill up."""


@dataclass(frozen=True)
class Fault:
    """A fault of one part.

    Attributes:
        kind: frozen or jumping (encoder), stalled or dead (motor), hot_current (9.5 A), hot_motor (95 °C), surge (a
            current at which the firmware gives up), tilted (the IMU reads 1 rad), numb (the IMU repeats itself), blind
            (the IMU reads 0), flat (17 V), mute (no telemetry), lagging (telemetry comes later and later), deaf (it
            reads no bytes any more), restart (its clock begins at 0 again), unplugged.
        at: time since the robot started [s].
        joint: index, where the kind has one.
    """

    kind: str
    at: float
    joint: int = 0


def parse_fault(robot: Robot, text: str) -> Fault:
    """The fault that a text names: ``frozen:FR_knee@5`` is a knee whose encoder freezes 5 s after the start.

    ``unplugged@8`` has no joint.

    Raises:
        ConfigError: another form, kind or joint.
    """
    found = _FORM.match(text)
    kind, joint = (found["kind"], found["joint"]) if found else ("", None)
    number = re.fullmatch(r"\d+(\.\d*)?", found["at"] or "0") if found else None
    with_joint, names = kind in _WITH_JOINT, robot.joint_names
    if kind not in KINDS or number is None or (joint in names) != with_joint or (joint and not with_joint):
        raise ConfigError(
            f"fault {text!r} is unknown", argument="fault",
            remedy=f"give KIND:JOINT@SECONDS with KIND of {', '.join(_WITH_JOINT)}, or KIND@SECONDS with one of "
            f"{', '.join(kind for kind in KINDS if kind not in _WITH_JOINT)}",
        )  # fmt: skip
    index = names.index(joint) if joint in names else 0
    return Fault(kind, float(number.group()), index)


class FaultySensors:
    """Sensors with faults.

    Args:
        faults: those of other kinds are passed over; more may come later.
    """

    def __init__(self, faults: Sequence[Fault]):
        self._faults, self._frozen = faults, dict[int, float]()

    def __call__(self, sensors: Sensors, now: float) -> Sensors:
        """Measurements at ``now`` [s], the faults included."""
        pos, vel, current = sensors.pos.copy(), sensors.vel.copy(), sensors.current.copy()
        attitude, rates = sensors.attitude.copy(), sensors.rates
        temperature, battery = sensors.temperature, sensors.battery
        for fault in self._faults:
            if now < fault.at:
                continue
            if fault.kind == "frozen":
                pos[fault.joint] = self._frozen.setdefault(fault.joint, float(pos[fault.joint]))
                vel[fault.joint] = 0.0
            elif fault.kind == "jumping":
                pos[fault.joint] += JUMP * (1 if round(100.0 * now) % 2 else -1)
            elif fault.kind == "hot_current":
                current[fault.joint] = 9.5
            elif fault.kind == "surge":
                current[fault.joint] = 1.2 * LARGEST_CURRENT
            elif fault.kind == "hot_motor":
                temperature = np.where(np.arange(len(pos)) == fault.joint, 95.0, 40.0)
            elif fault.kind == "tilted":
                attitude[0] = 1.0
            elif fault.kind == "numb":
                attitude, rates = np.full(3, 0.01), np.zeros(3)
            elif fault.kind == "blind":
                attitude, rates = np.zeros(3), np.zeros(3)
            elif fault.kind == "flat":
                battery = 17.0
        return Sensors(pos, vel, current, attitude, rates, temperature, battery)


@dataclass
class NoisyLine:
    """A line that drops, damages, repeats and delays pieces of what goes over it: frames, see `CommandCutter`.

    Attributes:
        drop: chance that a piece is lost.
        corrupt: chance that one of its bytes becomes another.
        duplicate: chance that it comes twice.
        delay: [s] that every piece waits.
        rng: of all that.
    """

    drop: float = 0.0
    corrupt: float = 0.0
    duplicate: float = 0.0
    delay: float = 0.0
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))

    def __post_init__(self) -> None:
        self._waiting: list[tuple[float, bytes]] = []

    def put(self, piece: bytes, now: float) -> None:
        """Put a piece onto the line at ``now`` [s]."""
        if not piece or self.rng.random() < self.drop:
            return
        if self.rng.random() < self.corrupt:
            at = int(self.rng.integers(len(piece)))
            piece = piece[:at] + bytes([piece[at] ^ int(self.rng.integers(1, 256))]) + piece[at + 1 :]
        self._waiting += [(now + self.delay, piece)] * (2 if self.rng.random() < self.duplicate else 1)

    def take(self, now: float) -> bytes:
        """Pieces that come out by ``now`` [s], joined."""
        ready = [piece for at, piece in self._waiting if at <= now]
        self._waiting = [(at, piece) for at, piece in self._waiting if at > now]
        return b"".join(ready)

    def due(self) -> float:
        """When the next piece comes out [s]."""
        return min((at for at, _ in self._waiting), default=float("inf"))


class CommandCutter:
    """Cuts what a host sends into its frames, so that noise hits each by itself however the bytes were read.

    Bytes that are no frame are passed on as they are, up to the next start; a part of a frame is kept until the rest
    comes, as the firmware's own reader does.
    """

    def __init__(self) -> None:
        self._rest = b""

    def cut(self, data: bytes) -> list[bytes]:
        """Pieces that ``data`` completes, in order; joined, every byte that came but those of a part of a frame."""
        self._rest += data
        pieces = []
        while (size := self._next_size()) > 0:
            pieces.append(self._rest[:size])
            self._rest = self._rest[size:]
        return pieces

    def _next_size(self) -> int:
        """Length of the first piece [bytes]; 0 while it is not complete."""
        start, rest = COMMAND_FRAMING.start, self._rest
        head = len(start) + COMMAND_FRAMING.length_bytes
        if not rest.startswith(start):
            at = rest.find(start)
            return at if at > 0 else len(rest)
        if len(rest) < head:
            return 0
        length = int.from_bytes(rest[len(start) : head], "big")
        if not 0 < length <= COMMAND_FRAMING.largest:
            return len(start)
        return head + length if len(rest) >= head + length else 0
