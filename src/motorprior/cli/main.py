"""The command ``motorprior``: sub-commands in the order of the data flow."""

from __future__ import annotations

import os
import sys
from dataclasses import MISSING, fields, make_dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NoReturn, Union

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before numpy: two BLAS threads make small products ten times slower

import tyro  # noqa: E402

from motorprior.cli import robot, show  # noqa: E402
from motorprior.cli.console import CONSOLE, TERMINAL  # noqa: E402
from motorprior.commands.adapt import Adapt  # noqa: E402
from motorprior.commands.bench import Bench, run_bench  # noqa: E402
from motorprior.commands.calibrate import Calibrate  # noqa: E402
from motorprior.commands.demo import Demo  # noqa: E402
from motorprior.commands.excite import Excite, run_excite  # noqa: E402
from motorprior.commands.identify import Identify, run_identify  # noqa: E402
from motorprior.commands.logs_import import LogsImport, import_logs  # noqa: E402
from motorprior.commands.play import Play  # noqa: E402
from motorprior.commands.replay import Replay  # noqa: E402
from motorprior.commands.simulate import Simulate, run_simulate  # noqa: E402
from motorprior.commands.validate import Validate  # noqa: E402
from motorprior.commands.validate_log import ValidateLog  # noqa: E402
from motorprior.exceptions import ConfigError, MotorPriorError  # noqa: E402


def _positional(settings: type, **types: Any) -> type:
    """The settings with these fields, of these types, as positional arguments."""
    changed = [(name, tyro.conf.Positional[kind]) for name, kind in types.items()]
    documented = {"__doc__": settings.__doc__}
    return make_dataclass(settings.__name__, changed, bases=(settings,), frozen=True, namespace=documented)


PATHS = tuple[Path, ...]
LOGS: dict[str, tuple[type, Any]] = {
    "import": (_positional(LogsImport, paths=PATHS), partial(import_logs, progress=TERMINAL)),
    "check": (_positional(show.LogsCheck, paths=PATHS), show.logs_check),
}
COMMANDS: dict[str, tuple[type, Any]] = {
    "demo": (Demo, show.demo),
    "calibrate": (_positional(Calibrate, logs=Path), show.calibrate),
    "bench": (Bench, partial(run_bench, progress=TERMINAL)),
    "identify": (_positional(Identify, bench=PATHS), partial(run_identify, progress=TERMINAL)),
    "validate": (_positional(Validate, priors=PATHS), show.validate),
    "validate-log": (_positional(ValidateLog, prior=Path, log=Path), show.validate_log),
    "adapt": (_positional(Adapt, prior=Path, log=Path), show.adapt),
    "simulate": (Simulate, partial(run_simulate, progress=TERMINAL)),
    "excite": (_positional(Excite, runs=PATHS), partial(run_excite, progress=TERMINAL)),
    "replay": (_positional(Replay, logs=Path), show.replay),
    "walk": (show.WalkCommand, show.walk),
    "play": (_positional(Play, policies=PATHS), show.play),
    "transfer": (show.TransferCommand, show.transfer),
    "doctor": (robot.Doctor, robot.doctor),
    "deploy": (robot.Deploy, robot.deploy),
    "record": (robot.Record, robot.record),
    "report": (_positional(show.Report, run=Path), show.report),
}
RUN = dict([*LOGS.values(), *COMMANDS.values()])


def _one_of(commands: dict[str, tuple[type, Any]]) -> list[Any]:
    return [Annotated[settings, tyro.conf.subcommand(name)] for name, (settings, _) in commands.items()]


def parse(args: list[str]) -> Any:
    """Parse a command line into settings.

    Raises:
        SystemExit: code 2 for a wrong command line, 0 after --help.
        ConfigError: invalid settings.
    """
    logs = Annotated[Union[*_one_of(LOGS)], tyro.conf.subcommand("logs", description="Import raw logs, or check logs.")]
    first, *others = _one_of(COMMANDS)
    config: Any = tyro.cli(Union[first, logs, *others], prog="motorprior", args=args, description=__doc__)  # pyright: ignore
    for field in fields(config):
        if field.default is MISSING and getattr(config, field.name) == ():
            raise ConfigError(f"no {field.name} given", remedy="give at least one file or folder")
    return config


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
