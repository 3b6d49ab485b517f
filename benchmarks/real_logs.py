"""Errors of models on real logs: fitted to some logs, tested on others, from command to motion.

    python benchmarks/real_logs.py --data DIR --out runs/real

The error is the RMSE of one free run over each whole held-out log, without removal of means. The
models of `fitted_baselines` have constants per joint, fitted to the same segments of the training
logs as the prior. ``prior`` uses only the joint names and gains recorded in the test log: the motor
of the same joint, or the central motor. ``adapted`` is fitted to the first 10 s of the test log and
tested on the rest. Loads (inertia, gravity, coupling of the joints) are those of the recorded
motion; pure_delay and second_order use no loads.

figures.json contains

    ROBOT/TEST/MODEL          mean over joints and logs [rad]
    ROBOT/coverage90, 50      fraction of recorded angles inside the bands of the adapted prior
    ROBOT/unseen/coverage90   fraction inside the bands of the prior without the log

Finished stages are reused.

fast_motions, large_motions: the faster, or larger, quarter of the arm's motions is left out.

unseen_gains: motor logs (.parquet of ``logs import``, with their own gains and loads) next to the
raw logs of the Go2, of another robot or at other gains, test models of all raw logs.

unseen_leg: the prior and the PD are fitted to the motors of the other legs (preset quick). They are
tested on the rest of a log, as are ``adapted`` and ``per_motor``, which are fitted to the first 10
s of the motor.
"""

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np

import motorprior as mp
from ak80_logs import ak80_logs
from figures import PROGRESS, import_log, run_benchmark
from motorprior.artifacts import read_json, write_json
from motorprior.evaluation.bands import log_coverage, zero_shot
from motorprior.evaluation.free_runs import MotorModel, free_run_errors
from motorprior.evaluation.splits import first_and_rest, window
from motorprior.identification.baselines.pd_fit import fitted_tuned_pd
from motorprior.identification.latents.latent_fit import LatentPosterior
from motorprior.identification.physics.window_runs import WindowRuns, whole_runs
from motorprior.identification.presets import PRESETS, recipe_of
from motorprior.logs.operations import joined, train_test_halves
from motorprior.logs.readers.motor_log_file import read_parquet
from motorprior.priors.adapt import adapt_to
from motorprior.priors.fit_prior import fit_recipe
from motorprior.priors.validate import baseline_recipes, fitted_baselines
from motorprior.signals import rms
from motorprior.stage import FIGURES, description, is_finished, working

ADAPTATION_SECONDS = 10.0  # initial part of a test log to which ``adapted`` is fitted [s]


class RawLogs(NamedTuple):
    """Raw logs of a robot."""

    columns: str | None  # column map
    pattern: str  # of the file names


LOGS = {
    "go2": RawLogs("go2_identification", "*.csv.gz"),
    "so101": RawLogs("so101_sage", "*.csv.gz"),
    "xl330": RawLogs(None, "*.json.gz"),
    "z1": RawLogs("z1_tensors", "*.pt"),
}
FACTOR = {"so101": 5.0, "xl330": 3.0}  # on `Settings.seconds`
PRIOR_PRESET = "long_runs"  # with the short windows of rollout, missing dynamics bias the constants
EXAMPLES = Path(__file__).resolve().parents[1] / "examples" / "robots"


def commanded_speed(log: mp.MotorLog) -> float:
    """Root mean square of the commanded velocities of all joints [rad/s]."""
    return float(rms(np.diff(log.position_target, axis=0) / log.period))


def commanded_range(log: mp.MotorLog) -> float:
    """Mean range of the commanded angles over the joints [rad]."""
    return float(np.ptp(log.position_target, axis=0).mean())


# regimes that are left out: the quarter of the motions with the largest value
REGIMES = {"fast_motions": commanded_speed, "large_motions": commanded_range}

# names of tests
UNSEEN_GAINS = "unseen_gains"
UNSEEN_LEG = "unseen_leg"
UNSEEN_LEG_PRESET = "quick"

# ``whole`` and ``rest``: model -> mean over joints and logs [rad]; ``coverage`` and ``unseen``:
# level [%] -> fraction
Figures: TypeAlias = dict[str, dict[str, float]]
Test: TypeAlias = tuple[str, list[Figures]]  # name of a test, figures of each fold


