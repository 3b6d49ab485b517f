"""Is a learned excitation like the robot, does it cure the paper's models, where does it pay: docs/excitation.md.

    python benchmarks/excitation.py --out runs/excitation

Every cell (one excitation, loss, seed and length of log) is a file named by its settings; the same
command continues an interrupted run.
"""

import hashlib
import os
import shlex
import sys
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from time import monotonic

import numpy as np
from matplotlib.figure import Figure

from excitation_likeness import FEATURES, KINDS, TRAIN, likeness, windows_of_kind
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
from motorprior.logs.load_log import load_log
from motorprior.logs.loads import with_torque_balance
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import joined
from motorprior.priors.adapt import adapt_to
from motorprior.priors.fit_prior import PRIOR, fit_recipe
from motorprior.report.page import Picture, Section, Table, page, picture
from motorprior.report.plots_style import describe, legend_below, new_figure, panels, png_bytes
from motorprior.report.transfer_page import with_interval
from motorprior.results import Results
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.simulation.playback import replay
from motorprior.simulation.world import World
from motorprior.studies.statistics import Estimate, estimate, means, summarise
from motorprior.studies.study_settings import Study
from motorprior.studies.transfer import study_walks
from virtual_fleets.robot_fidelity import robot_fidelity, trot_targets
from why_oscillation import LOADS, Learned, growth, recorded_inputs, sensitivities

PLACES = {"standing": False, "suspended": True}
COLORS: dict[str, str] = {
    "runs": "k",
    **dict(zip(KINDS, ("C7", "C0", "C2", "C1", "C3"), strict=True)),
}
HELD_OUT_STREAM = 67
TROT = 2.5  # [s]
# environment of the transfer -> name of its figure
TESTED = {"fleet": "upright", "hard": "upright_hard"}
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
    adam_steps: int | None = None  # of networks; those of their recipes if not given
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
    """What `measure` finds, from its file if it is there; empty, and computed again, where the library refuses."""
    source = (
        kind
        if kind in ("sinusoid", "rollout")
        else str(excitation_file(settings, kind).relative_to(settings.out))
    )
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


def short_hash(*given: object) -> str:
    """Of settings, for the names of files that depend on them."""
    return hashlib.sha256(repr(given).encode()).hexdigest()[:8]


def excitation_file(s: Settings, kind: str) -> Path:
    """Of a learned kind, or of the held-out walks."""
    trained = short_hash(s.robot, s.fleet, s.runs, s.held_out_runs, s.run_seconds, s.training_steps)
    return s.out / f"learned_{trained}" / f"{kind}.safetensors"


def walk(robot: Robot, fleet: Fleet, seed: int, seconds: float) -> MotorLog:
    """A physical robot that trots on the ground, with its motors' torques and hence the loads of its joints.

    Speed, frequency and height change every TROT seconds, with a new segment: windows of one trot
    are much alike.
    """
    rng = np.random.default_rng([seed, 71])
    motors = fleet.sample(robot.num_joints, rng, of_one_robot=True).actuator()
    world = World(robot, robot.twin_physics_dt)
    every = round(robot.physics_dt / robot.twin_physics_dt)
    trots = []
    for _ in range(max(1, round(seconds / TROT))):
        targets = trot_targets(robot, rng, round(TROT / robot.control_dt))
        played = replay(world, motors, targets)
        pos = played.joint_pos[::every]
        trots.append(
            MotorLog(
                time=robot.physics_dt * np.arange(len(pos)),
                joint_pos=pos,
                position_target=np.repeat(
                    targets, round(robot.control_dt / robot.physics_dt), axis=0
                ),
                joint_vel=np.gradient(pos, robot.physics_dt, axis=0),
                joint_torque=played.joint_torque.reshape(-1, every, robot.num_joints).mean(axis=1),
                joint_names=robot.joint_names,
                robot=robot.name,
                motor=robot.motor,
                source=f"walk {seed}",
            )
        )
    return with_torque_balance(joined(trots), robot)


