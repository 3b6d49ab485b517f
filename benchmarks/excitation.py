"""Likeness of a learned excitation to the robot, and errors of models that it gives.

Results: docs/excitation.md.

    python benchmarks/excitation.py --out runs/excitation

Every cell (one excitation, loss, seed and length of log) is a file named by its settings; the same
command continues an interrupted run.
"""

import hashlib
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from excitation_likeness import FEATURES, KINDS, RUNS, TRAIN, likeness, windows_of_kind
from figures import PROGRESS, markdown, run_benchmark
from motorprior.actuator.fleet import Fleet, load_fleet
from motorprior.actuator.latent import LatentNetwork
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import read_json, write_json, write_text
from motorprior.bench.recording import (
    BENCH_SCHEDULES,
    BenchSchedule,
    bench_schedule,
    record,
    training_motors,
)
from motorprior.exceptions import MotorPriorError
from motorprior.excitation.fit_excitation import STEPS, fit_excitation
from motorprior.excitation.learned_excitation import LearnedExcitation
from motorprior.identification.presets import identification_preset, network_steps
from motorprior.jax_device import use_cpu_by_default
from motorprior.logs.load_log import load_log
from motorprior.logs.loads import with_torque_balance
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import joined
from motorprior.priors.adapt import adapt_to
from motorprior.priors.fit_prior import PRIOR_FILE, fit_recipe
from motorprior.report.page import Picture, Section, Table, page, picture
from motorprior.report.plots_style import legend_below, new_figure, panels, png_bytes, set_labels
from motorprior.report.transfer_page import with_interval
from motorprior.results import Results
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.simulation.playback import replay
from motorprior.simulation.world import World
from motorprior.studies.statistics import Estimate, estimate, summarise
from motorprior.studies.study_settings import Study
from motorprior.studies.transfer import study_walks
from virtual_fleets.robot_fidelity import robot_fidelity, trot_targets
from why_oscillation import MIN_LOAD, Learned, growth, recorded_inputs, sensitivities

PLACES = {"standing": False, "suspended": True}
COLORS: dict[str, str] = {
    "runs": "k",
    **dict(zip(KINDS, ("C7", "C0", "C2", "C1", "C3"), strict=True)),
}
HAND_MADE = ("sinusoid", "rollout")  # kinds that are not learned
HELD_OUT_STREAM = 67
TROT = 2.5  # [s]
# environment of the transfer -> name of its figure
TESTED = {"fleet": "upright", "hard_out_of_family": "upright_hard"}
LOSSES = ("paper", "paper_wide", "rollout")  # recipes; the last two have the same clock and data


@dataclass(frozen=True)
class Settings:
    """Sizes of the benchmark."""

    out: Path  # folder for cells, figures.json, table.md and likeness_CLASS.png
    robot: str = "pupper_v2"
    fleet: str = "pupper_v2"  # population of motors
    runs: int = 10  # walks to learn from; 0: only the real logs
    held_out_runs: int = 20  # other walks, for the likeness: windows of one trot are much alike
    run_seconds: float = 20.0  # of a walk [s]
    training_steps: int = STEPS  # of the generator
    motors: int = 32  # on the bench, and as many held-out ones
    seconds: float = 20.0  # of log per motor [s]
    seeds: int = 5
    losses: tuple[str, ...] = LOSSES
    kinds: tuple[str, ...] = KINDS
    # of identification, for the loss rollout; latent_network has the paper's network
    rollout_recipe: str = "rollout"
    adam_steps: int | None = None  # of networks; if not given, each recipe's number
    # of log of the held-out motors [s]; 0 measures on the training motors
    adapt_seconds: float = 10.0
    # of the curves [s]; none: leave them out
    budgets: tuple[float, ...] = (2.0, 5.0, 10.0, 20.0, 60.0)
    policies: int = 0  # per kind and bench, for transfer; 0: leave it out
    iterations: int = 20  # of their trainings
    # of a real robot: likeness of an excitation that is fitted to the first fit_logs
    logs: tuple[Path, ...] = ()
    fit_logs: int = 5
    columns: str | None = None  # column map of the logs
    # its .toml file, for the loads of suspended robots and fixed arms
    real_robot: str | None = None


