"""The servo bus of a robot or a single motor, real or virtual, for record and doctor."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np

from motorprior.commands.robot_port import RobotChoice
from motorprior.commands.virtual_robot import VirtualRobotSettings
from motorprior.exceptions import ConfigError
from motorprior.hardware.buses.bus import Clock, MonotonicClock, ServoBus
from motorprior.hardware.buses.registry import servo_kind
from motorprior.hardware.servo_run import RecordedRobot
from motorprior.robots.robot import Robot
from motorprior.robots.servos import ServoChain

PENDULUM = "pendulum"
_MIDDLE = 2048  # count in the middle of a turn
_REACH = 1.5  # largest angle of a pendulum [rad]
_VIRTUAL_BAUD_RATE = 1_000_000
_VIRTUAL_TIMEOUT = 1.0  # of an answer, in real time: a busy computer is no fault of the bus [s]
# fleets of motors without a robot, by the name of the servo
_FLEETS = {"STS3215": "sts3215.toml", "XL330-M288": "xl330_m288.toml"}


@dataclass(frozen=True)
class Bar:
    """The load of a single motor: a bar with a mass at its end."""

    length: float  # from the shaft to the mass [m]
    mass: float  # [kg]
    bar_mass: float = 0.0  # mass of the bar itself [kg]

    @classmethod
    def parsed(cls, text: str) -> "Bar":
        """The bar of a text such as "0.1m,0.5kg", or "0.1m,0.5kg,0.02kg" with the bar's mass.

        Raises ConfigError.
        """
        units = ("m", "kg", "kg")
        values = []
        for word, unit in zip(text.split(","), units, strict=False):
            try:
                values.append(float(word.strip().removesuffix(unit)))
            except ValueError:
                values.append(-1.0)
        is_complete = 2 <= len(text.split(",")) <= 3
        if not is_complete or min(values) < 0.0 or values[0] * values[1] == 0.0:
            raise ConfigError(
                f"bar {text!r} is not a length and a mass",
                remedy='give for example "0.1m,0.5kg", or "0.1m,0.5kg,0.02kg" with the bar itself',
                argument="bar",
            )
        return cls(*values)


@dataclass(frozen=True)
class OpenBus:
    """An open bus, its clock, and the port for the watchdog (None in simulated time)."""

    bus: ServoBus
    clock: Clock
    watch: str | None


def recorded_robot(robot: Robot) -> RecordedRobot:
    """What a recording states about a robot; ConfigError if its servos are unknown."""
    chain = robot.require_servos()
    return RecordedRobot(
        name=robot.name,
        motor=servo_kind(chain.model).motor,
        joint_names=robot.joint_names,
        joint_classes=robot.joint_classes,
        lower=robot.lower,
        upper=robot.upper,
        chain=chain,
        posture="fixed" if robot.base == "fixed" else "suspended",
        encoder=robot.encoder,
    )


def recorded_motor(model: str, servo: int, bar: Bar, zero: int) -> RecordedRobot:
    """What a recording states about one motor with a pendulum that hangs down at count ``zero``."""
    return RecordedRobot(
        name=PENDULUM,
        motor=servo_kind(model).motor,
        joint_names=(PENDULUM,),
        joint_classes=(PENDULUM,),
        lower=np.array([-_REACH]),
        upper=np.array([_REACH]),
        chain=ServoChain(model, (servo,), (1,), (zero,)),
        posture="fixed",
        pendulum={"length": bar.length, "mass": bar.mass, "bar_mass": bar.bar_mass},
    )


@contextmanager
def opened_bus(
    chain: ServoChain,
    choice: RobotChoice,
    baud_rate: int | None,
    robot: Robot | None,
    bar: Bar | None = None,
) -> Iterator[OpenBus]:
    """The bus at a port, or a virtual one of a robot or of a motor with a bar.

    Raises ConfigError if both port and virtual robot are given, or if the port is not unique.
    """
    if choice.virtual and choice.port is not None:
        raise ConfigError(f"--port {choice.port} and --virtual", remedy="give one of them")
    if choice.virtual:
        with open_virtual_bus(chain, choice.virtual_robot, robot, bar) as opened:
            yield opened
        return
    with open_bus(chain, _port(choice.port), baud_rate) as opened:
        yield opened


def _port(port: str | None) -> str:
    from motorprior.hardware.serial_link import resolve_port  # here: it needs pyserial

    return resolve_port(port)


@contextmanager
def open_bus(chain: ServoChain, port: str, baud_rate: int | None) -> Iterator[OpenBus]:
    """A real bus."""
    clock = MonotonicClock()
    bus = servo_kind(chain.model).family.open(port, clock, chain.ids, baud_rate)
    try:
        yield OpenBus(bus, clock, port)
    finally:
        bus.close()


@contextmanager
def open_virtual_bus(
    chain: ServoChain, settings: VirtualRobotSettings, robot: Robot | None, bar: Bar | None = None
) -> Iterator[OpenBus]:
    """A virtual bus in simulated time, of a robot or of a motor with a pendulum.

    Raises ConfigError for a fleet whose motors have no firmware, or an unknown one.
    """
    # here: the robot's own computer has no simulator
    from motorprior.actuator.fleet import load_fleet
    from motorprior.hardware.buses.virtual_bus import VirtualBus
    from motorprior.hardware.buses.virtual_servo import table_of
    from motorprior.simulation.simulated_servos import (
        Pendulum,
        SimulatedServos,
        draw_servos,
        resting_pose,
    )

    fleet = load_fleet(settings.fleet or chain.fleet or _fleet_file(chain.model))
    motors = draw_servos(fleet, len(chain.ids), settings.seed)
    if robot is None:
        assert bar is not None
        pendulum = Pendulum(bar.length, bar.mass, bar.bar_mass)
        mechanics = SimulatedServos(motors, np.zeros(1), pendulum=pendulum)
    else:
        mechanics = SimulatedServos(motors, resting_pose(robot, motors), robot)

    table = table_of(chain.model)
    with VirtualBus(table, chain, mechanics, _VIRTUAL_BAUD_RATE, seed=settings.seed) as virtual:
        family = servo_kind(chain.model).family
        bus = family.open(virtual.port, virtual, chain.ids, _VIRTUAL_BAUD_RATE, _VIRTUAL_TIMEOUT)
        try:
            yield OpenBus(bus, virtual, None)
        finally:
            bus.close()


def _fleet_file(model: str) -> Path:
    if model not in _FLEETS:
        raise ConfigError(
            f"no virtual {model}", remedy=f"use one of {', '.join(_FLEETS)}", argument="motor"
        )
    return Path(str(files("motorprior.robots.pendulum") / _FLEETS[model]))


def chain_of_one(model: str, servo: int) -> ServoChain:
    """The chain of one motor, whose pendulum hangs down in the middle of the turn."""
    return ServoChain(model, (servo,), (1,), (_MIDDLE,))
