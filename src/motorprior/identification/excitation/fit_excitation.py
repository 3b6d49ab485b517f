"""Learn an excitation from runs of a robot."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from time import monotonic

from motorprior.bench.learned_excitation import LearnedExcitation
from motorprior.bench.stream_makers import MAKERS
from motorprior.bounds import one_of, require_argument, require_count, require_number, require_seed
from motorprior.exceptions import ConfigError
from motorprior.identification.excitation.windows import windows_of
from motorprior.logs.motor_log import MotorLog, motion_digest
from motorprior.progress import WARNED, Progress

STEPS = 2000  # of the training


def fit_excitation(
    runs: MotorLog | Sequence[MotorLog],
    play: str = "generated",
    *,
    period: float = 0.01,
    commands: Sequence[float] = (),
    steps: int = STEPS,
    seed: int = 0,
    out: Path | str | None = None,
    progress: Progress = WARNED,
) -> LearnedExcitation:
    """Learn position targets and external torques of joints, by joint class, from what a robot did.

    Args:
        runs: logs of any motion; those with load_inertia and external_torque also give the loads of a bench.
        play: generated trains a generative adversarial network, surrogate draws Gaussian processes with the runs'
            spectrum and marginals, recorded plays windows of the runs.
        period: control period of the robot [s].
        commands: commanded speed of each run [m/s]; unknown if not given.
        steps: training steps of the network.
        seed: of the training; same arguments, same bytes.
        out: .safetensors file to write; an interrupted training continues from the file next to it.
        progress: where to report to.

    Raises:
        ConfigError: a number out of range, or commands that are not one per run.
        LogError: no run is long enough, or none moves.
    """
    logs = [runs] if isinstance(runs, MotorLog) else list(runs)
    require_argument("play", play, one_of(*MAKERS))
    require_number("period", period, 1e-4, 1.0)
    require_count("steps", steps)
    require_seed(seed)
    if not logs or len(commands) not in (0, len(logs)):
        problem, remedy = f"{len(commands)} commands for {len(logs)} runs", "give runs, and one command per run or none"
        raise ConfigError(problem, remedy=remedy, argument="commands")
    found = windows_of(logs, period, commands)
    trained_on = [
        {"source": log.source, "robot": log.robot, "seconds": log.duration, "motion": motion_digest(log)}
        for log in logs
    ]
    origin = {"trained_on": trained_on, "commands": list(commands), "period": period}
    if play == "generated":
        os.environ.setdefault("JAX_PLATFORMS", "cpu")
        from motorprior.identification.excitation.adversarial import train_generator  # here: it imports JAX

        origin |= {"steps": steps, "seed": seed}
        started, checkpoint = monotonic(), None if out is None else Path(out).with_suffix(".checkpoint")
        with progress.start(f"train a generator, {len(found.windows)} windows", steps) as task:
            weights = train_generator(found, steps, seed, checkpoint, origin, task.advance)
        progress.note(f"trained in {monotonic() - started:.1f} s")
        found = replace(found, weights=weights)
    found = replace(found.playing(play), provenance=origin)
    if out is not None:
        found.save(Path(out))
        if play == "generated":
            Path(out).with_suffix(".checkpoint").unlink(missing_ok=True)
    return found
