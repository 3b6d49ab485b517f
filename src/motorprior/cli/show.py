"""Commands with their tables on the terminal."""

import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import tyro
from rich.console import Console
from rich.table import Table
from rich.text import Text

from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior, card_file
from motorprior.artifacts import read_tensors, read_toml
from motorprior.bench.fleet import load_fleet
from motorprior.bench.learned_excitation import LearnedExcitation
from motorprior.commands.calibrate import FLEET, PICTURE, Calibrate, run_calibrate
from motorprior.commands.demo import Demo, run_demo
from motorprior.commands.play import Play, run_play
from motorprior.commands.replay import Replay, run_replay
from motorprior.commands.transfer import Transfer, run_study, run_transfer
from motorprior.commands.validate import Validate, run_validate
from motorprior.commands.walk import PICTURE as CURVES
from motorprior.commands.walk import SEED_FOLDER, Walk, run_walk, run_walk_seeds
from motorprior.evaluation import errors as log_errors
from motorprior.evaluation import free_runs
from motorprior.evaluation.bands import LEVELS
from motorprior.evaluation.errors import PRIOR
from motorprior.exceptions import ArtifactError, ConfigError, LogError
from motorprior.locomotion.policy import Policy
from motorprior.logs.doctor.checks import check_log
from motorprior.logs.doctor.findings import grouped
from motorprior.logs.read_log import read_log
from motorprior.priors.validate import ADAPTED, COVERAGE, SPANS, TRAINED_ON
from motorprior.progress import Lines
from motorprior.report import tables
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT, SHIPPED
from motorprior.stage import FIGURES, PAGE
from motorprior.studies.compare import NUM_WALKS
from motorprior.studies.study_settings import Study

TERMINAL = Lines()


def command_line() -> str:
    """The command line of this process, without options on which no result depends."""
    words = ["motorprior", *sys.argv[1:]]
    for option in ("--out", "--workers"):
        if option in words:
            del words[(at := words.index(option)) : at + 2]
    return shlex.join(word for word in words if not word.startswith(("--out=", "--workers=")))


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table; the first column is text, the others are numbers."""
    printed = Table(title=Text(title), title_justify="left")
    for index, column in enumerate(columns):
        printed.add_column(Text(column), justify="left" if index == 0 else "right")
    for row in rows:
        printed.add_row(*(Text(cell) for cell in row))
    Console(file=sys.stdout, highlight=False, width=None if sys.stdout.isatty() else 120).print(
        printed
    )


@dataclass(frozen=True)
class LogsCheck:
    """Check logs (log doctor): clock, units, limits, jumps, excitation, tracking, saturation, gravity."""

    paths: tuple[Path, ...]
    """Motor logs (.parquet), recordings of a robot (.csv) or raw logs in any format that `logs import` reads."""
    columns: str | None = None
    """Column map of a table: a shipped map by name, or your .toml file (docs/your-motors.md)."""
    robot: str | None = None
    """Robot: a shipped one by name, or your .toml file. Default for logs without joint names: the shipped robot."""


def logs_check(config: LogsCheck) -> None:
    """Print every finding; raises LogError after all logs are checked, if one has errors."""
    robot = load_robot(config.robot or DEFAULT_ROBOT)
    unusable = []
    given = robot if config.robot or config.columns is None else None
    for path in config.paths:
        log = read_log(path, given, config.columns)
        report = check_log(
            log, robot if config.robot or log.joint_names == robot.joint_names else None
        )
        found = grouped(report.findings)
        rows = [
            [each.severity, each.check, str(each.row), each.message, each.remedy] for each in found
        ]
        title = f"{path}: {log.num_rows} rows, {log.num_joints} joints, {log.duration:.1f} s"
        table(title, ["severity", "check", "row", "finding", "remedy"], rows)
        if not report.usable:
            unusable.append(str(path))
    if unusable:
        raise LogError(
            f"{len(unusable)} of {len(config.paths)} logs are not usable", where=", ".join(unusable)
        )


@dataclass(frozen=True)
class Show:
    """Print what a file holds, such as a prior's constants."""

    file: Path
    """A .safetensors of identify, adapt, walk or excite, a log in any format, a .toml file of a fleet or robot, or a
    shipped fleet or motor card by name."""
    prior: Path | None = None
    """The prior of a posterior, for its constants."""
    columns: str | None = None
    """Column map of a table: a shipped one by name, or your .toml file."""


def demo(config: Demo) -> None:
    """See `run_demo`."""
    results = run_demo(config, TERMINAL, command_line())
    if config.logs is not None:
        spans = {log_errors.FREE_RUN_RMSE: "1 s", log_errors.WHOLE_RUN_RMSE: "whole log"}
        titles = {
            quantity: title for quantity, title in spans.items() if results.where(quantity=quantity)
        }
        table(
            "Your motors: free runs, joint RMSE [mrad], over joints",
            *free_runs.error_table(results, titles),
        )
    print(f"Report: {config.out / PAGE}   Figures: {config.out / FIGURES}")