def cell(settings: Settings, loss: str, kind: str, seed: int, seconds: float) -> dict[str, float]:
    """Results of `measure`, from their file if it is there.

    They are empty, and computed again by the next run, if the library raises an error.
    """
    source = kind
    if kind not in HAND_MADE:
        source = str(excitation_file(settings, kind).relative_to(settings.out))
    recipe = settings.rollout_recipe if loss == "rollout" else loss
    bench = (settings.robot, settings.fleet, settings.motors)
    tag = short_hash(bench, source, recipe, settings.adam_steps, settings.adapt_seconds)
    path = settings.out / "cells" / f"{loss}_{kind}_{seed}_{seconds:g}_{tag}.json"
    if not path.exists():
        try:
            write_json(path, measure(settings, loss, kind, seed, seconds))
        except MotorPriorError as error:
            PROGRESS.note(f"{path.stem}: {error}")
            return {}
        PROGRESS.note(f"{path.stem}: {path.read_text('utf-8')[:200]}")
    return read_json(path)


def short_hash(*settings: object) -> str:
    """Hash of settings, for the names of files that depend on them."""
    return hashlib.sha256(repr(settings).encode()).hexdigest()[:8]


def excitation_file(s: Settings, kind: str) -> Path:
    """File of a learned kind, or of the held-out walks."""
    trained = short_hash(s.robot, s.fleet, s.runs, s.held_out_runs, s.run_seconds, s.training_steps)
    return s.out / f"learned_{trained}" / f"{kind}.safetensors"


def walk(robot: Robot, fleet: Fleet, seed: int, seconds: float) -> MotorLog:
    """Log of a physical robot that trots on the ground, with torques and hence loads.

    Speed, frequency and height change every TROT seconds, with a new segment: windows of one trot
    are much alike.
    """
    rng = np.random.default_rng([seed, 71])
    motors = fleet.sample(robot.num_joints, rng, of_one_robot=True).actuator()
    world = World(robot, robot.twin_physics_dt)
    substeps = round(robot.physics_dt / robot.twin_physics_dt)
    hold_steps = round(robot.control_dt / robot.physics_dt)
    trots = []
    for _ in range(max(1, round(seconds / TROT))):
        targets = trot_targets(robot, rng, round(TROT / robot.control_dt))
        played = replay(world, motors, targets)
        pos = played.joint_pos[::substeps]
        torque = played.joint_torque.reshape(-1, substeps, robot.num_joints).mean(axis=1)
        log = MotorLog(
            time=robot.physics_dt * np.arange(len(pos)),
            joint_pos=pos,
            position_target=np.repeat(targets, hold_steps, axis=0),
            joint_vel=np.gradient(pos, robot.physics_dt, axis=0),
            joint_torque=torque,
            joint_names=robot.joint_names,
            robot=robot.name,
            motor=robot.motor,
            source=f"walk {seed}",
        )
        trots.append(log)
    return with_torque_balance(joined(trots), robot)


def learned(settings: Settings) -> tuple[LearnedExcitation, LearnedExcitation, float]:
    """The excitation, the windows of held-out walks, and the seconds of the training."""
    path = excitation_file(settings, "generated")
    held_out_path = excitation_file(settings, "held_out")
    timing = path.with_name("training.json")
    if not (path.exists() and held_out_path.exists()):
        robot = load_robot(settings.robot)
        fleet = load_fleet(settings.fleet)
        seconds = settings.run_seconds
        logs = [walk(robot, fleet, seed, seconds) for seed in range(settings.runs)]
        held_out_seeds = range(1000, 1000 + settings.held_out_runs)
        held_out_logs = [walk(robot, fleet, seed, seconds) for seed in held_out_seeds]

        started = monotonic()
        fit_excitation(logs, steps=settings.training_steps, out=path, progress=PROGRESS)
        write_json(timing, {"seconds": monotonic() - started})
        fit_excitation(held_out_logs, "recorded", out=held_out_path, progress=PROGRESS)

    excitation = LearnedExcitation.load(path)
    for method in ("surrogate", "recorded"):
        replace(excitation, method=method).save(excitation_file(settings, method))
    train_seconds = float(read_json(timing)["seconds"])
    return excitation, LearnedExcitation.load(held_out_path), train_seconds


