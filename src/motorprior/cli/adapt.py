"""``motorprior adapt``: the posterior of z for the motors of a log."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from motorprior.cli.console import TERMINAL, table
from motorprior.logs.motor_log import MotorLog
from motorprior.pipeline.adapt import Adapt, OutlierTest, run_adapt

if TYPE_CHECKING:  # it imports JAX
    from motorprior.identification.latent_fit import Posterior


@dataclass(frozen=True)
class AdaptCommand(Adapt):
    """Find where in the prior's latent space the motors of a log are."""

    prior: tyro.conf.Positional[Path]
    log: tyro.conf.Positional[Path]


def adapt(config: AdaptCommand) -> None:
    """See `run_adapt`."""
    run_adapt(config, TERMINAL, _show)


def _show(log: MotorLog, found: Posterior, outliers: OutlierTest) -> None:
    rows = [
        [name, f"{loss:.3f}", f"{p_value:.3f}", " ".join(f"{value:+.2f}" for value in mean)]
        for name, loss, p_value, mean in zip(log.joint_names, found.loss, outliers.p_value, found.mean, strict=True)
    ]
    table("Posterior of z", ["motor", "loss", "p-value", "mean"], rows)