def learned(settings: Settings) -> tuple[LearnedExcitation, LearnedExcitation, float]:
    """The excitation, the windows of held-out walks, and the seconds of the training."""
    paths = [excitation_file(settings, name) for name in ("generated", "held_out")]
    timing = paths[0].with_name("training.json")
    held_out = range(1000, 1000 + settings.held_out_runs)
    if not all(path.exists() for path in paths):
        robot = load_robot(settings.robot)
        fleet = load_fleet(settings.fleet)
        logs = [
            walk(robot, fleet, seed, settings.run_seconds)
            for seed in (*range(settings.runs), *held_out)
        ]
        started = monotonic()
        fit_excitation(
            logs[: settings.runs], steps=settings.training_steps, out=paths[0], progress=PROGRESS
        )
        write_json(timing, {"seconds": monotonic() - started})
        fit_excitation(logs[settings.runs :], "recorded", out=paths[1], progress=PROGRESS)
    found, test = (LearnedExcitation.load(path) for path in paths)
    for method in ("surrogate", "recorded"):
        found.with_method(method).save(excitation_file(settings, method))
    return found, test, float(read_json(timing)["seconds"])


def bench_of(settings: Settings, loss: str, kind: str) -> BenchSchedule:
    """Clock of the loss; excitation and loads of the kind."""
    base = bench_schedule("narrow" if kind == "sinusoid" else "rollout").for_robot(
        load_robot(settings.robot)
    )
    if kind not in ("sinusoid", "rollout"):
        base = replace(base, excitations=(str(excitation_file(settings, kind)),))
    if loss == "paper":
        slow = BENCH_SCHEDULES["paper"].period
        base = replace(
            base,
            period=slow,
            segment_steps=round(base.segment_steps * base.period / slow),
            hold_steps=1,
        )
    return base


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
        preset = bench_of(settings, loss, kind)
        rows = round(settings.adapt_seconds / preset.period)
        z = adapt_to(prior, record(motors, preset, rows, 10_000 + seed, fleet)).mean
    found: dict[str, float] = {}
    for place, suspended in PLACES.items():
        errors = robot_fidelity(
            robot, motors, {"model": lambda index: prior.model.motors(z[index])}, suspended, seed
        )
        found[f"{place}_rmse"] = float(np.median(errors["model"][0]))
        found[f"{place}_torque_hf"] = float(
            np.median(errors["model"][1]) / np.median(errors["physical"][1])
        )
    if isinstance(prior.model, LatentNetwork):
        armature = (
            prior.model.armature(prior.mean)
            if prior.model.has_armature
            else np.zeros(len(prior.mean))
        )
        own = Learned(prior.model, prior.mean, armature, np.zeros_like(armature))
        slopes = sensitivities(prior.model, prior.mean, recorded_inputs(prior.model, log))
        found["growth"] = growth(prior.model, own, slopes, float(LOADS[0]))[0]
    return found


def _prior(
    settings: Settings, loss: str, kind: str, seed: int, seconds: float
) -> tuple[MotorPrior, MotorLog, Path]:
    """The prior of a bench, its log and its folder."""
    preset = bench_of(settings, loss, kind)
    fleet = load_fleet(settings.fleet)
    motors = training_motors(fleet, settings.motors, seed)
    log = record(motors, preset, round(seconds / preset.period), seed, fleet)
    log = replace(log, robot=load_robot(settings.robot).name)
    name = settings.rollout_recipe if loss == "rollout" else loss
    recipe = identification_preset(name, network_steps(name, settings.adam_steps))
    folder = settings.out / "priors" / f"{name}_{kind}_{seed}_{seconds:g}"
    return fit_recipe(log, name, recipe, seed, folder, PROGRESS), log, folder


def transfer(settings: Settings) -> dict[str, float]:
    """Time upright of policies that are trained on samples of the prior of each kind, in the environments TESTED.

    The priors are those of the loss rollout and seed 0; each of two benches has its own robots and
    disturbances.
    """
    if not settings.policies:
        return {}
    folders = {
        kind: _prior(settings, "rollout", kind, 0, settings.seconds)[2] for kind in settings.kinds
    }
    kind_of = {f"prior:{folder / PRIOR}": kind for kind, folder in folders.items()}
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
    for (env, condition, measure), found in summarise(
        study_walks(study, PROGRESS)
    ).estimates.items():
        if env in TESTED and measure == "upright":
            figures |= with_ends(f"transfer/{kind_of[condition]}/{TESTED[env]}", found)
    return figures


def with_ends(name: str, found: Estimate) -> dict[str, float]:
    """The figure ``name``, and its interval if there is one."""
    ends = {f"{name}/low": found.low, f"{name}/high": found.high} if np.isfinite(found.low) else {}
    return {name: found.value, **ends}


