"""Rows of the tables on the page and on the terminal."""

from motorprior.results import Results

ColumnsAndRows = tuple[list[str], list[list[str]]]

# models of a calibration -> column title
_CALIBRATED = {
    "start": "starting fleet",
    "center": "fitted",
    "left_out": "without this log",
    "per_motor": "a motor per joint",
    "per_motor_left_out": "without this log",
}
_CONSTANT_COLUMNS = [
    "constant",
    "unit",
    "starting fleet",
    "fitted",
    "standard error",
    "prior σ",
    "σ between motors",
    "identified",
]


def transfer_table(results: Results) -> ColumnsAndRows:
    """Means over seeds: in the training simulation, then on the twin."""
    columns = ["trained on", "seeds"]
    for motors in ("own", "twin"):
        columns += [f"{motors}: speed [m/s]", "upright", "drift in 5 s [m]"]

    rows = []
    for model in results.distinct("model"):
        seeds = results.where(quantity="speed", motors="twin", model=model)
        cells = [model, str(len(seeds))]
        for motors in ("own", "twin"):
            walks = results.where(motors=motors, model=model)
            cells.append(f"{walks.mean(quantity='speed'):.2f}")
            cells.append(f"{100 * walks.mean(quantity='upright'):.0f} %")
            cells.append(f"{walks.mean(quantity='drift'):.2f}")
        rows.append(cells)
    return columns, rows


def replay_table(results: Results) -> ColumnsAndRows:
    """Joint RMSE [mrad] per log: the mean over joints, then every joint.

    Errors of sampled motors are the median and the 90 % band.
    """
    errors = results.where(quantity="real_rmse")
    models = errors.distinct("model")
    rows = []
    for log in errors.distinct("log"):
        means = [_mean_cell(errors.where(log=log, model=model)) for model in models]
        rows.append([log, "mean", *means])
        joint_errors = results.where(quantity="real_joint_rmse", log=log)
        for joint in joint_errors.distinct("part"):
            cells = [log, joint]
            for model in models:
                cells.append(f"{1000 * joint_errors.value(part=joint, model=model):.1f}")
            rows.append(cells)
    return ["log", "joint", *models], rows


def _mean_cell(means: Results) -> str:
    """Median and, for sampled motors, 90 % band [mrad]."""
    cell = f"{1000 * means.value(statistic='median'):.1f}"
    if not means.where(statistic="p05"):
        return cell
    low = 1000 * means.value(statistic="p05")
    high = 1000 * means.value(statistic="p95")
    return f"{cell} ({low:.1f}-{high:.1f})"


def calibration_errors(results: Results) -> ColumnsAndRows:
    """Joint RMSE [mrad] of each log and their mean, and share within the bands."""
    errors = results.where(quantity="calibrate_rmse")
    coverage = results.where(quantity="calibrate_coverage90")
    calibrated = errors.distinct("model")
    models = [model for model in _CALIBRATED if model in calibrated]

    rows = []
    for log in errors.distinct("log"):
        cells = [log or "mean"]
        for model in models:
            cells.append(f"{1e3 * errors.value(model=model, log=log):.1f}")
        share = coverage.mean() if log is None else coverage.value(log=log)
        cells.append(f"{100 * share:.0f} %")
        rows.append(cells)
    return ["log", *(_CALIBRATED[model] for model in models), "in 90 % bands"], rows


def calibrated_constants(results: Results) -> ColumnsAndRows:
    """A row per constant of a calibration; errors of logarithms are in per cent."""
    rows = []
    for name in results.where(quantity="calibrate_center").distinct("part"):
        rows.append(_constant_row(name, results.where(part=name, model=None)))
    return _CONSTANT_COLUMNS, rows


def _constant_row(name: str, results: Results) -> list[str]:
    (center,) = results.where(quantity="calibrate_center")
    (error,) = results.where(quantity="calibrate_error")
    cells = [name, center.unit]
    for quantity in ("start", "center"):
        cells.append(f"{results.value(quantity=f'calibrate_{quantity}'):.3g}")

    is_share = error.unit == "1" and center.unit != "1"
    for quantity in ("error", "prior_std", "spread"):
        value = results.value(quantity=f"calibrate_{quantity}")
        cells.append(f"{100 * value:.0f} %" if is_share else f"{value:.3g}")

    is_identified = results.value(quantity="calibrate_identified")
    cells.append("yes" if is_identified else "no")
    return cells


def gait_table(results: Results) -> ColumnsAndRows:
    """Measures of walks, a column per policy."""
    policies = results.distinct("model")
    rows = []
    for quantity, unit, leg in dict.fromkeys((row.quantity, row.unit, row.part) for row in results):
        title = quantity if leg is None else f"{quantity} {leg}"
        if unit != "1":
            title += f" [{unit}]"
        cells = [title]
        for policy in policies:
            values = results.where(quantity=quantity, part=leg, model=policy)
            cells.append(f"{values[0].value:.3g}" if values else "-")
        rows.append(cells)
    return ["measure", *policies], rows
