"""``motorprior deploy|record|doctor`` on the robot's own computer, with numpy, pyserial and msgpack.

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

from motorprior.exceptions import MotorPriorError
from motorprior.hardware.commands import careful, require_well, run_deploy, run_doctor, run_record, the_port
from motorprior.hardware.settings import DeploySettings, RecordSettings

SECONDS = 3.0
IDLE_FIRST = "take the current from the motors first, so that legs can be moved by hand; a standing robot sinks"


def parser() -> argparse.ArgumentParser:
    """The command line, made from the settings and their docstrings."""
    top = argparse.ArgumentParser(prog="motorprior", description="Deploy to, record from, or examine a robot.")
    commands = top.add_subparsers(dest="command", required=True)
    for name, settings in (("deploy", DeploySettings), ("record", RecordSettings), ("doctor", None)):
        command = commands.add_parser(name)
        command.add_argument("--port", help="serial port, for example /dev/ttyACM0; the only one there is if not given")
        if name == "deploy":
            command.add_argument("policy", type=Path, help="policy.safetensors")
        if settings is None:
            command.add_argument("--seconds", type=float, default=SECONDS, help="time to listen [s]")
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
        choices = [choice for choice in get_args(kind) if isinstance(choice, str)]
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
    arguments = vars(parser().parse_args())
    say = careful(lambda text: print(text, file=sys.stderr, flush=True), sys.stderr)
    command, port, policy = arguments.pop("command"), arguments.pop("port"), arguments.pop("policy", None)
    try:
        _run(command, the_port(port), policy, arguments, say)
    except (MotorPriorError, OSError) as error:
        say(f"error: {error}")
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        raise SystemExit(130) from None


def _run(command: str, port: str, policy: Path | None, arguments: dict[str, Any], say: Any) -> None:
    if command == "deploy" and policy is not None:
        figures = run_deploy(policy, port, DeploySettings(**arguments), say)
        for name, value in figures.items():
            say(f"{name} {value:.4g}")
    elif command == "record":
        say(f"recorded {run_record(port, RecordSettings(**arguments), say)}")
    else:
        found = run_doctor(port, arguments["seconds"], arguments["idle"])
        for line in found:
            say(
                f"{'ok ' if line.well else 'BAD'} {line.check}: {line.finding}"
                + ("" if line.well else f" -> {line.remedy}")
            )
        require_well(found)


if __name__ == "__main__":
    main()