@dataclass(frozen=True)
class Settings:
    """Identify real motors and measure the errors of models on held-out logs."""

    # folder with go2/, so101/, xl330/, z1/, ak80/ (raw logs, optional) and robots/ (their models)
    data: Path
    out: Path  # run folder
    robots: tuple[str, ...] = (*LOGS, "ak80")  # robots to test
    # total length of the training segments [s]; 5 times as long for the arm, 3 for the pendulum
    seconds: float = 24.0
    logs: int | None = None  # number of logs per robot; all if not given
    folds: int | None = None  # number of folds; all if not given
    adam_steps: int | None = None  # Adam steps of every network; the preset's number if not given
    baselines: bool = True  # whether to fit the models that the prior is compared with
    seed: int = 0  # seed of trainings and searches


def measure_robots(settings: Settings) -> dict[str, float]:
    """The figures of all robots."""
    figures: dict[str, float] = {}
    for robot in settings.robots:
        if not (settings.data / robot).is_dir():
            print(f"{robot}: skipped, no folder {settings.data / robot}")
            continue
        for test, folds in ROBOTS[robot](settings):
            figures |= as_figures(robot, test, folds)
    return figures


# Robots and their tests.


def go2(settings: Settings) -> Iterator[Test]:
    """Twelve motors of a suspended quadruped, six logs of the same chirp: each is left out in turn.

    Raw logs get the gains of their column map; motor logs (.parquet) are only tested, by models of
    all raw logs.
    """
    raw_paths = imported(settings, "go2")
    robot = mp.load_robot(str(robot_file(settings, "go2")))

    motor_logs = sorted((settings.data / "go2").glob("*.parquet"))
    if motor_logs:
        yield UNSEEN_GAINS, [fold(settings, "go2", UNSEEN_GAINS, raw_paths, motor_logs)]

    yield "leave_one_log_out", leave_out(settings, "go2", raw_paths, [[path] for path in raw_paths])

    folds = []
    for number, leg in enumerate(robot.legs[: settings.folds]):
        folds.append(_leg_fold(settings, robot, raw_paths, number, leg.joints))
    yield UNSEEN_LEG, folds


