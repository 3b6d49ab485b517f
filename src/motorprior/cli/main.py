"""The command ``motorprior``: sub-commands in the order of the data flow."""

from __future__ import annotations

import os
import sys
from functools import partial
from typing import Annotated, Any, NoReturn, Union

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before numpy: two BLAS threads make small products ten times slower

import tyro  # noqa: E402

from motorprior.cli.console import CONSOLE, TERMINAL  # noqa: E402
from motorprior.cli.demo import demo  # noqa: E402
from motorprior.cli.logs import LogsCheck, LogsImportCommand, run_logs_check  # noqa: E402
from motorprior.cli.motors import (  # noqa: E402
    AdaptCommand,
    IdentifyCommand,
    ValidateCommand,
    ValidateLogCommand,
    adapt,
    validate,
    validate_log,
)
from motorprior.cli.play import PlayCommand, play  # noqa: E402
from motorprior.cli.replay import CalibrateCommand, ReplayCommand, calibrate, replay  # noqa: E402
from motorprior.cli.report import MakeReport, run_report  # noqa: E402
from motorprior.cli.robot import Deploy, Doctor, Record, deploy, doctor, record  # noqa: E402
from motorprior.cli.transfer import TransferCommand, transfer  # noqa: E402
from motorprior.cli.walk import WalkCommand, walk  # noqa: E402
from motorprior.commands.bench import Bench, run_bench  # noqa: E402
from motorprior.commands.demo import Demo  # noqa: E402
from motorprior.commands.identify import run_identify  # noqa: E402
from motorprior.commands.logs_import import import_logs  # noqa: E402
from motorprior.commands.simulate import Simulate, run_simulate  # noqa: E402
from motorprior.exceptions import MotorPriorError  # noqa: E402

LOGS: dict[str, tuple[type, Any]] = {
    "import": (LogsImportCommand, partial(import_logs, progress=TERMINAL)),
    "check": (LogsCheck, run_logs_check),
}
COMMANDS: dict[str, tuple[type, Any]] = {
    "demo": (Demo, demo),
    "calibrate": (CalibrateCommand, calibrate),
    "bench": (Bench, partial(run_bench, progress=TERMINAL)),
    "identify": (IdentifyCommand, partial(run_identify, progress=TERMINAL)),
    "validate": (ValidateCommand, validate),
    "validate-log": (ValidateLogCommand, validate_log),
    "adapt": (AdaptCommand, adapt),
    "simulate": (Simulate, partial(run_simulate, progress=TERMINAL)),
    "replay": (ReplayCommand, replay),
    "walk": (WalkCommand, walk),
    "play": (PlayCommand, play),
    "transfer": (TransferCommand, transfer),
    "doctor": (Doctor, doctor),
    "deploy": (Deploy, deploy),
    "record": (Record, record),
    "report": (MakeReport, run_report),
}
RUN = dict([*LOGS.values(), *COMMANDS.values()])


def _one_of(commands: dict[str, tuple[type, Any]]) -> list[Any]:
    return [Annotated[settings, tyro.conf.subcommand(name)] for name, (settings, _) in commands.items()]


def parse(args: list[str]) -> object:
    """Parse a command line into settings.

    Raises:
        SystemExit: code 2 for a wrong command line, 0 after --help.
        ConfigError: invalid settings.
    """
    logs = Annotated[Union[*_one_of(LOGS)], tyro.conf.subcommand("logs", description="Import raw logs, or check logs.")]
    first, *others = _one_of(COMMANDS)
    return tyro.cli(Union[first, logs, *others], prog="motorprior", args=args, description=__doc__)  # pyright: ignore


def main() -> None:
    """Run a command line; exit code 2 and one line for bad input, 130 if interrupted."""
    try:
        config = parse(sys.argv[1:])
        RUN[type(config)](config)
    except MotorPriorError as error:
        _fail(error.on_command_line())
    except OSError as error:  # a folder that disappears, a full disk
        where = f"{error.filename}: " if error.filename is not None else ""
        _fail(f"{where}{error.strerror or error} -> check the path, its permissions and the free space")
    except MemoryError as error:
        _fail(f"not enough memory ({error}) -> use smaller numbers, or a larger machine")
    except KeyboardInterrupt:
        CONSOLE.print("interrupted: finished stages are kept, run the same command again to continue")
        raise SystemExit(130) from None


def _fail(message: str) -> NoReturn:
    CONSOLE.print(f"error: {message}", style="bold red", markup=False, soft_wrap=True)
    raise SystemExit(2) from None


if __name__ == "__main__":
    main()
