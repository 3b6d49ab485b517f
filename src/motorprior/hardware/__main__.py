"""``motorprior deploy|record|doctor`` on the robot's own computer, with numpy, safetensors, pyserial and msgpack only.

Same commands and settings as the full command line, without virtual robots. Also as ``python -m
motorprior.hardware``.
"""

import argparse
import re
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any, get_args, get_type_hints

from motorprior.exceptions import MotorPriorError
from motorprior.hardware.settings import DeploySettings, RecordSettings, require_robot_extra
from motorprior.hardware.teleop import Print, non_blocking
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT


def parser() -> argparse.ArgumentParser:
    """The command line, from the settings and their docstrings."""
    usage = "motorprior {deploy,record,doctor} ...; for other commands: pip install motorprior"
    top = argparse.ArgumentParser(
        usage=usage, description="Deploy to, record from, or check a robot."
    )
    commands = top.add_subparsers(dest="command", required=True, prog="motorprior")
    deploy, record, doctor = (commands.add_parser(name) for name in ("deploy", "record", "doctor"))
    for command in (deploy, record, doctor):
        command.add_argument(
            "--port", help="serial port, for example /dev/ttyACM0; the only one if not given"
        )
    deploy.add_argument("policy", type=Path, help="policy.safetensors")
    _add_options(deploy, DeploySettings)
    _add_options(record, RecordSettings)
    doctor.add_argument("--seconds", type=float, default=3.0, help="duration of the check [s]")
    doctor.add_argument(
        "--idle", action="store_true", help="first remove the current: legs move, the robot sinks"
    )
    return top


def _add_options(command: argparse.ArgumentParser, settings: type) -> None:
    """One option per field of a settings dataclass; the help is its line in the docstrings' Attributes."""
    docs = "\n".join(
        (each.__doc__ or "").partition("Attributes:")[2] for each in settings.__mro__[:-1]
    )
    texts = dict(re.findall(r"\n {8}(\w+): ((?:.|\n {9,})*)", docs))
    for field in fields(settings):
        hint = get_type_hints(settings)[field.name]
        option = f"--{field.name.replace('_', '-')}"
        # type of a setting; of an optional one, that of its value
        kind = (get_args(hint) or (hint,))[0]
        how: dict[str, Any] = (
            {"action": "store_true"} if kind is bool else {"type": kind, "default": field.default}
        )
        command.add_argument(
            option, help=" ".join(texts[field.name].split()).replace("%", "%%"), **how
        )


def main() -> None:
    """Run a command line; exit code 2 and one line on bad input or a robot fault."""
    show = non_blocking(lambda text: print(text, file=sys.stderr, flush=True), sys.stderr)
    try:
        _run(show, **vars(parser().parse_args()))
    except (MotorPriorError, OSError) as error:
        show(f"error: {error.on_command_line() if isinstance(error, MotorPriorError) else error}")
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        raise SystemExit(130) from None


def _run(
    show: Print, command: str, port: str | None, policy: Path = Path(), **settings: object
) -> None:
    require_robot_extra()
    from motorprior.hardware.commands import run_deploy, run_doctor, run_record
    from motorprior.hardware.serial_link import resolve_port

    robot = load_robot(DEFAULT_ROBOT)
    found = resolve_port(port)
    if command == "deploy":
        run_deploy(robot, policy, found, DeploySettings(**settings), show)  # pyright: ignore[reportArgumentType]
    elif command == "record":
        run_record(robot, found, RecordSettings(**settings), show)  # pyright: ignore[reportArgumentType]
    else:
        run_doctor(robot, found, show=show, **settings)  # pyright: ignore[reportArgumentType]


if __name__ == "__main__":
    main()