def cells_of(settings: Settings, loss: str, kind: str, seconds: float) -> dict[str, Estimate]:
    """Means over the seeds, with 95 % intervals, of everything that `measure` finds."""
    cells = [cell(settings, loss, kind, seed, seconds) for seed in range(settings.seeds)]
    return {
        quantity: estimate(
            np.array([found[quantity] for found in cells if quantity in found])[:, None, None],
            means,
        )
        for quantity in sorted({key for found in cells for key in found})
    }


def run(settings: Settings) -> dict[str, float]:
    """All figures; those of real logs alone if no walks are to be learned from. Writes tables, pictures and report."""
    figures = real_likeness(settings) | (of_walks(settings) if settings.runs else {})
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
        for quantity, found in cells_of(settings, loss, kind, settings.seconds).items():
            name = {"standing_rmse": "walking_error"}.get(quantity, quantity)
            figures |= with_ends(f"{name}/{loss}/{kind}", found)
    return figures | budgets(settings) | transfer(settings)


def likeness_figures(alike: Results, name: str) -> dict[str, float]:
    """Means over joint classes."""
    rows = [(kind, each) for kind in KINDS for each in ("auc", "coverage", "nearest_signal")]
    rows += [(TRAIN, each) for each in ("auc", "coverage")]
    return {f"{name}/{kind}/{each}": alike.mean(model=kind, quantity=each) for kind, each in rows}


def real_likeness(settings: Settings) -> dict[str, float]:
    """Likeness of an excitation that is fitted to the first ``fit_logs`` logs of a real robot to the others."""
    if not settings.logs:
        return {}
    given = {
        "columns": settings.columns,
        "robot": settings.real_robot,
        "suspended": settings.real_robot is not None,
    }
    logs = [load_log(path, **given, progress=PROGRESS) for path in settings.logs]
    out = settings.out / "real.safetensors"
    steps = settings.training_steps
    rest = logs[settings.fit_logs :]
    period = 0.01 if settings.real_robot is None else load_robot(settings.real_robot).control_dt
    found = fit_excitation(
        logs[: settings.fit_logs], period=period, steps=steps, out=out, progress=PROGRESS
    )
    alike = likeness(
        found, fit_excitation(rest, "recorded", period=period, progress=PROGRESS), seed=0
    )
    write_text(settings.out / "likeness_real.md", likeness_table(alike, found.classes))
    return likeness_figures(alike, "likeness_real")


def budgets(settings: Settings) -> dict[str, float]:
    """Walking error against seconds of log, and the seconds that reach the best error of `rollout`."""
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
    for name in classes:
        for kind in ("runs", TRAIN, *KINDS):
            rows = {row.quantity: row.value for row in alike.where(part=name, model=kind)}
            lines.append(
                (
                    name,
                    kind,
                    *(f"{rows[column]:.3g}" if column in rows else "" for column in columns),
                )
            )
    return markdown(("class", "excitation", *columns), lines) + "\n"


def write_picture(path: Path, runs: LearnedExcitation, test: LearnedExcitation, name: str) -> None:
    """A window, the spectra, and the distributions of speed, acceleration and external torque of every kind."""
    figure = Figure(figsize=(14.0, 5.0), layout="constrained")
    axes = figure.subplots(2, 3).ravel()
    for kind in ("runs", *KINDS):
        rng = np.random.default_rng(5)
        windows = test.windows[test.window_class == test.classes.index(name)]
        if kind != "runs":
            windows = windows_of_kind(runs, kind, name, rng)
        target = windows[..., 0]
        torque = windows[..., 1:].reshape(len(windows), -1)
        color = COLORS[kind]
        speed = np.diff(target, axis=1) / runs.period
        axes[0].plot(
            runs.period * np.arange(target.shape[1]), target[0], color=color, lw=1, label=kind
        )
        axes[1].plot(
            np.linspace(0, target.shape[1] * runs.period, torque.shape[1]),
            torque[0],
            color=color,
            lw=1,
        )
        power = np.mean(
            np.abs(np.fft.rfft(target * np.hanning(target.shape[1]), axis=1)) ** 2, axis=0
        )
        axes[2].semilogy(
            np.fft.rfftfreq(target.shape[1], runs.period), power + 1e-9, color=color, lw=1
        )
        for place, values in ((3, speed), (4, np.diff(speed, axis=1) / runs.period), (5, torque)):
            share = np.linspace(0.0, 0.995, 200)  # the rest would set the range of the axis
            axes[place].plot(np.quantile(np.abs(values), share), 1.0 - share, color=color, lw=1)
            axes[place].set_yscale("log")
    titles = (
        "target [rad] over time [s]",
        "external torque [N·m]",
        "spectrum of the target [Hz]",
        "share above |speed| [rad/s]",
        "share above |acceleration| [rad/s²]",
        "share above |torque| [N·m]",
    )
    for each, title in zip(axes, titles, strict=True):
        each.set_title(f"{name}: {title}", fontsize=9)
    axes[0].legend(frameon=False, fontsize=7)
    path.write_bytes(png_bytes(figure))


