"""Learn an excitation from runs of a robot: their windows by joint class, and a generator of more of them."""

import hashlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from math import inf
from pathlib import Path

import numpy as np

from motorprior.artifacts import read_tensors
from motorprior.bench.bounded_stream import Bounds
from motorprior.bench.learned_excitation import (
    CHANNELS,
    MAKERS,
    MIN_SCALE,
    SUB,
    UNKNOWN_LOAD,
    LearnedExcitation,
)
from motorprior.bounds import one_of, require_argument, require_count, require_number, require_seed
from motorprior.exceptions import ArtifactError, ConfigError, LogError
from motorprior.logs.motor_log import MotorLog, motion_digest, motor_logs
from motorprior.logs.operations import EXCITED_STD, resample
from motorprior.progress import WARNED, Progress
from motorprior.robots.joint_classes import classes_by_name

STEPS = 5000  # training steps
SECONDS = 1.28  # duration of a window [s]: two to four steps of a leg
# [s]: with a longer one, a window has too few frames for the generator's critic
MAX_CONTROL_PERIOD = 0.04
OVERLAP = 4  # windows that contain a row
MAX_WINDOWS = 400  # maximum number per class in the file
# bounds over the largest values in the runs, of amplitude, speed, acceleration and torque: below
# these, streams of recorded windows are not distorted (`bounded_stream` divides the acceleration
# between its two stages)
MARGINS = (1.25, 1.25, 3.0, 1.25)
# threshold of the estimator of gait frequency, and largest period [s]
YIN = 0.1
MAX_PERIOD = 2.0
_FLOORS = (1e-2, 1e-1, 1.0, 1e-3)  # minimum bounds: a joint without external torque has almost none


def fit_excitation(
    runs: MotorLog | Sequence[MotorLog],
    method: str = "generated",
    *,
    period: float = 0.01,
    commands: Sequence[float] = (),
    max_speed: float = inf,
    max_torque: float = inf,
    steps: int = STEPS,
    seed: int = 0,
    out: Path | str | None = None,
    progress: Progress = WARNED,
) -> LearnedExcitation:
    """Learn position targets and external torques of joints, by joint class, from what a robot did.

    Args:
        runs: logs of any motion; those with load_inertia and external_torque also give the loads of
            a bench.
        method: generated trains a generative adversarial network, surrogate samples Gaussian
            processes with the runs' spectrum and marginals, recorded plays windows of the runs.
        period: control period of the robot [s].
        commands: commanded speed of each run [m/s]; unknown if not given.
        max_speed: bound of the targets' speed [rad/s], at most 1.25 times the runs'; faster targets
            are scaled down.
        max_torque: bound of external torques [N·m], likewise.
        steps: training steps of the network.
        seed: of the training, which is deterministic.
        out: .safetensors file to write; training continues from the .checkpoint next to it. The
            generator of a finished file of the same runs and settings is used again, and stays in
            the file with other methods.
        progress: where to report to.

    Raises:
        ConfigError: a number out of range, or commands that are not one per run; ``out`` is another
            kind of artifact.
        LogError: no run is long enough, or none moves.
    """
    logs = motor_logs(runs)
    require_argument("method", method, one_of(*MAKERS))
    require_number("max_speed", max_speed, positive=True, maximum=inf)
    require_number("max_torque", max_torque, positive=True, maximum=inf)
    require_count("steps", steps)
    require_seed(seed)
    earlier = None if out is None else _earlier(Path(out))
    found = windows_of(logs, period, commands)
    trained = {**found.provenance, "steps": steps, "seed": seed}
    if (
        earlier is not None
        and earlier.weights
        and found.provenance.items() <= earlier.provenance.items()
    ):
        found = replace(found, weights=earlier.weights, provenance=earlier.provenance)
    checkpoint = None if out is None else Path(out).with_suffix(".checkpoint")
    if method == "generated" and found.provenance == trained:
        progress.note(f"{out} exists already, from the same runs and settings")
    elif method == "generated":
        # here: it imports JAX
        from motorprior.identification.networks.adversarial import train_generator

        with progress.start(f"train a generator, {len(found.windows)} windows", steps) as task:
            weights = train_generator(found, steps, seed, checkpoint, trained, task.advance)
        found = replace(found, weights=weights, provenance=trained)
    found = _within(replace(found, method=method), max_speed, max_torque)
    if out is not None:
        found.save(Path(out))
    if checkpoint is not None and method == "generated":
        checkpoint.unlink(missing_ok=True)
    return found


def _earlier(out: Path) -> LearnedExcitation | None:
    """The excitation in a file; None if there is none or it is damaged. ConfigError for another kind of artifact."""
    with suppress(ArtifactError):
        kind = read_tensors(out)[1].get("kind")
        if kind != "excitation":
            raise ConfigError(f"{out} is a {kind}", remedy="give another file", argument="out")
        return LearnedExcitation.load(out)
    return None