def bench_of(settings: Settings, loss: str, kind: str) -> BenchSchedule:
    """Clock of the loss; excitation and loads of the kind."""
    preset = "narrow" if kind == "sinusoid" else "rollout"
    schedule = bench_schedule(preset).for_robot(load_robot(settings.robot))
    if kind not in HAND_MADE:
        schedule = replace(schedule, excitations=(str(excitation_file(settings, kind)),))
    if loss == "paper":
        period = BENCH_SCHEDULES["paper"].period
        segment_steps = round(schedule.segment_steps * schedule.period / period)
        schedule = replace(schedule, period=period, segment_steps=segment_steps, hold_steps=1)
    return schedule


def measure(
    settings: Settings, loss: str, kind: str, seed: int, seconds: float
) -> dict[str, float]:
    """Errors in the robot of motors that were learned from so many seconds [s] of bench log."""
    robot = load_robot(settings.robot)
    fleet = load_fleet(settings.fleet)
    prior, log, _ = _prior(settings, loss, kind, seed, seconds)
    motors = training_motors(fleet, settings.motors, seed)
    z = prior.mean
    if settings.adapt_seconds:
        rng = np.random.default_rng([seed, HELD_OUT_STREAM])
        motors = fleet.sample(settings.motors, rng)
        schedule = bench_of(settings, loss, kind)
        rows = round(settings.adapt_seconds / schedule.period)
        adaptation_log = record(motors, schedule, rows, 10_000 + seed, fleet)
        z = adapt_to(prior, adaptation_log).mean

    figures: dict[str, float] = {}
    models = {"model": lambda index: prior.model.motors(z[index])}
    for place, suspended in PLACES.items():
        errors = robot_fidelity(robot, motors, models, suspended, seed)
        rmse, torque_hf, _ = errors["model"]
        physical_torque_hf = errors["physical"][1]
        figures[f"{place}_rmse"] = float(np.median(rmse))
        figures[f"{place}_torque_hf"] = float(np.median(torque_hf) / np.median(physical_torque_hf))
    if isinstance(prior.model, LatentNetwork):
        figures["growth"] = _growth(prior.model, prior.mean, log)
    return figures


def _growth(model: LatentNetwork, mean: np.ndarray, log: MotorLog) -> float:
    """Growth of an oscillation of the learned motors on the lightest load of `why_oscillation`."""
    armature = model.armature(mean) if model.has_armature else np.zeros(len(mean))
    motors = Learned(model, mean, armature, np.zeros_like(armature))
    slopes = sensitivities(model, mean, recorded_inputs(model, log))
    return growth(model, motors, slopes, MIN_LOAD)[0]


def _prior(
    settings: Settings, loss: str, kind: str, seed: int, seconds: float
) -> tuple[MotorPrior, MotorLog, Path]:
    """The prior of a bench, its log and its folder."""
    schedule = bench_of(settings, loss, kind)
    fleet = load_fleet(settings.fleet)
    motors = training_motors(fleet, settings.motors, seed)
    log = record(motors, schedule, round(seconds / schedule.period), seed, fleet)
    log = replace(log, robot=load_robot(settings.robot).name)
    name = settings.rollout_recipe if loss == "rollout" else loss
    recipe = identification_preset(name, network_steps(name, settings.adam_steps))
    folder = settings.out / "priors" / f"{name}_{kind}_{seed}_{seconds:g}"
    return fit_recipe(log, name, recipe, seed, folder, PROGRESS), log, folder


def transfer(settings: Settings) -> dict[str, float]:
    """Time upright of policies in the environments TESTED, trained on samples of each kind's prior.

    The priors were fitted with the loss rollout and seed 0; each of two benches has its own robots
    and disturbances.
    """
    if not settings.policies:
        return {}
    folders = {
        kind: _prior(settings, "rollout", kind, 0, settings.seconds)[2] for kind in settings.kinds
    }
    kind_of = {f"prior:{folder / PRIOR_FILE}": kind for kind, folder in folders.items()}
    study = Study(
        settings.out / "transfer",
        settings.fleet,
        conditions=tuple(kind_of),
        environments=tuple(TESTED),
        benches=2,
        seeds=settings.policies,
        walks=16,
        iterations=settings.iterations,
        robot=settings.robot,
    )
    figures = {}
    summary = summarise(study_walks(study, PROGRESS).walks)
    for (env, condition, quantity), mean in summary.estimates.items():
        if env in TESTED and quantity == "upright":
            figures |= with_ends(f"transfer/{kind_of[condition]}/{TESTED[env]}", mean)
    return figures


