"""A virtual robot on a pseudo-terminal, in this process or in one of its own.

``python -m motorprior.pipeline.virtual.virtual_robot ROBOT SETTINGS LINK`` is that process; it ends with the one that
started it.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from motorprior.bounds import require_number, require_seed
from motorprior.exceptions import ConfigError, MotorPriorError, RobotFault
from motorprior.hardware.settings import require_robot_extra
from motorprior.pipeline.motor_choice import load_robot_fleet
from motorprior.pipeline.progress import SILENT, Lines, Progress
from motorprior.robots.load import load_robot
from motorprior.scratch import scratch_folder

if TYPE_CHECKING:
    from motorprior.hardware.virtual.virtual_robot import VirtualRobot
    from motorprior.pipeline.virtual.twin_body import TwinBody
    from motorprior.robots.robot import Robot

RATES = (100, 200)
LONGEST_DELAY = 2.0
"""[s]."""
_LONGEST_START = 60.0


@dataclass(frozen=True)
class Virtual:
    """A robot that is not there: pseudo-terminal, firmware, and the twin in real time."""

    fleet: str | None = None
    """Fleet that its motors are drawn from; the robot's own if not given."""
    seed: int = 0
    """Number of the robot: another one has other motors."""
    hung: bool = False
    """Hang it in the air instead of laying it on the ground."""
    rate: int = 100
    """Telemetry frames per second, 100 or 200."""
    currents: bool = False
    """Firmware with currents compiled in."""
    imu: bool = True
    """Firmware that reads the IMU; the present one sends zeros."""
    homing: bool = True
    """Home at the start."""
    drop: float = 0.0
    """Share of frames that are lost, both ways [-]."""
    corrupt: float = 0.0
    """Share of frames that are damaged, both ways [-]."""
    duplicate: float = 0.0
    """Share of frames that come twice, both ways [-]."""
    delay: float = 0.0
    """Delay of every frame, both ways [s]."""
    fault: tuple[str, ...] = ()
    """Faults, KIND:JOINT@SECONDS or KIND@SECONDS, for example frozen:FR_knee@8 or unplugged@10."""