def windows_of(
    logs: Sequence[MotorLog], period: float, commands: Sequence[float] = ()
) -> LearnedExcitation:
    """The windows of runs with a control period of ``period`` [s] and commanded speeds [m/s], played by themselves.

    Windows with a static target are left out. Raises ConfigError and LogError as `fit_excitation`.
    """
    require_number("period", period, 1e-4, MAX_CONTROL_PERIOD)
    if not logs or len(commands) not in (0, len(logs)):
        problem = f"{len(commands)} commands for {len(logs)} runs"
        remedy = "give runs, and one command per run or none"
        raise ConfigError(problem, remedy=remedy, argument="commands")
    for command in commands:
        require_number("commands", command, minimum=-10.0, maximum=10.0)
    frames = round(SECONDS / period)
    # class -> window, target around it, command, load inertia (0: unknown)
    by_class: dict[str, list[tuple[np.ndarray, np.ndarray, float, float]]] = {}
    for log, command in zip(logs, commands or [0.0] * len(logs), strict=True):
        names = classes_by_name(log.joint_names)  # places on the robot, whatever the motors
        for segment in (each for each in log.segments() if each.duration > SECONDS):
            grid = resample(segment, period / SUB)
            for joint, kind in enumerate(names if any(names) else log.joint_names):
                whole = _frames(grid, joint)
                load = (
                    0.0
                    if grid.load_inertia is None
                    else float(np.median(grid.load_inertia[:, joint]))
                )
                for first in range(0, len(whole) - frames + 1, frames // OVERLAP):
                    window = whole[first : first + frames]
                    around = whole[max(0, first - frames) : first + 2 * frames, 0]
                    if window[:, 0].std() > EXCITED_STD:
                        by_class.setdefault(kind, []).append((window, around, command, load))
    if not by_class:
        remedy = "record longer runs, or runs that move"
        raise LogError(
            f"no window of {SECONDS:g} s with a moving joint", where=logs[0].source, remedy=remedy
        )
    loads = [
        [each[3] for each in own if each[3] > 0.0] or [UNKNOWN_LOAD] for own in by_class.values()
    ]
    places = [
        np.unique(np.linspace(0, len(own) - 1, MAX_WINDOWS).astype(int))
        for own in by_class.values()
    ]
    kept = [
        [own[place] for place in chosen]
        for own, chosen in zip(by_class.values(), places, strict=True)
    ]
    windows = [np.stack([each[0] for each in own]) for own in kept]
    every = np.concatenate(windows)
    trained_on = [
        {"source": x.source, "robot": x.robot, "seconds": x.duration, "motion": motion_digest(x)}
        for x in logs
    ]
    return LearnedExcitation(
        "recorded",
        tuple(by_class),
        period,
        every,
        window_class=np.repeat(np.arange(len(kept)), [len(own) for own in kept]),
        commands=np.array([each[2] for own in kept for each in own], float),
        frequency=np.array([gait_frequency(each[1], period) for own in kept for each in own]),
        scales=np.array([np.maximum(own.std(axis=(0, 1)), MIN_SCALE) for own in windows]),
        bounds=np.array([_bounds(own, period) for own in windows]),
        load_inertia=np.array([(min(own), max(own)) for own in loads]),
        provenance={
            "trained_on": trained_on,
            "commands": list(commands),
            "period": period,
            "windows_sha256": hashlib.sha256(every.tobytes()).hexdigest(),
        },
    )


def _frames(grid: MotorLog, joint: int) -> np.ndarray:
    """(frames, CHANNELS) of a joint of one segment on the grid of external torques."""
    count = grid.num_rows // SUB
    target = grid.position_target[: count * SUB, joint].reshape(count, SUB).mean(axis=1)
    external = (
        np.zeros_like(grid.position_target)
        if grid.external_torque is None
        else grid.external_torque
    )
    torque = external[: count * SUB, joint].reshape(count, SUB)
    return np.column_stack([target - target.mean(), torque])


def _bounds(windows: np.ndarray, period: float) -> Bounds:
    target = windows[..., 0]
    found = (
        np.abs(target).max(),
        np.abs(np.diff(target)).max() / period,
        np.abs(np.diff(target, n=2)).max() / period**2,
        np.abs(windows[..., -(CHANNELS - 1) :]).max(),
    )
    return Bounds(*np.maximum(np.array(MARGINS) * found, _FLOORS))


def _within(found: LearnedExcitation, max_speed: float, max_torque: float) -> LearnedExcitation:
    """Targets scaled down in classes of faster runs, torques in those of larger ones: clipping would distort them."""
    largest = found.bounds / MARGINS
    factors = np.minimum(1.0, np.array([max_speed, max_torque]) / largest[:, [1, 3]])
    of_bounds = factors[:, [0, 0, 0, 1]]
    of_channels = factors[:, [0] + SUB * [1]]
    return replace(
        found,
        windows=found.windows * of_channels[found.window_class][:, None],
        scales=found.scales * of_channels,
        bounds=np.minimum(found.bounds * of_bounds, Bounds(inf, max_speed, inf, max_torque)),
    )


def gait_frequency(target: np.ndarray, period: float) -> float:
    """Gait frequency of a target (frames,) [Hz]: that of the YIN estimator (de Cheveigné & Kawahara, 2002)."""
    lags = np.arange(1, min(len(target) // 2, round(MAX_PERIOD / period)))
    apart = np.array([np.mean((target[lag:] - target[:-lag]) ** 2) for lag in lags])
    apart *= lags / np.maximum(np.cumsum(apart), 1e-12)
    valleys = 1 + np.flatnonzero((apart[1:-1] <= apart[:-2]) & (apart[1:-1] < apart[2:]))
    deep = valleys[apart[valleys] <= max(YIN, 1.5 * apart[valleys].min(initial=np.inf))]
    # the longest lag for a motion that is not periodic
    best = deep[0] if len(deep) else len(lags) - 1
    low, middle, high = apart[np.clip([best - 1, best, best + 1], 0, len(apart) - 1)]
    vertex = 0.5 * (low - high) / max(low - 2.0 * middle + high, 1e-12)
    return 1.0 / (period * (lags[best] + float(np.clip(vertex, -0.5, 0.5))))
