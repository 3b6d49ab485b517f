"""Errors of models on real logs: fitted to some logs, tested on others, from command to motion.

    python benchmarks/real_logs.py --data DIR --out runs/real

The error is the RMSE of one free run over each whole held-out log, without removal of means. The
models of `fitted_baselines` have constants per joint, fitted to the same segments of the training
logs as the prior. ``prior`` uses only the joint names and gains recorded in the test log: the motor
of the same joint, or the central motor. ``adapted`` is fitted to the first 10 s of the test log and
tested on the rest. Loads (inertia, gravity, coupling of the joints) are those of the recorded
motion; pure_delay and second_order use no loads. figures.json contains means over joints and logs
[rad] as ROBOT/TEST/MODEL, the fraction of recorded angles inside the 90 % and 50 % bands of the
adapted prior as ROBOT/coverage90 and ROBOT/coverage50, and inside those of the prior without the
log as ROBOT/unseen/coverage90. Finished stages are reused.

unseen_gains: motor logs (.parquet of ``logs import``, with their own gains and loads) next to the
raw logs of the Go2, of another robot or at other gains, test models of all raw logs.

unseen_leg: the prior and the PD are fitted to the motors of the other legs (recipe quick). They are
tested on the rest of a log, as are ``adapted`` and ``per_motor``, which are fitted to the first 10
s of the motor.
"""

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np

import motorprior as mp
from figures import PROGRESS, run_benchmark
from motorprior.artifacts import read_json, write_json
from motorprior.evaluation.bands import log_coverage, zero_shot
from motorprior.evaluation.free_runs import MotorModel, free_run_errors
from motorprior.evaluation.splits import first_and_rest, window
from motorprior.identification.baselines.pd_fit import fitted_tuned_pd
from motorprior.identification.physics.window_runs import WindowRuns, whole_runs
from motorprior.identification.presets import PRESETS, recipe_of
from motorprior.logs.operations import joined, train_test_halves
from motorprior.logs.readers.motor_log_file import read_parquet
from motorprior.priors.adapt import adapt_to
from motorprior.priors.fit_prior import fit_recipe
from motorprior.priors.validate import baseline_recipes, fitted_baselines
from motorprior.stage import FIGURES, description, is_finished, working

ADAPTATION_SECONDS = 10.0  # initial part of a test log to which ``adapted`` is fitted [s]
# raw logs of each robot: column map and file names
LOGS = {
    "go2": ("go2_identification", "*.csv.gz"), "so101": ("so101_sage", "*.csv.gz"), "xl330": (None, "*.json.gz"),
    "z1": ("z1_tensors", "*.pt"),
}  # fmt: skip
UNSEEN = "unseen_gains"  # name of a test
# name of a test, and its fast recipe
MOTORS_OUT = "unseen_leg"
MOTORS_RECIPE = "quick"
PRIOR_PRESET = "long_runs"  # with the short windows of rollout, missing dynamics bias the constants
FACTOR = {"so101": 5.0, "xl330": 3.0}  # on `Settings.seconds`
EXAMPLES = Path(__file__).resolve().parents[1] / "examples" / "robots"
# ``whole`` and ``rest``: model -> mean over joints and logs [rad]; ``coverage``: level [%] ->
# fraction
Figures: TypeAlias = dict[str, dict[str, float]]
Test: TypeAlias = tuple[str, list[Figures]]  # name of a test, figures of each fold


@dataclass(frozen=True)
class Settings:
    """Identify real motors and measure the errors of models on held-out logs."""

    # folder with go2/, so101/, xl330/, z1/ (raw logs, optional) and robots/ (their models)
    data: Path
    out: Path  # run folder
    robots: tuple[str, ...] = tuple(LOGS)  # robots to test
    # total length of the training segments [s]; 5 times as long for the arm, 3 for the pendulum
    seconds: float = 24.0
    logs: int | None = None  # number of logs per robot; all if not given
    folds: int | None = None  # number of folds; all if not given
    adam_steps: int | None = None  # Adam steps of every network; the preset's number if not given
    baselines: bool = True  # whether to fit the models that the prior is compared with
    seed: int = 0  # seed of trainings and searches


def leave_out(
    settings: Settings, robot: str, paths: Sequence[Path], groups: Sequence[Sequence[Path]]
) -> list[Figures]:
    """Figures of a fold for every group, which is tested and left out of the training."""
    return [
        measure(
            settings, robot, group[0].stem, [path for path in paths if path not in group], group
        )
        for group in groups[: settings.folds]
    ]