def described(config: Show) -> str:
    """What the file holds."""
    path = config.file
    if path.suffix == ".toml" and "model" in read_toml(
        path, "give the .toml file of a robot or a fleet"
    ):
        return str(load_robot(path))
    if path.suffix == ".toml" or str(path) in {
        name for robot in SHIPPED for name, _ in robot.fleets
    }:
        return str(load_fleet(path))
    if card_file(str(path)):
        return str(MotorPrior.load(path))
    if path.suffix != ".safetensors":
        return str(read_log(path, None, config.columns))
    kind = str(read_tensors(path)[1].get("kind"))
    if kind == "motor prior":
        return str(MotorPrior.load(path))
    if kind == "excitation":
        return str(LearnedExcitation.load(path))
    if kind != "motor posterior":
        return str(Policy.load(path))
    if config.prior is None:
        remedy = f"give it: motorprior show {path} --prior prior.safetensors"
        raise ArtifactError(
            "a posterior needs its prior", where=path, remedy=remedy, argument="prior"
        )
    return str(MotorPosterior.load(path, MotorPrior.load(config.prior)))


def validate(config: Validate) -> None:
    """See `run_validate`."""
    results = run_validate(config, TERMINAL)
    trained = results.value(quantity=TRAINED_ON) > 0.0
    warning = " (warning: not a test, the prior was trained on this log)" if trained else ""
    table(
        f"Free runs, joint RMSE [mrad], over joints{warning}",
        *free_runs.error_table(results, SPANS),
    )

    shares = []
    for model in (ADAPTED, PRIOR):
        for quantity, span in SPANS.items():
            row = [model, span]
            for level in LEVELS:
                share = results.value(quantity=f"{COVERAGE[quantity]}{level}", model=model)
                row.append(f"{100 * share:.0f}")
            shares.append(row)
    bands = [f"{level} % band" for level in LEVELS]
    table(
        f"Recorded angles inside the bands [%]{warning}",
        ["model", "free runs", *bands],
        shares,
    )


def replay(config: Replay) -> None:
    """See `run_replay`."""
    table(
        "Real logs: joint RMSE [mrad], start included",
        *tables.replay_table(run_replay(config, TERMINAL)),
    )


def calibrate(config: Calibrate) -> None:
    """See `run_calibrate`."""
    results = run_calibrate(config, TERMINAL)
    table("Real logs: joint RMSE [mrad], start included", *tables.calibration_errors(results))
    table("Constants of the central motor", *tables.calibrated_constants(results))
    TERMINAL.note(f"{config.out / FLEET}, {config.out / PICTURE}")


def walk(config: Walk) -> None:
    """See `run_walk`, and `run_walk_seeds` for several seeds."""
    evaluated = (
        "its training simulation"
        if config.validation is None
        else f"validation motors ({config.validation})"
    )
    if config.seeds == 1:
        folder = config.out
        best = run_walk(config, TERMINAL).provenance
        print(
            f"best policy: iteration {best['iteration']}, mean return {best['best_return']:.2f} m on {evaluated}"
        )
        if best["best_return"] < 0.0:
            remedy = (
                "play it; if it falls at once, check the motors and the model, or else train longer"
            )
            TERMINAL.warn(f"a negative return: the robot falls or barely walks -> {remedy}")
    else:
        results = run_walk_seeds(config, TERMINAL)
        rows = [(str(row.seed), f"{row.value:.2f}") for row in results]
        table(f"Best policies on {evaluated}", ("seed", "mean return [m]"), rows)
        print(config.out / CURVES)
        folder = config.out / SEED_FOLDER.format(max(results, key=lambda row: row.value).seed)
    print(
        f"play it: motorprior play {folder}{'' if config.robot == DEFAULT_ROBOT else f' --robot {config.robot}'}"
    )


def play(config: Play) -> None:
    """See `run_play`."""
    film, results = run_play(config, TERMINAL)
    table("From the first second on (docs/play.md)", *tables.measure_table(results))
    print(film)


@dataclass(frozen=True)
class TransferCommand(Transfer, Study):
    """Evaluate policies on held-out robots, or run the study."""

    policies: tyro.conf.Positional[tuple[Path, ...]] = ()
    study: bool = False
    """Train policies on each model of a bench's motors, and evaluate them in their training simulation and in four
    environments: three to four hours on two cores; a rerun resumes. Study options require it."""


def transfer(config: TransferCommand) -> None:
    """See `run_transfer` and `run_study`."""
    settings, study = (
        {each.name: getattr(config, each.name) for each in fields(kind)}
        for kind in (Transfer, Study)
    )
    if config.study:
        if config.policies or config.engine is not None:
            raise ConfigError(
                "a study trains its own policies", remedy="give neither policies nor an engine"
            )
        from motorprior.report.study import study_sections  # here: it imports matplotlib

        found = run_study(Study(**study), TERMINAL, command_line())
        for each in (one for section in study_sections(found) for one in section.tables):
            table(each.caption, each.columns, each.rows)
        print(config.out / PAGE)
        return
    for field in fields(Study):
        if field.name not in settings and study[field.name] != field.default:
            raise ConfigError(
                f"{field.name} needs --study", remedy="add --study", argument=field.name
            )
    if not config.policies:
        raise ConfigError("no policy given", remedy="give the folders of at least one walk")
    rows = tables.transfer_table(run_transfer(Transfer(**settings), TERMINAL))
    table(f"Transfer, {NUM_WALKS} motor samples x 5 s, means over seeds", *rows)


@dataclass(frozen=True)
class Report:
    """Write a page of trained policies."""

    run: Path
    """Folder that `motorprior walk` wrote, or a folder of such folders."""
    robot: str = DEFAULT_ROBOT
    """Robot of the policies: a shipped one by name, or a .toml file."""


def report(config: Report) -> None:
    """Write the page and print its path."""
    from motorprior.report.sections import write_training_page  # here: it imports matplotlib

    print(write_training_page(config.run, config.robot, command_line()))
