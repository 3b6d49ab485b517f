"""``motorprior validate-log``: a prior against a log that nothing was fitted to."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from motorprior.cli.console import TERMINAL, table
from motorprior.pipeline.validate_log import ValidateLog, run_validate_log


@dataclass(frozen=True)
class ValidateLogCommand(ValidateLog):
    """Measure how far a prior's motors are from a held-out log: its first half tells of them, the second is judged."""

    prior: tyro.conf.Positional[Path]
    log: tyro.conf.Positional[Path]


def validate_log(config: ValidateLogCommand) -> None:
    """See `run_validate_log`."""
    results = run_validate_log(config, TERMINAL)
    errors = results.where(quantity="free_run_rmse")
    rows = [
        [model, *(f"{1e3 * errors.value(model=model, statistic=statistic):.1f}" for statistic in ("median", "mean"))]
        for model in errors.distinct("model")
    ]
    table("Free runs of 1 s, joint RMSE [mrad], over motors", ["model", "median", "mean"], rows)
    shares = (results.where(quantity=f"coverage{level}").value() for level in (50, 90))
    table(
        "Recorded angles inside the bands [%]", ["50 % band", "90 % band"], [[f"{100 * share:.0f}" for share in shares]]
    )