def measure(
    settings: Settings, robot: str, fold: str, train: Sequence[Path], test: Sequence[Path]
) -> Figures:
    """Figures of models that are fitted to the logs ``train``, on the logs ``test``."""
    folder = settings.out / robot / fold

    def compute() -> Figures:
        PROGRESS.note(f"{robot}: {', '.join(path.stem for path in test)} left out")
        log = spread_windows(
            [read_parquet(path) for path in train], FACTOR.get(robot, 1.0) * settings.seconds
        )
        prior = mp.fit_prior(
            log, PRIOR_PRESET, settings.seed, out=folder / "prior", progress=PROGRESS
        )
        fitted: dict[str, MotorModel | None] = {}
        if settings.baselines:
            fitted = fitted_baselines(
                log, recipe_of(prior), folder, settings.adam_steps, settings.seed, PROGRESS
            )
        models = {name: motors for name, motors in fitted.items() if motors is not None}
        return _means([tested(prior, read_parquet(path), models) for path in test])

    return stage(settings, folder, [*train, *test], compute)


def stage(
    settings: Settings, folder: Path, inputs: Sequence[Path], compute: Callable[[], Figures]
) -> Figures:
    """Figures that depend on these files and on some settings; computed if ``folder`` does not have them."""
    used = {
        name: getattr(settings, name) for name in ("seconds", "adam_steps", "baselines", "seed")
    }
    wanted = description("validate", used, inputs)
    if not is_finished(folder, wanted):
        with working(folder, wanted):
            write_json(folder / FIGURES, compute())
    return read_json(folder / FIGURES)


def spread_windows(logs: Sequence[mp.MotorLog], seconds: float) -> mp.MotorLog:
    """A window of each log, ``seconds`` in all, from the beginning of the first to the end of the last."""
    return joined([window(log, seconds, index, len(logs)) for index, log in enumerate(logs)])


def tested(
    prior: mp.MotorPrior, log: mp.MotorLog, models: Mapping[str, MotorModel] | None = None
) -> Figures:
    """Errors of the prior and of other models on a log; of ``adapted``, and the coverages, after the log's start."""
    first, rest = start_and_rest(log)
    posterior = adapt_to(prior, first)
    every = {**(models or {}), "prior": prior.model.motors(prior.predicted(log).mean)}
    adapted = {"adapted": prior.model.motors(posterior.mean)}
    runs = whole_runs(rest, recipe_of(prior))
    bands = {"coverage": posterior, "unseen": zero_shot(prior, rest)}
    return {
        "whole": _errors(whole_runs(log, recipe_of(prior)), every),
        "rest": _errors(runs, every | adapted),
        **{
            name: {str(level): share for level, share in log_coverage(prior, motors, runs).items()}
            for name, motors in bands.items()
        },
    }


def start_and_rest(log: mp.MotorLog) -> tuple[mp.MotorLog, mp.MotorLog]:
    """The first ADAPTATION_SECONDS of a log, at most half of it, and the rest."""
    return first_and_rest(log, min(ADAPTATION_SECONDS, log.duration / 2))


def _errors(runs: Sequence[WindowRuns], models: Mapping[str, MotorModel]) -> dict[str, float]:
    """Mean errors over joints [rad]."""
    return {name: float(np.mean(values)) for name, values in free_run_errors(runs, models).items()}


def _means(found: Sequence[Figures]) -> Figures:
    return {
        span: {name: float(np.mean([each[span][name] for each in found])) for name in values}
        for span, values in found[0].items()
    }


def as_figures(robot: str, test: str, found: Sequence[Figures]) -> dict[str, float]:
    """Means over all folds of a robot, by their keys in figures.json."""
    means = _means(found)
    errors = means["rest"] | means.get("whole", {})  # adapted has no whole log
    keys = {f"{robot}/{test}/{model}": value for model, value in errors.items()}
    keys |= {f"{robot}/{test}/rest/prior": means["rest"]["prior"]}  # over the same rows as adapted
    place = f"{robot}/{test}" if test in (UNSEEN, MOTORS_OUT) else robot
    keys |= {f"{place}/coverage{level}": share for level, share in means["coverage"].items()}
    return keys | {
        f"{place}/unseen/coverage{level}": share for level, share in means["unseen"].items()
    }


def go2(settings: Settings) -> Iterator[Test]:
    """Twelve motors of a suspended quadruped, six logs of the same chirp: each is left out in turn.

    Raw logs get the gains of their column map; motor logs (.parquet) are only tested, by models of
    all raw logs.
    """
    paths = imported(settings, "go2")
    robot = mp.load_robot(str(robot_file(settings, "go2")))
    if test := tuple(sorted((settings.data / "go2").glob("*.parquet"))):
        yield UNSEEN, [measure(settings, "go2", UNSEEN, paths, test)]
    yield "leave_one_log_out", leave_out(settings, "go2", paths, [[path] for path in paths])
    legs = enumerate(robot.legs[: settings.folds])
    yield MOTORS_OUT, [_motors_out(settings, robot, paths, fold, leg.joints) for fold, leg in legs]


