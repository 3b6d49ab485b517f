"""Learn an excitation from logs of a robot: windows of the logs by joint class, and a generator."""

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
from motorprior.excitation.frames import TORQUES_PER_FRAME
from motorprior.excitation.learned_excitation import METHODS, LearnedExcitation
from motorprior.excitation.run_windows import BOUND_FACTORS, windows_of
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
        max_speed: bound of the targets' speed [rad/s]. Faster targets are scaled down. The speed is
            in any case at most 1.25 times the largest speed in the runs.
        max_torque: bound of the external torques [N·m]. Larger torques are scaled down. A torque is
            in any case at most 1.25 times the largest torque in the runs.
        steps: training steps of the network.
        seed: of the training, which is deterministic.
        out: .safetensors file to write; training continues from the .checkpoint next to it. The
            generator of a finished file of the same runs and settings is used again. Another method
            keeps the generator in the file.
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
    training_provenance = {**excitation.provenance, "steps": steps, "seed": seed}
    if finished is not None and _has_generator_of(finished, excitation):
        excitation = replace(excitation, weights=finished.weights, provenance=finished.provenance)
    if method == "generated":
        excitation = _with_generator(excitation, training_provenance, out, progress)
    excitation = replace(excitation, method=method)
    excitation = _scaled_down(excitation, max_speed, max_torque)

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
        _, header = read_tensors(out)
        artifact_type = header.get("kind")
        if artifact_type != "excitation":
            raise ConfigError(
                f"{out} is a {artifact_type}, not an excitation",
                remedy="give another file",
                argument="out",
            )
        return LearnedExcitation.load(out)
    return None


def _has_generator_of(finished: LearnedExcitation, excitation: LearnedExcitation) -> bool:
    """Whether the finished excitation has a generator that was trained on the same runs."""
    # the provenance of a generator has more entries: the settings of its training
    has_same_runs = excitation.provenance.items() <= finished.provenance.items()
    return bool(finished.weights) and has_same_runs


def _with_generator(
    excitation: LearnedExcitation,
    provenance: Mapping[str, Any],
    out: Path | str | None,
    progress: Progress,
) -> LearnedExcitation:
    """The excitation with a generator that has this ``provenance``.

    A generator is trained unless the excitation already has it.
    """
    if excitation.provenance == provenance:
        progress.note(f"{out} exists already, from the same runs and settings")
        return excitation

    from motorprior.excitation.train_generator import train_generator  # here: it imports JAX

    steps = provenance["steps"]
    seed = provenance["seed"]
    title = f"train a generator, {len(excitation.windows)} windows"
    checkpoint = None if out is None else _checkpoint(out)
    with progress.start(title, steps) as task:
        weights = train_generator(excitation, steps, seed, checkpoint, provenance, task.advance)
    return replace(excitation, weights=weights, provenance=provenance)


def _checkpoint(out: Path | str) -> Path:
    return Path(out).with_suffix(".checkpoint")


def _scaled_down(
    excitation: LearnedExcitation, max_speed: float, max_torque: float
) -> LearnedExcitation:
    """The excitation with speeds and torques within these bounds.

    The targets of a joint class are scaled down if its largest speed exceeds the bound, and its
    torques are scaled down if its largest torque does. Clipping would distort them.
    """
    # (C,) factors of each class on targets and on torques
    _, max_speeds, _, max_torques = (excitation.bounds / BOUND_FACTORS).T
    target_factor = np.minimum(1.0, max_speed / max_speeds)
    torque_factor = np.minimum(1.0, max_torque / max_torques)

    # (C, 1 + TORQUES_PER_FRAME) factors of the channels, (C, 4) factors of the bounds
    torque_factors = [torque_factor] * TORQUES_PER_FRAME
    channel_factors = np.stack([target_factor, *torque_factors], axis=1)
    bound_factors = Bounds(target_factor, target_factor, target_factor, torque_factor)

    scaled_bounds = excitation.bounds * np.stack(bound_factors, axis=1)
    window_factors = channel_factors[excitation.window_class]
    return replace(
        excitation,
        windows=excitation.windows * window_factors[:, None],
        scales=excitation.scales * channel_factors,
        bounds=np.minimum(scaled_bounds, Bounds(inf, max_speed, inf, max_torque)),
    )
