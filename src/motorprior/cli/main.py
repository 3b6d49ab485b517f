"""Identify motors from logs, train walking policies on them, evaluate and deploy."""

import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import MISSING, field, fields, make_dataclass
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NoReturn, Union, get_type_hints

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    # before numpy: two BLAS threads make small products ten times slower
    os.environ.setdefault(_name, "1")

import tyro  # noqa: E402
from rich.console import Console  # noqa: E402

from motorprior import __version__  # noqa: E402
from motorprior.cli import robot, show  # noqa: E402
from motorprior.cli.show import TERMINAL  # noqa: E402
from motorprior.commands.adapt import Adapt, run_adapt  # noqa: E402
from motorprior.commands.bench import Bench, run_bench  # noqa: E402
from motorprior.commands.calibrate import Calibrate  # noqa: E402
from motorprior.commands.demo import Demo  # noqa: E402
from motorprior.commands.excite import Excite, run_excite  # noqa: E402
from motorprior.commands.export import Export, run_export  # noqa: E402
from motorprior.commands.identify import Identify, run_identify  # noqa: E402
from motorprior.commands.logs_import import LogsImport, import_logs  # noqa: E402
from motorprior.commands.play import Play  # noqa: E402
from motorprior.commands.replay import Replay  # noqa: E402
from motorprior.commands.simulate import Simulate, run_simulate  # noqa: E402
from motorprior.commands.validate import Validate  # noqa: E402
from motorprior.commands.walk import Walk  # noqa: E402
from motorprior.exceptions import ConfigError, MotorPriorError  # noqa: E402


def _positional(settings: type, **types: Any) -> type:
    """The settings with these fields, of these types, as positional arguments."""
    changed = [(name, tyro.conf.Positional[kind]) for name, kind in types.items()]
    documented = {"__doc__": settings.__doc__}
    return make_dataclass(
        settings.__name__, changed, bases=(settings,), frozen=True, namespace=documented
    )


def _printing(run: Callable[[Any, Any], object]) -> Callable[[Any], None]:
    return lambda config: print(run(config, TERMINAL))


PATHS = tuple[Path, ...]
LOGS: dict[str, tuple[type, Any]] = {
    "import": (_positional(LogsImport, paths=PATHS), partial(import_logs, progress=TERMINAL)),
    "check": (_positional(show.LogsCheck, paths=PATHS), show.logs_check),
}
COMMANDS: dict[str, tuple[type, Any]] = {
    "demo": (Demo, show.demo),
    "calibrate": (_positional(Calibrate, logs=Path), show.calibrate),
    "bench": (Bench, partial(run_bench, progress=TERMINAL)),
    "identify": (_positional(Identify, logs=PATHS), _printing(run_identify)),
    "show": (_positional(show.Show, file=Path), lambda config: print(show.described(config))),
    "validate": (_positional(Validate, prior=Path, log=Path), show.validate),
    "adapt": (_positional(Adapt, prior=Path, log=Path), _printing(run_adapt)),
    "export": (_positional(Export, motors_of=Path), partial(run_export, progress=TERMINAL)),
    "simulate": (Simulate, partial(run_simulate, progress=TERMINAL)),
    "excite": (_positional(Excite, runs=PATHS), partial(run_excite, progress=TERMINAL)),
    "replay": (_positional(Replay, logs=Path), show.replay),
    "walk": (Walk, show.walk),
    "play": (_positional(Play, policies=PATHS), show.play),
    "transfer": (show.TransferCommand, show.transfer),
    "doctor": (robot.Doctor, robot.run),
    "deploy": (robot.Deploy, robot.run),
    "record": (robot.Record, robot.run),
    "report": (_positional(show.Report, run=Path), show.report),
}
RUN = dict([*LOGS.values(), *COMMANDS.values()])
HELP_ALL = "--help-all"
# Options in the help of commands with more than fit a screen; HELP_ALL shows the others
COMMON = {
    "demo": ("out", "logs", "columns", "suspended", "robot", "workers", "seed"),
    "calibrate": ("logs", "out", "robot", "fleet", "posture"),
    "import": ("paths", "out", "columns", "robot", "suspended", "kp"),
    "excite": ("runs", "out", "method", "robot", "columns", "suspended", "plan_prior"),
    "bench": ("out", "robot", "fleet", "motors", "seed"),
    "walk": ("out", "motors", "robot", "iterations", "seeds", "validation", "workers"),
    "transfer": ("policies", "out", "study", "fleet", "robot", "workers"),
    "deploy": ("policy", "port", "virtual"),
    "record": ("port", "virtual", "standing"),
    "doctor": ("port", "virtual", "seconds", "idle"),
}


