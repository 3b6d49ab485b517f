"""``motorprior identify``: motor logs in, motor prior out."""

from __future__ import annotations

import os
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import tyro

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import write_text
from motorprior.cli.bench import FACTS, LOG, read_bench
from motorprior.cli.bounds import require_at_least, require_seed
from motorprior.cli.console import bar
from motorprior.cli.stage import begin, description, finish, is_finished

PRIOR = "prior.safetensors"


@dataclass(frozen=True)
class Identify:
    """Learn a motor prior from the log of a bench."""

    bench: tyro.conf.Positional[Path]
    """Folder that `motorprior bench` wrote."""
    out: Path
    """Folder for prior.safetensors."""
    preset: str = "rollout"
    """Recipe: rollout (closed loop), paper (torque regression), one_network (no latent)."""
    seed: int = 0
    """Seed of weights, windows and noise."""
    steps: int | None = None
    """Adam steps; the preset's own number if not given."""


def run_identify(config: Identify) -> None:
    """Train, unless the folder holds this very prior already.

    Raises:
        LogError, ConfigError: the log does not fit the recipe.
    """
    require_at_least(1, steps=config.steps)
    require_seed(config.seed)
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    from motorprior.identification.presets import identification_preset
    from motorprior.identification.reference import reference_metrics
    from motorprior.identification.train import CHUNK, identify
    from motorprior.identification.windows import training_data

    preset = identification_preset(config.preset)
    if config.steps is not None:
        preset = replace(preset, steps=config.steps)
    log, facts = read_bench(config.bench)
    inputs = [config.bench / LOG, config.bench / FACTS]
    wanted = description("identify", asdict(config), inputs, recipe=asdict(preset))
    if is_finished(config.out, wanted):
        return
    data = training_data(log, preset, str(config.bench / LOG))
    begin(config.out)
    started = time.monotonic()
    with bar(f"identify {config.preset}: {preset.steps} Adam steps", preset.steps) as progress:

        def report(done: int, total: int, loss: float) -> None:  # the last chunk may be a short one
            progress.advance(done % CHUNK or CHUNK, f"loss {loss:.4f}")

        found = identify(data, preset, config.seed, report)
    seconds = time.monotonic() - started
    metrics = {"final_loss": float(found.losses[-1]), "minutes_of_log": log.duration / 60 * log.num_joints}
    metrics |= reference_metrics(found.network, data, preset, found.mean, log)
    provenance = {"bench": facts.as_json(), "recipe": asdict(preset), "seed": config.seed}
    prior = MotorPrior(
        found.network, found.mean, found.log_var, config.preset, facts.fleet.robot, facts.fleet.motor,
        provenance, metrics,
    )  # fmt: skip
    prior.save(config.out / PRIOR)
    write_text(config.out / "seconds.txt", f"{seconds:.1f}\n")
    finish(config.out, wanted)
