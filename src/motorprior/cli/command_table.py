"""The commands of `motorprior`: where their settings and functions are, and what their help shows.

A command is imported when it is chosen. So the list of commands appears at once, and the robot's
own computer needs only the libraries of its commands.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any


@dataclass(frozen=True)
class Command:
    """A command of the command line.

    Attributes:
        help: line in the list of commands, and first line of the command's own help. Details are in
            the settings' docstring.
        settings: dataclass of the options, as "module:name".
        run: function of the settings and a `Progress`, as "module:name".
        positional: settings that are given without the name of an option, in this order.
        common: settings in --help; --help-all shows all of them. Empty: --help shows all.
        on_robot: whether the robot's own computer has the libraries of this command.
    """

    help: str
    settings: str
    run: str
    positional: tuple[str, ...] = ()
    common: tuple[str, ...] = ()
    on_robot: bool = False

    def load_settings(self) -> type:
        """Import and return the dataclass of the options."""
        return _load(self.settings)

    def load_run(self) -> Callable[[Any, Any], None]:
        """Import and return the function that runs the command."""
        return _load(self.run)


def _load(place: str) -> Any:
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)


LOGS = "logs "  # the commands of this group have names of two words
COMMANDS = {
    "demo": Command(
        "Learn motors, train policies on models of them, test these on virtual robots.",
        settings="motorprior.commands.demo:Demo",
        run="motorprior.cli.demo:run",
        common=("out", "logs", "columns", "suspended", "robot", "workers", "seed"),
    ),
    "logs import": Command(
        "Convert recordings of a robot and raw logs to motor logs.",
        settings="motorprior.commands.logs_import:LogsImport",
        run="motorprior.commands.logs_import:import_logs",
        positional=("paths",),
        common=("paths", "out", "columns", "robot", "suspended", "kp"),
    ),
    "logs check": Command(
        "Check logs: clock, units, limits, jumps, excitation, tracking, saturation, gravity.",
        settings="motorprior.commands.logs_check:LogsCheck",
        run="motorprior.cli.logs_check:run",
        positional=("paths",),
    ),
    "identify": Command(
        "Learn a motor prior from motor logs.",
        settings="motorprior.commands.identify:Identify",
        run="motorprior.cli.identify:run",
        positional=("logs",),
    ),
    "adapt": Command(
        "Adapt a prior to a log: the posterior of its motors.",
        settings="motorprior.commands.adapt:Adapt",
        run="motorprior.cli.adapt:run",
        positional=("prior", "log"),
    ),
    "validate": Command(
        "Compare a prior and baselines with the motors of a held-out log.",
        settings="motorprior.commands.validate:Validate",
        run="motorprior.cli.validate:run",
        positional=("prior", "log"),
    ),
    "show": Command(
        "Print what a file holds, such as a prior's constants.",
        settings="motorprior.commands.show:Show",
        run="motorprior.cli.show:run",
        positional=("file",),
    ),
    "export": Command(
        "Write sampled motors for another simulator.",
        settings="motorprior.commands.export:Export",
        run="motorprior.commands.export:run_export",
        positional=("motors_of",),
    ),
    "calibrate": Command(
        "Fit a fleet of physical motors to real logs of a robot.",
        settings="motorprior.commands.calibrate:Calibrate",
        run="motorprior.cli.calibrate:run",
        positional=("logs",),
        common=("logs", "out", "robot", "fleet", "posture"),
    ),
    "replay": Command(
        "Replay the commands of real logs on simulated motors.",
        settings="motorprior.commands.replay:Replay",
        run="motorprior.cli.replay:run",
        positional=("logs",),
    ),
    "bench": Command(
        "Record motor logs on a virtual dynamometer.",
        settings="motorprior.commands.bench:Bench",
        run="motorprior.commands.bench:run_bench",
        common=("out", "robot", "fleet", "motors", "seed"),
    ),
    "simulate": Command(
        "Excite a simulated robot and record a motor log.",
        settings="motorprior.commands.simulate:Simulate",
        run="motorprior.commands.simulate:run_simulate",
    ),
    "excite": Command(
        "Learn an excitation that looks like runs of a robot.",
        settings="motorprior.commands.excite:Excite",
        run="motorprior.commands.excite:run_excite",
        positional=("runs",),
        common=("runs", "out", "method", "robot", "columns", "suspended"),
    ),
    "walk": Command(
        "Train a walking policy.",
        settings="motorprior.commands.walk:Walk",
        run="motorprior.cli.walk:run",
        common=("out", "motors", "robot", "iterations", "seeds", "validation", "workers"),
    ),
    "play": Command(
        "Render walks of policies as a film and measure them.",
        settings="motorprior.commands.play:Play",
        run="motorprior.cli.play:run",
        positional=("policies",),
    ),
    "transfer": Command(
        "Evaluate policies on held-out robots, or run the study.",
        settings="motorprior.commands.transfer:TransferCommand",
        run="motorprior.cli.transfer:run",
        positional=("policies",),
        common=("policies", "out", "study", "fleet", "robot", "workers"),
    ),
    "report": Command(
        "Write a page of trained policies.",
        settings="motorprior.commands.report:Report",
        run="motorprior.cli.report:run",
        positional=("run",),
    ),
    "deploy": Command(
        "Run a policy on a robot.",
        settings="motorprior.commands.deploy:Deploy",
        run="motorprior.commands.deploy:run_deploy",
        positional=("policy",),
        common=("policy", "port", "virtual"),
        on_robot=True,
    ),
    "record": Command(
        "Excite and record the motors of a robot.",
        settings="motorprior.commands.record:Record",
        run="motorprior.commands.record:run_record",
        common=("port", "virtual", "robot", "motor", "bar", "seconds", "plan", "standing"),
        on_robot=True,
    ),
    "doctor": Command(
        "Check a robot's telemetry, or the servos on its bus; writes nothing without --idle.",
        settings="motorprior.commands.doctor:Doctor",
        run="motorprior.commands.doctor:run_doctor",
        common=("port", "virtual", "robot", "motor", "seconds", "idle"),
        on_robot=True,
    ),
}


def available_commands() -> dict[str, Command]:
    """All commands; on the robot's own computer, which has few libraries, only its commands."""
    if find_spec("mujoco") is not None:
        return COMMANDS
    return {name: command for name, command in COMMANDS.items() if command.on_robot}