def so101(settings: Settings) -> Iterator[Test]:
    """Six servos of an arm, forty motions: a quarter of them is left out in turn.

    Then the fastest quarter is left out, and the quarter with the largest ranges (REGIMES).
    """
    paths = imported(settings, "so101")
    quarters = [paths[quarter::4] for quarter in range(4)]
    yield "leave_motions_out", leave_out(settings, "so101", paths, quarters)

    for name, size in REGIMES.items():
        by_size = sorted(paths, key=lambda path: size(read_parquet(path)))
        count = -(-len(paths) // 4)
        yield name, [fold(settings, "so101", name, by_size[:-count], by_size[-count:])]


def xl330(settings: Settings) -> Iterator[Test]:
    """One servo with a pendulum, four gains: each is left out in turn."""
    paths_of_kp: dict[float, list[Path]] = {}
    for path in imported(settings, "xl330"):
        kp = read_parquet(path).logged_kp
        assert kp is not None
        paths_of_kp.setdefault(float(kp[0, 0]), []).append(path)

    groups = list(paths_of_kp.values())
    paths = [path for group in groups for path in group]
    yield "unseen_gain", leave_out(settings, "xl330", paths, groups)


def z1(settings: Settings) -> Iterator[Test]:
    """Seven motors of an arm, one chirp: trained on its slow half, tested on its fast half."""
    (path,) = imported(settings, "z1")
    yield "second_half", [second_half(settings, "z1", "second_half", path)]


def ak80(settings: Settings) -> Iterator[Test]:
    """Quasi-direct drives: a pendulum in MIT mode, a double pendulum under torque control.

    Models are trained on the first half of each log and tested on the second.
    """
    logs = ak80_logs(settings.data / "ak80", settings.out / "ak80" / "logs")
    for name, path in logs.items():
        yield name, [second_half(settings, "ak80", name, path)]


ROBOTS: dict[str, Callable[[Settings], Iterator[Test]]] = {
    "go2": go2,
    "so101": so101,
    "xl330": xl330,
    "z1": z1,
    "ak80": ak80,
}


# Folds.


def leave_out(
    settings: Settings, robot: str, paths: Sequence[Path], groups: Sequence[Sequence[Path]]
) -> list[Figures]:
    """Figures of a fold for every group, which is tested and left out of the training."""
    folds = []
    for group in groups[: settings.folds]:
        train = [path for path in paths if path not in group]
        folds.append(fold(settings, robot, group[0].stem, train, group))
    return folds


def second_half(settings: Settings, robot: str, name: str, path: Path) -> Figures:
    """Figures of a fold that trains on the first half of a log and tests on the second."""
    halves = []
    for part, log in zip(("first", "second"), train_test_halves(read_parquet(path)), strict=True):
        half = path.with_name(f"{path.stem}_{part}_half.parquet")
        mp.write_log(half, log)
        halves.append(half)
    return fold(settings, robot, name, halves[:1], halves[1:])


def fold(
    settings: Settings, robot: str, name: str, train: Sequence[Path], test: Sequence[Path]
) -> Figures:
    """Figures of models that are fitted to the logs ``train``, on the logs ``test``."""
    folder = settings.out / robot / name

    def compute() -> Figures:
        PROGRESS.note(f"{robot}: {', '.join(path.stem for path in test)} left out")
        logs = [read_parquet(path) for path in train]
        log = spread_windows(logs, FACTOR.get(robot, 1.0) * settings.seconds)
        out = folder / "prior"
        prior = mp.fit_prior(log, PRIOR_PRESET, settings.seed, out=out, progress=PROGRESS)

        models: dict[str, MotorModel] = {}
        if settings.baselines:
            baselines = fitted_baselines(
                log, recipe_of(prior), folder, settings.adam_steps, settings.seed, PROGRESS
            )
            for model, motors in baselines.items():
                if motors is not None:  # its fit did not fail
                    models[model] = motors
        return _means([errors_on_log(prior, read_parquet(path), models) for path in test])

    return stage(settings, folder, [*train, *test], compute)


def _leg_fold(
    settings: Settings, robot: mp.Robot, paths: Sequence[Path], number: int, leg: Sequence[int]
) -> Figures:
    """The motors of one leg, tested on the rest of a log.

    Models are fitted to the other legs, or to the start of the log. ``leg`` are its joints.
    """
    test = paths[number % len(paths)]
    folder = settings.out / robot.name / UNSEEN_LEG / str(number)

    def compute() -> Figures:
        # the prior and the PD, of the other legs
        train = spread_windows([read_parquet(path) for path in paths], settings.seconds)
        other_joints = [joint for joint in range(train.num_joints) if joint not in leg]
        other_legs = train.with_joints(other_joints)
        out = folder / "others"
        prior = mp.fit_prior(
            other_legs, UNSEEN_LEG_PRESET, settings.seed, out=out, progress=PROGRESS
        )
        tuned_pd = fitted_tuned_pd(other_legs, PROGRESS, len(leg))

        # a motor per joint, of the start of the log
        log_of_leg = read_parquet(test).with_joints(leg)
        start, _ = start_and_rest(log_of_leg)
        preset, recipe = baseline_recipes(start, PRESETS[UNSEEN_LEG_PRESET])["per_motor"]
        out = folder / "per_motor"
        per_motor = fit_recipe(start, preset, recipe, settings.seed, out, PROGRESS)

        models: dict[str, MotorModel] = {
            "per_motor": per_motor.model.motors(per_motor.mean),
            "tuned_pd": tuned_pd,
        }
        figures = errors_on_log(prior, log_of_leg, models)
        del figures["whole"]  # per_motor was fitted to the start
        return figures

    return stage(settings, folder, [*paths, test, *robot.files], compute)


def stage(
    settings: Settings, folder: Path, inputs: Sequence[Path], compute: Callable[[], Figures]
) -> Figures:
    """Figures that depend on these files and on some settings.

    They are computed if ``folder`` does not have them.
    """
    names = ("seconds", "adam_steps", "baselines", "seed")
    used_settings = {name: getattr(settings, name) for name in names}
    stage_description = description("validate", used_settings, inputs)
    if not is_finished(folder, stage_description):
        with working(folder, stage_description):
            write_json(folder / FIGURES, compute())
    return read_json(folder / FIGURES)


def spread_windows(logs: Sequence[mp.MotorLog], seconds: float) -> mp.MotorLog:
    """A window of each log, ``seconds`` in all.

    They go from the beginning of the first log to the end of the last.
    """
    return joined([window(log, seconds, index, len(logs)) for index, log in enumerate(logs)])


# Errors.


def errors_on_log(
    prior: mp.MotorPrior, log: mp.MotorLog, models: Mapping[str, MotorModel] | None = None
) -> Figures:
    """Errors of the prior and of other models on a log.

    The errors of ``adapted``, and the coverages, are those after the log's start.
    """
    recipe = recipe_of(prior)
    start, rest = start_and_rest(log)
    posterior = adapt_to(prior, start)
    all_models = dict(models or {})
    all_models["prior"] = prior.model.motors(prior.predicted(log).mean)
    with_adapted = all_models | {"adapted": prior.model.motors(posterior.mean)}

    runs = whole_runs(rest, recipe)
    return {
        "whole": _mean_errors(whole_runs(log, recipe), all_models),
        "rest": _mean_errors(runs, with_adapted),
        "coverage": _coverage(prior, posterior, runs),
        "unseen": _coverage(prior, zero_shot(prior, rest), runs),
    }


def start_and_rest(log: mp.MotorLog) -> tuple[mp.MotorLog, mp.MotorLog]:
    """The first ADAPTATION_SECONDS of a log, at most half of it, and the rest."""
    return first_and_rest(log, min(ADAPTATION_SECONDS, log.duration / 2))


def _mean_errors(runs: Sequence[WindowRuns], models: Mapping[str, MotorModel]) -> dict[str, float]:
    """Mean errors over joints [rad]."""
    errors = free_run_errors(runs, models)
    return {model: float(np.mean(values)) for model, values in errors.items()}


def _coverage(
    prior: mp.MotorPrior, posterior: LatentPosterior, runs: Sequence[WindowRuns]
) -> dict[str, float]:
    """Fraction of recorded angles inside the bands, by level [%]."""
    shares = log_coverage(prior, posterior, runs)
    return {str(level): share for level, share in shares.items()}


def _means(figures: Sequence[Figures]) -> Figures:
    """Means over logs or folds."""
    means: Figures = {}
    for span, values in figures[0].items():
        means[span] = {}
        for name in values:
            means[span][name] = float(np.mean([single[span][name] for single in figures]))
    return means


def as_figures(robot: str, test: str, folds: Sequence[Figures]) -> dict[str, float]:
    """Means over all folds of a robot, by their keys in figures.json."""
    means = _means(folds)
    figures = {}
    errors = means["rest"] | means.get("whole", {})  # adapted has no whole log
    for model, error in errors.items():
        figures[f"{robot}/{test}/{model}"] = error
    figures[f"{robot}/{test}/rest/prior"] = means["rest"]["prior"]  # over the rows of adapted

    has_own_coverage = robot == "ak80" or test in (UNSEEN_GAINS, UNSEEN_LEG, *REGIMES)
    prefix = f"{robot}/{test}" if has_own_coverage else robot
    for level, share in means["coverage"].items():
        figures[f"{prefix}/coverage{level}"] = share
    for level, share in means["unseen"].items():
        figures[f"{prefix}/unseen/coverage{level}"] = share
    return figures


# Files.


def robot_file(settings: Settings, name: str) -> Path:
    """Copy of the example robot file, next to a copy of its model, in the run folder.

    The name of a shipped robot, which has no example file.
    """
    if not (EXAMPLES / f"{name}.toml").is_file():
        return Path(name)
    folder = settings.out / name / "robot"
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copy(settings.data / "robots" / f"{name}.xml", folder)
    return Path(shutil.copy(EXAMPLES / f"{name}.toml", folder))


def imported(
    settings: Settings, name: str, is_wanted: Callable[[Path], bool] | None = None
) -> list[Path]:
    """Motor logs with loads, from the robot's rigid-body model if it has one.

    They are imported if they do not exist. ``is_wanted`` selects raw logs; all if not given.
    """
    columns, pattern = LOGS[name]
    raw_paths = sorted((settings.data / name).glob(pattern))
    if is_wanted is not None:
        raw_paths = [raw for raw in raw_paths if is_wanted(raw)]
    raw_paths = raw_paths[: settings.logs]
    robot = None
    robot_files: Sequence[Path] = ()
    if name != "xl330":  # its logs have the pendulum
        robot = str(robot_file(settings, name))
        robot_files = mp.load_robot(robot).files

    folder = settings.out / name / "logs"
    paths = [folder / f"{raw.name.split('.')[0]}.parquet" for raw in raw_paths]
    import_description = description("import", {"columns": columns}, [*raw_paths, *robot_files])
    if not is_finished(folder, import_description):
        with working(folder, import_description):
            for raw, path in zip(raw_paths, paths, strict=True):
                import_log(raw, path, columns, robot)
    return paths


if __name__ == "__main__":
    run_benchmark(Settings, measure_robots, __doc__)