def with_ends(name: str, mean: Estimate) -> dict[str, float]:
    """The figure ``name``, and its interval if there is one."""
    if not np.isfinite(mean.low):
        return {name: mean.value}
    return {name: mean.value, f"{name}/low": mean.low, f"{name}/high": mean.high}


def cells_of(settings: Settings, loss: str, kind: str, seconds: float) -> dict[str, Estimate]:
    """Means over the seeds, with 95 % intervals, of the results of `measure`."""
    values: dict[str, list[float]] = {}
    for seed in range(settings.seeds):
        for quantity, value in cell(settings, loss, kind, seed, seconds).items():
            values.setdefault(quantity, []).append(value)
    return {
        quantity: estimate(np.array(values[quantity])[:, None, None]) for quantity in sorted(values)
    }


def run(settings: Settings) -> dict[str, float]:
    """All figures; without ``runs``, the figures of real logs alone.

    Writes tables, pictures and report.
    """
    figures = real_likeness(settings)
    if settings.runs:
        figures |= of_walks(settings)
    write_text(settings.out / "table.md", table(figures, settings))
    write_text(settings.out / "report.html", report(settings, figures))
    return figures


def of_walks(settings: Settings) -> dict[str, float]:
    """Figures of an excitation of simulated walks, and of motors that are learned with it."""
    excitation, held_out, train_seconds = learned(settings)
    alike = likeness(excitation, held_out, seed=0)
    figures = {"train_seconds": train_seconds} | likeness_figures(alike, "likeness")
    for name in excitation.classes:
        write_picture(settings.out / f"likeness_{name}.png", excitation, held_out, name)
    write_text(settings.out / "likeness.md", likeness_table(alike, excitation.classes))
    for loss, kind in product(settings.losses, settings.kinds):
        for quantity, mean in cells_of(settings, loss, kind, settings.seconds).items():
            name = "walking_error" if quantity == "standing_rmse" else quantity
            figures |= with_ends(f"{name}/{loss}/{kind}", mean)
    return figures | budgets(settings) | transfer(settings)


def likeness_figures(alike: Results, name: str) -> dict[str, float]:
    """Figures of the likeness, means over joint classes."""
    rows = [*product(KINDS, ("auc", "coverage", "nearest_signal"))]
    rows += [*product((TRAIN,), ("auc", "coverage"))]
    return {
        f"{name}/{kind}/{quantity}": alike.mean(model=kind, quantity=quantity)
        for kind, quantity in rows
    }


def real_likeness(settings: Settings) -> dict[str, float]:
    """Likeness of an excitation to logs of a real robot.

    It is fitted to the first ``fit_logs`` logs and compared with the other ones.
    """
    if not settings.logs:
        return {}
    robot = settings.real_robot
    logs = [
        load_log(
            path,
            columns=settings.columns,
            robot=robot,
            suspended=robot is not None,
            progress=PROGRESS,
            allow_errors=True,
        )
        for path in settings.logs
    ]
    period = 0.01 if robot is None else load_robot(robot).control_dt

    excitation = fit_excitation(
        logs[: settings.fit_logs],
        period=period,
        steps=settings.training_steps,
        out=settings.out / "real.safetensors",
        progress=PROGRESS,
    )
    test_logs = logs[settings.fit_logs :]
    test = fit_excitation(test_logs, "recorded", period=period, progress=PROGRESS)
    alike = likeness(excitation, test, seed=0)
    write_text(settings.out / "likeness_real.md", likeness_table(alike, excitation.classes))
    return likeness_figures(alike, "likeness_real")


def budgets(settings: Settings) -> dict[str, float]:
    """Walking error against seconds of log, and seconds that reach the best error of `rollout`."""
    if not settings.budgets:
        return {}
    figures: dict[str, float] = {}
    for kind, seconds in product(settings.kinds, settings.budgets):
        errors = cells_of(settings, "rollout", kind, seconds).get("standing_rmse")
        if errors:
            figures |= with_ends(f"budget/{kind}/{seconds:g}", errors)

    goal = 1.02 * figures[f"budget/rollout/{settings.budgets[-1]:g}"]
    for kind in settings.kinds:
        errors_by_seconds = {
            s: figures.get(f"budget/{kind}/{s:g}", np.inf) for s in settings.budgets
        }
        sufficient = [seconds for seconds, error in errors_by_seconds.items() if error <= goal]
        if sufficient:
            figures[f"seconds_needed/{kind}"] = min(sufficient)
    return figures


