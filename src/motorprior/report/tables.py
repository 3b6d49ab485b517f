"""Rows of the tables on the page and on the terminal."""

from motorprior.results import Results

ColumnsAndRows = tuple[list[str], list[list[str]]]


def transfer_table(results: Results) -> ColumnsAndRows:
    """Means over seeds: in the training simulation, then on the twin."""
    columns = ["trained on", "seeds", "own: speed [m/s]", "upright", "drift in 5 s [m]"]
    columns += ["twin: speed [m/s]", "upright", "drift in 5 s [m]"]
    rows = []
    for name in results.distinct("model"):
        cells = [name, str(len(results.where(quantity="speed", motors="twin", model=name)))]
        for motors in ("own", "twin"):
            found = results.where(motors=motors, model=name)
            speed, upright, drift = (
                found.mean(quantity=quantity) for quantity in ("speed", "upright", "drift")
            )
            cells += [f"{speed:.2f}", f"{100 * upright:.0f} %", f"{drift:.2f}"]
        rows.append(cells)
    return columns, rows


def replay_table(results: Results) -> ColumnsAndRows:
    """Joint RMSE [mrad] per log, mean over its joints and of each joint; samples as median and 90 % band."""
    errors = results.where(quantity="real_rmse")
    models = errors.distinct("model")
    rows = []
    for log in errors.distinct("log"):
        rows.append(
            [log, "mean", *(_mean_cell(errors.where(log=log, model=model)) for model in models)]
        )
        joints = results.where(quantity="real_joint_rmse", log=log)
        for joint in joints.distinct("part"):
            values = (joints.value(part=joint, model=model) for model in models)
            rows.append([log, joint, *(f"{1000 * value:.1f}" for value in values)])
    return ["log", "joint", *models], rows


def _mean_cell(means: Results) -> str:
    cell = f"{1000 * means.value(statistic='median'):.1f}"
    if not means.where(statistic="p05"):
        return cell
    low, high = (1000 * means.value(statistic=side) for side in ("p05", "p95"))
    return f"{cell} ({low:.1f}-{high:.1f})"


def calibration_errors(results: Results) -> ColumnsAndRows:
    """Joint RMSE [mrad] of each log and their mean, and share within the bands."""
    titles = {
        "start": "starting fleet",
        "center": "fitted",
        "left_out": "without this log",
        "per_motor": "a motor per joint",
        "per_motor_left_out": "without this log",
    }
    errors = results.where(quantity="calibrate_rmse")
    models = [model for model in titles if model in errors.distinct("model")]
    covered = results.where(quantity="calibrate_coverage90")
    rows = []
    for log in errors.distinct("log"):
        cells = [f"{1e3 * errors.value(model=model, log=log):.1f}" for model in models]
        share = covered.mean() if log is None else covered.value(log=log)
        rows.append([log or "mean", *cells, f"{100 * share:.0f} %"])
    return ["log", *(titles[model] for model in models), "in 90 % bands"], rows


def calibrated_constants(results: Results) -> ColumnsAndRows:
    """Each constant of a calibration; errors of logarithms are in per cent."""
    columns = [
        "constant",
        "unit",
        "starting fleet",
        "fitted",
        "standard error",
        "prior σ",
        "σ between motors",
        "identified",
    ]
    rows = []
    for part in results.where(quantity="calibrate_center").distinct("part"):
        of = results.where(part=part, model=None)
        unit = of.where(quantity="calibrate_center")[0].unit
        is_share = of.where(quantity="calibrate_error")[0].unit == "1" != unit
        errors = (
            of.value(quantity=f"calibrate_{name}") for name in ("error", "prior_std", "spread")
        )
        cells = [f"{100 * error:.0f} %" if is_share else f"{error:.3g}" for error in errors]
        values = [f"{of.value(quantity=f'calibrate_{name}'):.3g}" for name in ("start", "center")]
        identified = "yes" if of.value(quantity="calibrate_identified") else "no"
        rows.append([part, unit, *values, *cells, identified])
    return columns, rows


def measure_table(results: Results) -> ColumnsAndRows:
    """Measures of walks, a column per policy."""
    names = results.distinct("model")
    rows = []
    for quantity, unit, part in dict.fromkeys(
        (row.quantity, row.unit, row.part) for row in results
    ):
        title = " ".join(filter(None, (quantity, part))) + ("" if unit == "1" else f" [{unit}]")
        found = [results.where(quantity=quantity, part=part, model=name) for name in names]
        rows.append([title, *(f"{each[0].value:.3g}" if each else "-" for each in found)])
    return ["measure", *names], rows
