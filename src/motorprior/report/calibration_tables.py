"""Rows of the tables of a calibration."""

from __future__ import annotations

from motorprior.results import Results

_TITLES = {
    "start": "starting fleet", "center": "fitted", "left_out": "without this log",
    "per_motor": "a motor per joint", "per_motor_left_out": "without this log",
}  # fmt: skip
_BANDS = {
    ("calibrate_coverage90", None): "in 90 % bands",
    ("calibrate_coverage90", "prior"): "in the prior's 90 %",
    ("calibrate_coverage50", "prior"): "in its 50 %",
}


def calibration_errors(results: Results) -> tuple[list[str], list[list[str]]]:
    """Columns and rows: joint RMSE [mrad] of every log and their mean, and the share within 90 % bands.

    Of the fleet and, if a prior was drawn, of its 90 and 50 % bands.
    """
    errors = results.where(quantity="calibrate_rmse")
    models = [model for model in _TITLES if model in errors.distinct("model")]
    bands = {key: title for key, title in _BANDS.items() if results.where(quantity=key[0], model=key[1])}
    rows = []
    for log in errors.distinct("log"):
        values = [errors.value(model=model, log=log) for model in models]
        shares = [_share(results.where(quantity=quantity, model=model), log) for quantity, model in bands]
        rows.append([log or "mean", *(f"{1e3 * value:.1f}" for value in values), *shares])
    return ["log", *(_TITLES[model] for model in models), *bands.values()], rows


def _share(covered: Results, log: str | None) -> str:
    return f"{100 * (covered.mean() if log is None else covered.value(log=log)):.0f} %"


def calibrated_constants(results: Results) -> tuple[list[str], list[list[str]]]:
    """Columns and rows: what was found of every constant. A share is that of a constant known by its logarithm."""
    columns = [
        "constant",
        "unit",
        "starting fleet",
        "fitted",
        "standard error",
        "before",
        "between motors",
        "identified",
    ]
    rows = []
    for part in results.where(quantity="calibrate_center").distinct("part"):
        of = results.where(part=part, model=None)
        unit = of.where(quantity="calibrate_center").rows[0].unit
        is_share = of.where(quantity="calibrate_error").rows[0].unit == "1" != unit
        widths = (of.value(quantity=f"calibrate_{name}") for name in ("error", "belief", "spread"))
        cells = [f"{100 * width:.0f} %" if is_share else f"{width:.3g}" for width in widths]
        values = [f"{of.value(quantity=f'calibrate_{name}'):.3g}" for name in ("start", "center")]
        known = "yes" if of.value(quantity="calibrate_identified") else "no"
        rows.append([part, unit, *values, *cells, known])
    return columns, rows


def optima(results: Results) -> tuple[list[str], list[list[str]]]:
    """Columns and rows: where the searches ended, the best first."""
    costs, found = results.where(quantity="calibrate_cost"), results.where(quantity="calibrate_optimum")
    parts = found.distinct("part")
    rows = [
        [str(place), f"{row.value:.1f}", *(f"{found.value(model=row.model, part=part):.3g}" for part in parts)]
        for place, row in enumerate(costs, start=1)
    ]
    return ["optimum", "cost", *parts], rows
