"""``motorprior deploy|record|doctor`` on the robot's own computer, with numpy, safetensors, pyserial and msgpack.

The same commands and settings as elsewhere, without what those need on top for a simulated robot and a nice terminal.
Also as ``python -m motorprior.hardware``.
"""

from __future__ import annotations

import argparse
import re
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any, get_args, get_type_hints

from motorprior.exceptions import ConfigError, MotorPriorError
from motorprior.hardware.settings import DeploySettings, RecordSettings, require_robot_extra
from motorprior.hardware.terminal import Say, careful
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT

SECONDS = 3.0
IDLE_FIRST = "take the current from the motors first, so that legs can be moved by hand; a standing robot sinks"


def parser() -> argparse.ArgumentParser:
    """The command line, made from the settings and their docstrings."""
    top = argparse.ArgumentParser(prog="motorprior", description="Deploy to, record from, or examine a robot.")
    commands = top.add_subparsers(dest="command", required=True)
    for name, settings in (("deploy", DeploySettings), ("record", RecordSettings), ("doctor", None)):
        command = commands.add_parser(name)
        command.add_argument("--port", help="serial port, for example /dev/ttyACM0; the only one there is if not given")
        command.add_argument("--kind", default=DEFAULT_ROBOT, help="which robot: a shipped one by name")
        if name == "deploy":
            command.add_argument("policy", type=Path, help="policy.safetensors")
        if settings is None:
            command.add_argument("--seconds", type=float, default=SECONDS, help="duration of the check [s]")
            command.add_argument("--idle", action="store_true", help=IDLE_FIRST)
        else:
            _add_options(command, settings)
    return top


def _add_options(command: argparse.ArgumentParser, settings: type) -> None:
    hints, texts = get_type_hints(settings), _texts(settings)
    for field in fields(settings):
        option, kind = f"--{field.name.replace('_', '-')}", hints[field.name]
        if kind is bool:
            command.add_argument(option, action="store_true", help=texts[field.name])
            continue
        choices = [word for words in (kind, *get_args(kind)) for word in get_args(words) if isinstance(word, str)]
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
    say = careful(lambda text: print(text, file=sys.stderr, flush=True), sys.stderr)
    try:
        _require_no_virtual_robot(sys.argv[1:])
        arguments = vars(parser().parse_args())
        require_robot_extra()
        _run(arguments, say)
    except (MotorPriorError, OSError) as error:
        say(f"error: {error.on_command_line() if isinstance(error, MotorPriorError) else error}")
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        raise SystemExit(130) from None


def _require_no_virtual_robot(words: list[str]) -> None:
    """Refuse options that need a simulator, which this computer lacks.

    Raises:
        ConfigError: a virtual robot was asked for.
    """
    asked = [word for word in words if word == "--virtual" or word.startswith("--robot.")]
    if asked:
        raise ConfigError(f"{asked[0]} needs the simulator", remedy="pip install 'motorprior[full,robot]'")


def _run(arguments: dict[str, Any], say: Say) -> None:
    from motorprior.hardware.commands import require_well, run_deploy, run_doctor, run_record, the_port

    command, policy = arguments.pop("command"), arguments.pop("policy", None)
    robot, port = load_robot(arguments.pop("kind")), the_port(arguments.pop("port"))
    if command == "deploy":
        results = run_deploy(robot, policy, port, DeploySettings(**arguments), say)
        for name, value in results.to_figures().items():
            say(f"{name} {value:.4g}")
    elif command == "record":
        say(f"recorded {run_record(robot, port, RecordSettings(**arguments), say)}")
    else:
        found = run_doctor(robot, port, arguments["seconds"], arguments["idle"])
        for line in found:
            say(
                f"{'ok ' if line.well else 'BAD'} {line.check}: {line.finding}"
                + ("" if line.well else f" -> {line.remedy}")
            )
        require_well(found)


if __name__ == "__main__":
    main()