def _motors_out(
    settings: Settings, robot: mp.Robot, paths: Sequence[Path], fold: int, group: Sequence[int]
) -> Figures:
    """The motors of one leg, tested on the rest of a log; models fitted to the other legs, or to the log's start."""
    test = paths[fold % len(paths)]
    folder = settings.out / robot.name / MOTORS_OUT / str(fold)

    def compute() -> Figures:
        train = spread_windows([read_parquet(path) for path in paths], settings.seconds)
        others = train.with_joints(
            [joint for joint in range(train.num_joints) if joint not in group]
        )
        own = read_parquet(test).with_joints(group)
        first, _ = start_and_rest(own)
        alone = baseline_recipes(first, PRESETS[MOTORS_RECIPE])["per_motor"]
        prior = mp.fit_prior(
            others, MOTORS_RECIPE, settings.seed, out=folder / "others", progress=PROGRESS
        )
        per_motor = fit_recipe(first, *alone, settings.seed, folder / "per_motor", PROGRESS)
        models: dict[str, MotorModel] = {
            "per_motor": per_motor.model.motors(per_motor.mean),
            "tuned_pd": fitted_tuned_pd(others, PROGRESS, len(group)),
        }
        found = tested(prior, own, models)
        del found["whole"]  # per_motor was fitted to the start
        return found

    return stage(settings, folder, [*paths, test, *robot.files], compute)


def so101(settings: Settings) -> Iterator[Test]:
    """Six servos of an arm, forty motions: a quarter of them is left out in turn."""
    paths = imported(settings, "so101")
    yield (
        "leave_motions_out",
        leave_out(settings, "so101", paths, [paths[quarter::4] for quarter in range(4)]),
    )


def xl330(settings: Settings) -> Iterator[Test]:
    """One servo with a pendulum, four gains: each is left out in turn."""
    gains: dict[float, list[Path]] = {}
    for path in imported(settings, "xl330"):
        kp = read_parquet(path).logged_kp
        assert kp is not None
        gains.setdefault(float(kp[0, 0]), []).append(path)
    paths = [path for group in gains.values() for path in group]
    yield "unseen_gain", leave_out(settings, "xl330", paths, list(gains.values()))


def z1(settings: Settings) -> Iterator[Test]:
    """Seven motors of an arm, one chirp: trained on its slow first half, tested on the fast second half."""
    (path,) = imported(settings, "z1")
    halves = [path.with_name(f"{half}_half.parquet") for half in ("first", "second")]
    for half, log in zip(halves, train_test_halves(read_parquet(path)), strict=True):
        mp.write_log(half, log)
    yield "second_half", [measure(settings, "z1", "second_half", halves[:1], halves[1:])]


ROBOTS: dict[str, Callable[[Settings], Iterator[Test]]] = {
    "go2": go2,
    "so101": so101,
    "xl330": xl330,
    "z1": z1,
}


def robot_file(settings: Settings, name: str) -> Path:
    """Copy of the example robot file, next to a copy of its model, in the run folder."""
    folder = settings.out / name / "robot"
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copy(settings.data / "robots" / f"{name}.xml", folder)
    return Path(shutil.copy(EXAMPLES / f"{name}.toml", folder))


def imported(settings: Settings, name: str) -> list[Path]:
    """Motor logs with loads, from the robot's rigid-body model if it has one; imported if they do not exist."""
    columns, pattern = LOGS[name]
    raw = tuple(sorted((settings.data / name).glob(pattern))[: settings.logs])
    folder = settings.out / name / "logs"
    described = None if name == "xl330" else str(robot_file(settings, name))
    logs = {path: folder / f"{path.name.split('.')[0]}.parquet" for path in raw}
    wanted = description(
        "import",
        {"columns": columns},
        [*raw, *(mp.load_robot(described).files if described else [])],
    )
    if not is_finished(folder, wanted):
        with working(folder, wanted):
            is_fixed = described is not None
            for path, log in logs.items():
                mp.write_log(
                    log,
                    mp.load_log(
                        path,
                        columns=columns,
                        robot=described,
                        suspended=is_fixed,
                        progress=PROGRESS,
                    ),
                )
    return list(logs.values())


def measure_robots(settings: Settings) -> dict[str, float]:
    """The figures of all robots."""
    figures: dict[str, float] = {}
    for name in settings.robots:
        if not (settings.data / name).is_dir():
            print(f"{name}: skipped, no folder {settings.data / name}")
            continue
        for test, found in ROBOTS[name](settings):
            figures |= as_figures(name, test, found)
    return figures


if __name__ == "__main__":
    run_benchmark(Settings, measure_robots, __doc__)
