"""``motorprior adapt``: the posterior of z for the motors of a log."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import tyro

from motorprior.actuator.geared_motor_constants import PER_LOGGED
from motorprior.cli.console import TERMINAL, table
from motorprior.commands.adapt import Adapt, run_adapt
from motorprior.identification.adapt import OutlierTest
from motorprior.identification.evaluation.log_tables import constant_table
from motorprior.logs.motor_log import MotorLog

if TYPE_CHECKING:  # it imports JAX
    from motorprior.identification.latents.latent_fit import Posterior


@dataclass(frozen=True)
class AdaptCommand(Adapt):
    """Find the motors of a log in the prior's latent space."""

    prior: tyro.conf.Positional[Path]
    log: tyro.conf.Positional[Path]


def adapt(config: AdaptCommand) -> None:
    """See `run_adapt`."""
    run_adapt(config, TERMINAL, _show)


def _show(log: MotorLog, found: Posterior, outliers: OutlierTest, constants: dict[str, np.ndarray]) -> None:
    rows = zip(log.joint_names, found.loss, outliers.p_value, outliers.reason, strict=True)
    table(
        "Motors", ["motor", "loss", "p-value", "largest deviation"],
        [[name, f"{loss:.3f}", f"{p_value:.3f}", reason] for name, loss, p_value, reason in rows],
    )  # fmt: skip
    if constants:
        units = "SI units"
        if any(name.endswith(PER_LOGGED) for name in constants):
            units += f"; …{PER_LOGGED}: per unit of the firmware's gain in the log"
        table(f"Constants of these motors [{units}]", *constant_table(constants))
