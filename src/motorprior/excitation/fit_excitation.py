"""Learn an excitation from runs of a robot: their windows by joint class, and a generator."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import read_tensors
from motorprior.bounds import one_of, require_argument, require_count, require_number, require_seed
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.excitation.bounded_stream import Bounds
from motorprior.excitation.frames import SUB
from motorprior.excitation.learned_excitation import METHODS, LearnedExcitation
from motorprior.excitation.run_windows import MARGINS, windows_of
from motorprior.logs.motor_log import MotorLog, motor_logs
from motorprior.progress import PYTHON_WARNINGS, Progress

STEPS = 5000  # training steps


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
    progress: Progress = PYTHON_WARNINGS,
) -> LearnedExcitation:
    """Learn position targets and external torques of joints, by joint class, from what a robot did.

    Args:
        runs: logs of any motion; logs with load_inertia and external_torque also give the loads of
            a bench.
        method: generated trains a generative adversarial network, surrogate samples Gaussian
            processes with the runs' spectrum and marginals, recorded plays windows of the runs.
        period: control period of the robot [s].
        commands: commanded speed of each run [m/s]; unknown if not given.
        max_speed: bound of the targets' speed [rad/s], at most 1.25 times the runs'; faster targets
            are scaled down.
        max_torque: bound of external torques [N·m], at most 1.25 times the runs'; larger torques
            are scaled down.
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
    require_argument("method", method, one_of(*METHODS))
    require_number("max_speed", max_speed, positive=True, maximum=inf)
    require_number("max_torque", max_torque, positive=True, maximum=inf)
    require_count("steps", steps)
    require_seed(seed)

    finished = None if out is None else _finished_excitation(Path(out))
    excitation = windows_of(logs, period, commands)
    trained = {**excitation.provenance, "steps": steps, "seed": seed}
    if finished is not None and _has_generator_of(finished, excitation):
        excitation = replace(excitation, weights=finished.weights, provenance=finished.provenance)
    if method == "generated":
        excitation = _with_generator(excitation, trained, out, progress)
    excitation = _scaled_down(replace(excitation, method=method), max_speed, max_torque)

    if out is not None:
        excitation.save(Path(out))
        if method == "generated":
            _checkpoint(out).unlink(missing_ok=True)
    return excitation


def _finished_excitation(out: Path) -> LearnedExcitation | None:
    """The excitation in a file; None if there is none or it is damaged.

    Raises ConfigError for another kind of artifact.
    """
    with suppress(ArtifactError):
        artifact_name = read_tensors(out)[1].get("kind")
        if artifact_name != "excitation":
            raise ConfigError(
                f"{out} is a {artifact_name}, not an excitation",
                remedy="give another file",
                argument="out",
            )
        return LearnedExcitation.load(out)
    return None


def _has_generator_of(finished: LearnedExcitation, excitation: LearnedExcitation) -> bool:
    """Whether the finished excitation has a generator that was trained on the same runs."""
    same_runs = excitation.provenance.items() <= finished.provenance.items()
    return bool(finished.weights) and same_runs


def _with_generator(
    excitation: LearnedExcitation,
    trained: Mapping[str, Any],
    out: Path | str | None,
    progress: Progress,
) -> LearnedExcitation:
    """The excitation with a generator of the provenance ``trained``; its own one if that is it."""
    if excitation.provenance == trained:
        progress.note(f"{out} exists already, from the same runs and settings")
        return excitation

    from motorprior.excitation.train_generator import train_generator  # here: it imports JAX

    steps = trained["steps"]
    title = f"train a generator, {len(excitation.windows)} windows"
    checkpoint = None if out is None else _checkpoint(out)
    with progress.start(title, steps) as task:
        weights = train_generator(
            excitation, steps, trained["seed"], checkpoint, trained, task.advance
        )
    return replace(excitation, weights=weights, provenance=trained)


def _checkpoint(out: Path | str) -> Path:
    return Path(out).with_suffix(".checkpoint")


def _scaled_down(
    excitation: LearnedExcitation, max_speed: float, max_torque: float
) -> LearnedExcitation:
    """The excitation within two bounds.

    Targets are scaled down in classes of faster runs, torques in classes of larger ones: clipping
    would distort them.
    """
    largest = excitation.bounds / MARGINS
    factors = np.minimum(1.0, np.array([max_speed, max_torque]) / largest[:, [1, 3]])
    factors_of_bounds = factors[:, [0, 0, 0, 1]]
    factors_of_channels = factors[:, [0] + SUB * [1]]
    return replace(
        excitation,
        windows=excitation.windows * factors_of_channels[excitation.window_class][:, None],
        scales=excitation.scales * factors_of_channels,
        bounds=np.minimum(
            excitation.bounds * factors_of_bounds, Bounds(inf, max_speed, inf, max_torque)
        ),
    )