def report(settings: Settings, figures: dict[str, float]) -> str:
    """The page: likeness with a picture per class, walking errors, error against seconds of log, transfer."""

    def cells(name: str, factor: float, form: str) -> str:
        """A figure with its interval, empty if it was not measured."""
        if name not in figures:
            return ""
        found = Estimate(*(figures.get(f"{name}{end}", np.nan) for end in ("", "/low", "/high")))
        return with_interval(found, factor, form)

    columns = ("auc", "coverage", "nearest_signal")
    rows = [
        (kind, *(cells(f"likeness/{kind}/{each}", 1.0, ".2f") for each in columns))
        for kind in (TRAIN, *KINDS)
    ]
    caption = "AUC of a classifier against held-out walks, coverage of them, distance to the training windows over theirs"
    pictures = [
        Picture(
            f"{path.stem.removeprefix('likeness_')}: windows, spectra and distributions",
            path.read_bytes(),
        )
        for path in sorted(settings.out.glob("likeness_*.png"))
    ]
    titles = ("excitation", "AUC", "coverage", "distance")
    sections = [Section("Likeness", (), tuple(pictures), (Table(titles, rows, caption),))]
    rows = [
        (loss, *(cells(f"walking_error/{loss}/{kind}", 1e3, ".0f") for kind in settings.kinds))
        for loss in settings.losses
    ]
    caption = f"error of the trotting robot after {settings.seconds:g} s of log per motor, mean [95 % interval] [mrad]"
    if rows:
        sections.append(
            Section("Excitation or loss", tables=(Table(("loss", *settings.kinds), rows, caption),))
        )
    if settings.budgets:
        figure = new_figure(3.0)
        ((axes,),) = panels(figure, 1)
        for kind in settings.kinds:
            known = [
                seconds for seconds in settings.budgets if f"budget/{kind}/{seconds:g}" in figures
            ]
            names = [f"budget/{kind}/{seconds:g}" for seconds in known]
            color = COLORS[kind]
            low, high = (
                [max(1.0, 1e3 * figures.get(f"{n}{end}", figures[n])) for n in names]
                for end in ("/low", "/high")
            )
            axes.vlines(known, low, high, color=color, lw=0.7)
            axes.loglog(
                known, [1e3 * figures[n] for n in names], "o-", ms=3, color=color, label=kind
            )
        axes.set_xticks(settings.budgets, [f"{seconds:g}" for seconds in settings.budgets])
        axes.set_xticks([], minor=True)
        describe(axes, "log per motor [s]", "error of the trotting robot [mrad]")
        legend_below(figure, axes, columns=6)
        shown = (picture(figure, "Closed-loop training, means over seeds with 95 % intervals"),)
        sections.append(Section("Seconds of log", pictures=shown))
    rows = [
        (kind, *(cells(f"transfer/{kind}/{name}", 100.0, ".0f") for name in TESTED.values()))
        for kind in settings.kinds
    ]
    if any(any(row[1:]) for row in rows):
        table = Table(
            ("prior from", *TESTED), rows, "time upright of policies, mean over two benches [%]"
        )
        sections.append(Section("Transfer", tables=(table,)))
    given = {name: value for name, value in vars(settings).items() if name != "out"}
    return page("Learned excitation", sections, given, shlex.join(["python", *sys.argv]))


def table(figures: dict[str, float], settings: Settings) -> str:
    """Markdown: a row per loss and excitation."""
    columns = (
        "walking_error",
        "suspended_rmse",
        "standing_torque_hf",
        "suspended_torque_hf",
        "growth",
    )
    factors = (1e3, 1e3, 1.0, 1.0, 1.0)
    lines = []
    for loss, kind in product(settings.losses, settings.kinds):
        values = [figures.get(f"{column}/{loss}/{kind}") for column in columns]
        cells = ("" if v is None else f"{f * v:.3g}" for v, f in zip(values, factors, strict=True))
        lines.append((loss, kind, *cells))
    return markdown(("loss", "excitation", *columns), lines) + "\n"


if __name__ == "__main__":
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    run_benchmark(Settings, run, __doc__)