def _one_of(
    commands: dict[str, tuple[type, Any]], common: Mapping[str, tuple[str, ...]]
) -> list[Any]:
    return [
        Annotated[
            _shown(settings, common[name]) if name in common else settings,
            tyro.conf.subcommand(name),
        ]
        for name, (settings, _) in commands.items()
    ]


def _shown(settings: type, names: tuple[str, ...]) -> type:
    """The settings with only these options in the help; those without a default are always there."""
    hints = get_type_hints(settings, include_extras=True)
    hidden = []
    for each in fields(settings):
        defaults = {"default": each.default, "default_factory": each.default_factory}
        given = {name: value for name, value in defaults.items() if value is not MISSING}
        if each.name not in names and given:
            hidden.append(
                (
                    each.name,
                    tyro.conf.Suppress[hints[each.name]],
                    field(kw_only=each.kw_only, **given),
                )
            )
    documented = {"__doc__": f"{settings.__doc__}\n\nAll options: {HELP_ALL}"}
    return make_dataclass(
        settings.__name__, hidden, bases=(settings,), frozen=True, namespace=documented
    )


def _require_known(given: list[str], names: list[str]) -> None:
    """Raise ConfigError, with the nearest names, for a word that is neither a name nor an option."""
    for word in given:
        if word not in names and not word.startswith("-"):
            near = " or ".join(get_close_matches(word, names, 2)) or f"one of {', '.join(names)}"
            raise ConfigError(
                f"no command {word!r}", remedy=f"did you mean {near}? --help lists them"
            )


def parse(args: list[str]) -> Any:
    """Parse a command line into settings; SystemExit with code 2 for a wrong one, 0 after --help and --version."""
    if args == ["--version"]:
        print(f"motorprior {__version__}")
        raise SystemExit(0)
    _require_known(args[:1], [*COMMANDS, "logs"])
    _require_known(args[1:2] if args[:1] == ["logs"] else [], [*LOGS])
    asks = {"-h", "--help"} & set(args) and HELP_ALL not in args
    common = {name: shown for name, shown in COMMON.items() if asks and name in args}
    args = ["--help" if word == HELP_ALL else word for word in args]
    every = Union[*_one_of(LOGS, common)]
    logs = Annotated[
        every, tyro.conf.subcommand("logs", description="Import raw logs, or check logs.")
    ]
    first, *others = _one_of(COMMANDS, common)
    config: Any = tyro.cli(
        Union[first, logs, *others], prog="motorprior", args=args, description=__doc__
    )  # pyright: ignore
    for each in fields(config):
        if each.default is MISSING and getattr(config, each.name) == ():
            raise ConfigError(f"no {each.name} given", remedy="give at least one")
    return config


def main() -> None:
    """Run a command line; exit code 2 and one line for bad input, 130 if interrupted."""
    try:
        config = parse(sys.argv[1:])
        RUN[type(config)](config)
    except MotorPriorError as error:
        _fail(error.on_command_line())
    except BrokenPipeError:  # the reader of the output, such as `head`, has ended
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(141) from None
    except OSError as error:  # a folder that disappears, a full disk
        where = f"{error.filename}: " if error.filename is not None else ""
        _fail(
            f"{where}{error.strerror or error} -> check the path, its permissions and the free space"
        )
    except MemoryError as error:
        _fail(f"not enough memory ({error}) -> use smaller numbers, or a larger machine")
    except (KeyboardInterrupt, SystemError) as error:
        if isinstance(error, SystemError) and not isinstance(error.__cause__, KeyboardInterrupt):
            raise  # compiled code makes one of an interruption
        TERMINAL.note("interrupted: what was finished is kept, run the same command again")
        raise SystemExit(130) from None


def _fail(message: str) -> NoReturn:
    Console(stderr=True, highlight=False).print(
        f"error: {message}", style="bold red", markup=False, soft_wrap=True
    )
    raise SystemExit(2) from None
