"""``motorprior deploy|record|doctor`` on the robot's own computer, with numpy, safetensors, pyserial and msgpack only.

The same commands and settings as elsewhere, but no virtual robot. Also as ``python -m motorprior.hardware``.
"""

from __future__ import annotations

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
    top = argparse.ArgumentParser(prog="motorprior", description="Deploy to, record from, or check a robot.")
    commands = top.add_subparsers(dest="command", required=True)
    for name, settings in (("deploy", DeploySettings), ("record", RecordSettings), ("doctor", None)):
        command = commands.add_parser(name)
        command.add_argument("--port", help="serial port, for example /dev/ttyACM0; the only one if not given")
        command.add_argument("--kind", default=DEFAULT_ROBOT, help="name of a shipped robot")
        if name == "deploy":
            command.add_argument("policy", type=Path, help="policy.safetensors")
        if settings is not None:
            _add_options(command, settings)
        else:
            command.add_argument("--seconds", type=float, default=3.0, help="duration of the check [s]")
            command.add_argument(
                "--idle", action="store_true",
                help="remove the current from the motors first, so that legs move by hand; a standing robot sinks",
            )  # fmt: skip
    return top


def _add_options(command: argparse.ArgumentParser, settings: type) -> None:
    hints, texts = get_type_hints(settings), _texts(settings)
    for field in fields(settings):
        option, kind = f"--{field.name.replace('_', '-')}", hints[field.name]
        if kind is bool:
            command.add_argument(option, action="store_true", help=texts[field.name])
            continue
        choices = [choice for type_ in (kind, *get_args(kind)) for choice in get_args(type_) if isinstance(choice, str)]
        plain = next((inner for inner in get_args(kind) if isinstance(inner, type)), kind)
        command.add_argument(
            option, type=str if choices else plain, choices=choices or None, default=field.default,
            help=texts[field.name].replace("%", "%%"),
        )  # fmt: skip


def _texts(settings: type) -> dict[str, str]:
    """The Attributes section of a docstring, by name."""
    section = (settings.__doc__ or "").partition("Attributes:")[2]
    return {
        name: " ".join(text.split()) for name, text in re.findall(r"(\w+): ((?:.|\n)*?)(?=\n {8}\w+: |\Z)", section)
    }


def main() -> None:
    """Run a command line; exit code 2 and one line on bad input or a robot fault."""
    show = non_blocking(lambda text: print(text, file=sys.stderr, flush=True), sys.stderr)
    try:
        arguments = vars(parser().parse_args())
        require_robot_extra()
        _run(arguments, show)
    except (MotorPriorError, OSError) as error:
        show(f"error: {error.on_command_line() if isinstance(error, MotorPriorError) else error}")
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        raise SystemExit(130) from None


def _run(arguments: dict[str, Any], show: Print) -> None:
    from motorprior.hardware.commands import require_ok, run_deploy, run_doctor, run_record
    from motorprior.hardware.serial_link import resolve_port

    command, policy = arguments.pop("command"), arguments.pop("policy", None)
    robot, port = load_robot(arguments.pop("kind")), resolve_port(arguments.pop("port"))
    if command == "deploy":
        results = run_deploy(robot, policy, port, DeploySettings(**arguments), show)
        for name, value in results.to_figures().items():
            show(f"{name} {value:.4g}")
    elif command == "record":
        show(f"recorded {run_record(robot, port, RecordSettings(**arguments), show)}")
    else:
        checks = run_doctor(robot, port, arguments["seconds"], arguments["idle"])
        for check in checks:
            remedy = "" if check.ok else f" -> {check.remedy}"
            show(f"{'ok ' if check.ok else 'BAD'} {check.name}: {check.finding}{remedy}")
        require_ok(checks)


if __name__ == "__main__":
    main()