def likeness_table(alike: Results, classes: tuple[str, ...]) -> str:
    """Markdown: a row per class and kind."""
    columns = ("auc", "coverage", "nearest_signal", *FEATURES)
    lines = []
    for name, kind in product(classes, (RUNS, TRAIN, *KINDS)):
        values = {row.quantity: row.value for row in alike.where(part=name, model=kind)}
        cells = [f"{values[column]:.3g}" if column in values else "" for column in columns]
        lines.append((name, kind, *cells))
    return markdown(("class", "excitation", *columns), lines) + "\n"


def write_picture(path: Path, runs: LearnedExcitation, test: LearnedExcitation, name: str) -> None:
    """Plot every kind of excitation of one class.

    A window, the spectra, and the distributions of speed, acceleration and external torque.
    """
    figure = Figure(figsize=(14.0, 5.0), layout="constrained")
    panels_of_picture = figure.subplots(2, 3).ravel()
    for kind in (RUNS, *KINDS):
        if kind == RUNS:
            windows = test.windows[test.window_class == test.classes.index(name)]
        else:
            windows = windows_of_kind(runs, kind, name, np.random.default_rng(5))
        _draw_kind(panels_of_picture, windows, runs.period, kind)

    titles = (
        "target [rad] over time [s]",
        "external torque [N·m]",
        "spectrum of the target [Hz]",
        "share above |speed| [rad/s]",
        "share above |acceleration| [rad/s²]",
        "share above |torque| [N·m]",
    )
    for axes, title in zip(panels_of_picture, titles, strict=True):
        axes.set_title(f"{name}: {title}", fontsize=9)
    panels_of_picture[0].legend(frameon=False, fontsize=7)
    path.write_bytes(png_bytes(figure))


def _draw_kind(
    panels_of_picture: Sequence[Axes], windows: np.ndarray, period: float, kind: str
) -> None:
    """Lines of one kind in every panel; windows are (W, frames, 1 + TORQUES_PER_FRAME)."""
    of_target, of_torque, of_spectrum, *of_distributions = panels_of_picture
    line: dict[str, Any] = {"color": COLORS[kind], "lw": 1}
    target = windows[..., 0]
    torque = windows[..., 1:].reshape(len(windows), -1)
    num_frames = target.shape[1]

    of_target.plot(period * np.arange(num_frames), target[0], label=kind, **line)
    of_torque.plot(np.linspace(0, num_frames * period, torque.shape[1]), torque[0], **line)
    spectra = np.fft.rfft(target * np.hanning(num_frames), axis=1)
    power = np.mean(np.abs(spectra) ** 2, axis=0)
    of_spectrum.semilogy(np.fft.rfftfreq(num_frames, period), power + 1e-9, **line)

    speed = np.diff(target, axis=1) / period
    acceleration = np.diff(speed, axis=1) / period
    share = np.linspace(0.0, 0.995, 200)  # larger values would set the range of the axis
    for axes, values in zip(of_distributions, (speed, acceleration, torque), strict=True):
        axes.plot(np.quantile(np.abs(values), share), 1.0 - share, **line)
        axes.set_yscale("log")


def report(settings: Settings, figures: dict[str, float]) -> str:
    """The page: likeness with a picture per class, walking errors, seconds of log, transfer."""
    sections = [
        _likeness_section(settings, figures),
        _loss_section(settings, figures),
        _budget_section(settings, figures),
        _transfer_section(settings, figures),
    ]
    shown = [section for section in sections if section is not None]
    listed = {name: value for name, value in vars(settings).items() if name != "out"}
    return page("Learned excitation", shown, listed, shlex.join(["python", *sys.argv]))


def _cell(figures: dict[str, float], name: str, factor: float, form: str) -> str:
    """A figure with its interval, empty if it was not measured."""
    if name not in figures:
        return ""
    low = figures.get(f"{name}/low", np.nan)
    high = figures.get(f"{name}/high", np.nan)
    return with_interval(Estimate(figures[name], low, high), factor, form)


