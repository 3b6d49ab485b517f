"""The command ``motorprior``: sub-commands in the order of the data flow."""

from __future__ import annotations

import os
import sys
import time
from functools import partial
from typing import Annotated

_STARTED = time.monotonic()

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before numpy: two BLAS threads make small products ten times slower

import tyro  # noqa: E402

from motorprior.cli.adapt import AdaptCommand, adapt  # noqa: E402
from motorprior.cli.calibrate import CalibrateCommand, run_calibrate_command  # noqa: E402
from motorprior.cli.console import CONSOLE, TERMINAL  # noqa: E402
from motorprior.cli.demo import demo  # noqa: E402
from motorprior.cli.deploy import Deploy, run_deploy_command  # noqa: E402
from motorprior.cli.doctor import Doctor, run_doctor_command  # noqa: E402
from motorprior.cli.identify import IdentifyCommand  # noqa: E402
from motorprior.cli.logs import LogsCheck, LogsImportCommand, run_logs_check  # noqa: E402
from motorprior.cli.play import PlayCommand, play  # noqa: E402
from motorprior.cli.record import Record, run_record_command  # noqa: E402
from motorprior.cli.replay import ReplayCommand, replay  # noqa: E402
from motorprior.cli.report import MakeReport, run_report  # noqa: E402
from motorprior.cli.simulate import SimulateCommand  # noqa: E402
from motorprior.cli.transfer import TransferCommand, transfer  # noqa: E402
from motorprior.cli.validate import ValidateCommand, validate  # noqa: E402
from motorprior.cli.validate_log import ValidateLogCommand, validate_log  # noqa: E402
from motorprior.cli.walk import WalkCommand, walk  # noqa: E402
from motorprior.exceptions import MotorPriorError  # noqa: E402
from motorprior.pipeline.bench import Bench, run_bench  # noqa: E402
from motorprior.pipeline.demo import Demo  # noqa: E402
from motorprior.pipeline.identify import run_identify  # noqa: E402
from motorprior.pipeline.log_import.raw_logs import import_logs  # noqa: E402
from motorprior.pipeline.simulate import run_simulate  # noqa: E402

Logs = (
    Annotated[LogsImportCommand, tyro.conf.subcommand("import")] | Annotated[LogsCheck, tyro.conf.subcommand("check")]
)
Command = (
    Annotated[Demo, tyro.conf.subcommand("demo")]
    | Annotated[Logs, tyro.conf.subcommand("logs", description="Bring raw logs in; a log doctor.")]
    | Annotated[CalibrateCommand, tyro.conf.subcommand("calibrate")]
    | Annotated[Bench, tyro.conf.subcommand("bench")]
    | Annotated[IdentifyCommand, tyro.conf.subcommand("identify")]
    | Annotated[ValidateCommand, tyro.conf.subcommand("validate")]
    | Annotated[ValidateLogCommand, tyro.conf.subcommand("validate-log")]
    | Annotated[AdaptCommand, tyro.conf.subcommand("adapt")]
    | Annotated[SimulateCommand, tyro.conf.subcommand("simulate")]
    | Annotated[ReplayCommand, tyro.conf.subcommand("replay")]
    | Annotated[WalkCommand, tyro.conf.subcommand("walk")]
    | Annotated[PlayCommand, tyro.conf.subcommand("play")]
    | Annotated[TransferCommand, tyro.conf.subcommand("transfer")]
    | Annotated[Doctor, tyro.conf.subcommand("doctor")]
    | Annotated[Deploy, tyro.conf.subcommand("deploy")]
    | Annotated[Record, tyro.conf.subcommand("record")]
    | Annotated[MakeReport, tyro.conf.subcommand("report")]
)
RUN = {
    Demo: partial(demo, started=_STARTED),
    LogsImportCommand: partial(import_logs, progress=TERMINAL),
    LogsCheck: run_logs_check,
    CalibrateCommand: run_calibrate_command,
    Bench: partial(run_bench, progress=TERMINAL),
    IdentifyCommand: partial(run_identify, progress=TERMINAL),
    ValidateCommand: validate,
    ValidateLogCommand: validate_log,
    AdaptCommand: adapt,
    SimulateCommand: partial(run_simulate, progress=TERMINAL),
    ReplayCommand: replay,
    WalkCommand: walk,
    PlayCommand: play,
    TransferCommand: transfer,
    Doctor: run_doctor_command,
    Deploy: run_deploy_command,
    Record: run_record_command,
    MakeReport: run_report,
}


def parse(args: list[str]) -> object:
    """Parse a command line into settings.

    Raises:
        SystemExit: code 2 for a wrong command line, 0 after --help.
        ConfigError: settings that do not fit together.
    """
    return tyro.cli(Command, prog="motorprior", args=args, description=__doc__)  # pyright: ignore


def _outside(error: OSError | MemoryError) -> str:
    """One-line message for an error of the operating system."""
    if isinstance(error, MemoryError):
        detail = " ".join(str(error).split())
        return f"not enough memory{f' ({detail})' if detail else ''} -> use smaller numbers, or a larger machine"
    where = f"{error.filename}: " if error.filename is not None else ""
    return f"{where}{error.strerror or error} -> check the path, its permissions and the free space"


def main() -> None:
    """Run a command line; exit code 2 and one line on bad input, 130 when interrupted."""
    try:
        config = parse(sys.argv[1:])
        RUN[type(config)](config)
    except MotorPriorError as error:
        CONSOLE.print(f"error: {error.on_command_line()}", style="bold red", markup=False, soft_wrap=True)
        raise SystemExit(2) from None
    except (OSError, MemoryError) as error:  # not foreseeable by checks: a folder that disappears, a full memory
        CONSOLE.print(f"error: {_outside(error)}", style="bold red", markup=False, soft_wrap=True)
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        CONSOLE.print("interrupted: finished stages are kept, run the same command again to continue")
        os._exit(130)  # threads of unfinished stages end too; every file is written atomically


if __name__ == "__main__":
    main()
