"""``motorprior validate-log``: a prior and baselines against a log that nothing was fitted to."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from motorprior.cli.console import TERMINAL, table
from motorprior.pipeline.validation.validate_log import (
    ADAPTED,
    COVERAGE,
    PRIOR,
    SPANS,
    TRAINED_ON,
    ValidateLog,
    run_validate_log,
)
from motorprior.results import Results


@dataclass(frozen=True)
class ValidateLogCommand(ValidateLog):
    """Measure how far a prior's motors and baselines are from a held-out log, command in and motion out."""

    prior: tyro.conf.Positional[Path]
    log: tyro.conf.Positional[Path]


def validate_log(config: ValidateLogCommand) -> None:
    """See `run_validate_log`."""
    results = run_validate_log(config, TERMINAL)
    errors = results.where(quantity=tuple(SPANS), part=None)
    columns = [(quantity, statistic) for quantity in SPANS for statistic in ("median", "mean")]
    rows = [[model, *(_milli(errors, model, *column) for column in columns)] for model in errors.distinct("model")]
    titles = [f"{SPANS[quantity]}, {statistic}" for quantity, statistic in columns]
    known = results.where(quantity=TRAINED_ON).value() > 0.0
    said = " (warning: no test, the prior was trained on this log)" if known else ""
    table(f"Free runs, joint RMSE [mrad], over motors{said}", ["model", *titles], rows)
    shares = [
        [model, span, *(_percent(results, f"{COVERAGE[quantity]}{level}", model) for level in (50, 90))]
        for model in (ADAPTED, PRIOR)
        for quantity, span in SPANS.items()
    ]
    table(f"Recorded angles inside the bands [%]{said}", ["model", "free runs", "50 % band", "90 % band"], shares)


def _percent(results: Results, quantity: str, model: str) -> str:
    return f"{100 * results.where(quantity=quantity).value(model=model):.0f}"


def _milli(errors: Results, model: str, quantity: str, statistic: str) -> str:
    return f"{1e3 * errors.value(model=model, quantity=quantity, statistic=statistic):.1f}"