def _likeness_section(settings: Settings, figures: dict[str, float]) -> Section:
    rows = []
    for kind in (TRAIN, *KINDS):
        names = [f"likeness/{kind}/{column}" for column in ("auc", "coverage", "nearest_signal")]
        rows.append((kind, *(_cell(figures, name, 1.0, ".2f") for name in names)))
    caption = (
        "AUC of a classifier against held-out walks, coverage of them, "
        "distance to the training windows over theirs"
    )
    likeness = Table(("excitation", "AUC", "coverage", "distance"), rows, caption)

    pictures = []
    for path in sorted(settings.out.glob("likeness_*.png")):
        name = path.stem.removeprefix("likeness_")
        title = f"{name}: windows, spectra and distributions"
        pictures.append(Picture(title, path.read_bytes()))
    return Section("Likeness", (), tuple(pictures), (likeness,))


def _loss_section(settings: Settings, figures: dict[str, float]) -> Section | None:
    """Walking errors of every loss and kind; None without losses."""
    rows = []
    for loss in settings.losses:
        names = [f"walking_error/{loss}/{kind}" for kind in settings.kinds]
        rows.append((loss, *(_cell(figures, name, 1e3, ".0f") for name in names)))
    if not rows:
        return None
    caption = (
        f"error of the trotting robot after {settings.seconds:g} s of log per motor, "
        "mean [95 % interval] [mrad]"
    )
    errors = Table(("loss", *settings.kinds), rows, caption)
    return Section("Excitation or loss", tables=(errors,))


def _budget_section(settings: Settings, figures: dict[str, float]) -> Section | None:
    """Error against seconds of log; None without budgets."""
    if not settings.budgets:
        return None
    figure = new_figure(3.0)
    ((axes,),) = panels(figure, 1)
    for kind in settings.kinds:
        seconds = [s for s in settings.budgets if f"budget/{kind}/{s:g}" in figures]
        names = [f"budget/{kind}/{s:g}" for s in seconds]
        errors = [1e3 * figures[name] for name in names]
        low = [max(1.0, 1e3 * figures.get(f"{name}/low", figures[name])) for name in names]
        high = [max(1.0, 1e3 * figures.get(f"{name}/high", figures[name])) for name in names]
        axes.vlines(seconds, low, high, color=COLORS[kind], lw=0.7)
        axes.loglog(seconds, errors, "o-", ms=3, color=COLORS[kind], label=kind)
    axes.set_xticks(settings.budgets, [f"{seconds:g}" for seconds in settings.budgets])
    axes.set_xticks([], minor=True)
    set_labels(axes, "log per motor [s]", "error of the trotting robot [mrad]")
    legend_below(figure, axes, columns=6)

    curves = picture(figure, "Closed-loop training, means over seeds with 95 % intervals")
    return Section("Seconds of log", pictures=(curves,))


def _transfer_section(settings: Settings, figures: dict[str, float]) -> Section | None:
    """Time upright of policies; None if none were trained."""
    rows = []
    for kind in settings.kinds:
        names = [f"transfer/{kind}/{name}" for name in TESTED.values()]
        rows.append((kind, *(_cell(figures, name, 100.0, ".0f") for name in names)))
    if not any(any(cells) for _, *cells in rows):
        return None
    caption = "time upright of policies, mean over two benches [%]"
    upright = Table(("prior from", *TESTED), rows, caption)
    return Section("Transfer", tables=(upright,))


def table(figures: dict[str, float], settings: Settings) -> str:
    """Markdown: a row per loss and excitation."""
    factors = {
        "walking_error": 1e3,
        "suspended_rmse": 1e3,
        "standing_torque_hf": 1.0,
        "suspended_torque_hf": 1.0,
        "growth": 1.0,
    }
    lines = []
    for loss, kind in product(settings.losses, settings.kinds):
        cells = []
        for column, factor in factors.items():
            value = figures.get(f"{column}/{loss}/{kind}")
            cells.append("" if value is None else f"{factor * value:.3g}")
        lines.append((loss, kind, *cells))
    return markdown(("loss", "excitation", *factors), lines) + "\n"


if __name__ == "__main__":
    use_cpu_by_default()
    run_benchmark(Settings, run, __doc__)
