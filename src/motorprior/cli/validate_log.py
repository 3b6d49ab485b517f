"""``motorprior validate-log``: errors of a prior and of baselines on held-out rows of a log."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from motorprior.cli.console import TERMINAL, table
from motorprior.commands.validate_log import (
    ADAPTED,
    COVERAGE,
    PRIOR,
    SPANS,
    TRAINED_ON,
    ValidateLog,
    run_validate_log,
)
from motorprior.identification.evaluation.log_tables import error_table


@dataclass(frozen=True)
class ValidateLogCommand(ValidateLog):
    """Measure the errors of a prior's motors and of baselines in free runs on a held-out log."""

    prior: tyro.conf.Positional[Path]
    log: tyro.conf.Positional[Path]


def validate_log(config: ValidateLogCommand) -> None:
    """See `run_validate_log`."""
    results = run_validate_log(config, TERMINAL)
    trained = results.where(quantity=TRAINED_ON).value() > 0.0
    warning = " (warning: not a test, the prior was trained on this log)" if trained else ""
    table(f"Free runs, joint RMSE [mrad], over joints{warning}", *error_table(results, SPANS))
    shares = []
    for model in (ADAPTED, PRIOR):
        for quantity, span in SPANS.items():
            values = [results.value(quantity=f"{COVERAGE[quantity]}{level}", model=model) for level in (50, 90)]
            shares.append([model, span, *(f"{100 * value:.0f}" for value in values)])
    table(f"Recorded angles inside the bands [%]{warning}", ["model", "free runs", "50 % band", "90 % band"], shares)