def make(robot: Robot, config: Virtual) -> tuple[VirtualRobot, TwinBody]:
    """A robot and its body; nothing lives yet.

    Raises:
        ConfigError, ArtifactError: settings out of range, an unknown fleet or fault.
    """
    require_robot_extra()
    from motorprior.hardware.virtual.firmware import FirmwareConfig
    from motorprior.hardware.virtual.injected import NoisyLine, parse_fault
    from motorprior.hardware.virtual.virtual_robot import VirtualRobot
    from motorprior.pipeline.virtual.twin_body import TwinBody, draw_motors

    require_seed(config.seed)
    require_number("delay", config.delay, most=LONGEST_DELAY)
    for name in ("drop", "corrupt", "duplicate"):
        require_number(name, getattr(config, name), most=1.0)
    if config.rate not in RATES:
        raise ConfigError(f"rate {config.rate} is no rate of the firmware", remedy="give 100 or 200", argument="rate")
    faults = [parse_fault(robot, text) for text in config.fault]
    motors = draw_motors(robot, load_robot_fleet(robot, config.fleet), config.seed)
    body = TwinBody(robot, motors, config.hung, config.seed)
    firmware = FirmwareConfig(1000 // config.rate, config.currents, config.imu, config.homing)
    lines = [
        NoisyLine(
            config.drop, config.corrupt, config.duplicate, config.delay, np.random.default_rng([config.seed, way])
        )
        for way in (0, 1)
    ]
    return VirtualRobot(robot, body, firmware, faults, *lines), body


def serve(
    robot: Robot,
    config: Virtual,
    link: Path | None = None,
    seconds: float | None = None,
    with_parent: bool = False,
    progress: Progress = SILENT,
) -> dict[str, Any]:
    """Live until Ctrl-C, a signal or the end of ``seconds``; returns what the robot went through.

    Args:
        robot: one with a wire.
        config: which of its kind, and what is wrong with it.
        link: name for its pseudo-terminal.
        seconds: lifetime [s]; without end if not given.
        with_parent: end with the process that started this one, however that ends.
        progress: where to report to.

    Raises:
        ConfigError, ArtifactError: settings out of range, an unknown fleet or fault, or a link that cannot be made.
    """
    if seconds is not None:
        require_number("seconds", seconds)
    parent = os.getppid()
    virtual, body = make(robot, config)
    start = body.live.state().base
    with _ended_by_signals(virtual.stop, seconds), _named(link, virtual.port):
        progress.note(f"virtual robot number {config.seed} on {link or virtual.port}")
        virtual.run(lambda: with_parent and os.getppid() != parent)
    end = body.live.state()
    forward, left = (end.base - start)[:2]
    progress.note(f"virtual robot: went {forward:+.2f} m forward, {left:+.2f} m left, now {virtual.firmware.mode}")
    return {"path_m": body.path} | _life(virtual, forward, left, end.attitude)


@contextlib.contextmanager
def _ended_by_signals(stop: Callable[[], None], seconds: float | None) -> Iterator[None]:
    """Ctrl-C, a polite kill or the end of ``seconds`` [s] call ``stop`` while this is open."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)
    before = {number: signal.signal(number, lambda *_: stop()) for number in numbers}
    signal.setitimer(signal.ITIMER_REAL, 0.0 if seconds is None else max(1e-3, seconds))
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, handler in before.items():
            signal.signal(number, handler)


def _life(robot: VirtualRobot, forward: float, left: float, attitude: np.ndarray) -> dict[str, Any]:
    targets = [at for at, what in robot.events if what == "target"]
    return {
        "started": robot.started,
        "forward_m": float(forward),
        "left_m": float(left),
        "tilt_rad": float(np.abs(attitude[:2]).max()),
        "targets": len(targets),
        "mode": robot.firmware.mode,
        "received_bytes": robot.received,
        "modes": [[at, what] for at, what in robot.events if what != "target"],
        "target_times": targets,
    }


@contextlib.contextmanager
def _named(link: Path | None, port: str) -> Iterator[None]:
    """A name for the port, which appears at once or not at all, while this is open.

    Raises:
        ConfigError: the link cannot be made.
    """
    if link is None:
        yield
        return
    if link.exists() and not link.is_symlink():
        raise ConfigError("there is a file already", where=link, remedy="choose another link")
    temporary = link.with_name(f".{link.name}.{os.getpid()}")
    try:
        link.parent.mkdir(parents=True, exist_ok=True)
        temporary.symlink_to(port)
        os.replace(temporary, link)
    except OSError as error:
        raise ConfigError(f"cannot make the link ({error.strerror})", where=link, remedy="choose another") from error
    try:
        yield
    finally:
        link.unlink(missing_ok=True)


@contextlib.contextmanager
def living(robot_name: str, config: Virtual) -> Iterator[str]:
    """A virtual robot in a process of its own while this is open; gives its port.

    Raises:
        RobotFault: it did not start.
    """
    with scratch_folder() as folder:
        link = folder / "port"
        command = [sys.executable, "-P", "-m", __name__, robot_name, json.dumps(asdict(config)), str(link)]
        process = subprocess.Popen(command, start_new_session=True)
        try:
            _wait_for(link, process)
            if config.homing:
                time.sleep(_HOMING)
            yield str(link)
        finally:
            process.send_signal(signal.SIGTERM)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(timeout=10.0)
            process.kill()


_HOMING = 1.0
"""A bit longer than homing takes [s]."""


def _wait_for(link: Path, process: subprocess.Popen) -> None:
    deadline = time.monotonic() + _LONGEST_START
    while not link.is_symlink():
        if process.poll() is not None or time.monotonic() > deadline:
            raise RobotFault("no port", "the virtual robot did not start", remedy="see what it printed above")
        time.sleep(0.02)


def _main(robot_name: str, settings: str, link: str) -> None:
    """The process of `living`."""
    values = json.loads(settings)
    config = Virtual(**values | {"fault": tuple(values["fault"])})
    try:
        serve(load_robot(robot_name), config, Path(link), with_parent=True, progress=Lines(sys.stderr))
    except MotorPriorError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None


if __name__ == "__main__":
    _main(*sys.argv[1:])
