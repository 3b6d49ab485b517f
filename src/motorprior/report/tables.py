"""Rows of the tables that page and terminal both show."""

from __future__ import annotations

from motorprior.results import Results
from motorprior.transfer.metrics import CONDITIONS, MODELS


def conditions_in(results: Results) -> list[str]:
    """Conditions of a transfer table, in the usual order."""
    found = results.where(quantity="speed", motors="twin").distinct("model")
    return [name for name in CONDITIONS if name in found] + sorted(set(found) - set(CONDITIONS))


def transfer_rows(results: Results) -> list[list[str]]:
    """The transfer table as text, means over seeds: own simulation, then twin."""
    rows = []
    for name in conditions_in(results):
        cells = [name, str(len(results.where(quantity="speed", motors="twin", model=name)))]
        for place in ("own", "twin"):
            here = results.where(motors=place, model=name)
            speed, upright, drift = (here.mean(quantity=quantity) for quantity in ("speed", "upright", "drift"))
            cells += [f"{speed:.2f}", f"{100 * upright:.0f} %", f"{drift:.2f}"]
        rows.append(cells)
    return rows


TRANSFER_COLUMNS = (
    "trained on", "seeds", "own: speed [m/s]", "upright", "drift in 5 s [m]",
    "twin: speed [m/s]", "upright", "drift in 5 s [m]",
)  # fmt: skip


def replay_models(results: Results) -> list[str]:
    """Models of a replay table."""
    return results.where(quantity="real_rmse").distinct("model")


def replay_rows(results: Results) -> list[list[str]]:
    """Joint RMSE [mrad] per log, mean over its joints and then each; draws as median and 90 % band."""
    models, rows = replay_models(results), []
    for log in results.where(quantity="real_rmse").distinct("log"):
        means = results.where(quantity="real_rmse", log=log)
        rows.append([log, "mean", *(_mean_cell(means.where(model=model)) for model in models)])
        joints = results.where(quantity="real_joint_rmse", log=log)
        for joint in joints.distinct("part"):
            values = (joints.value(part=joint, model=model) for model in models)
            rows.append([log, joint, *(f"{1000 * value:.1f}" for value in values)])
    return rows


def _mean_cell(means: Results) -> str:
    cell = f"{1000 * means.value(statistic='median'):.1f}"
    if not means.where(statistic="p05"):
        return cell
    low, high = (1000 * means.value(statistic=side) for side in ("p05", "p95"))
    return f"{cell} ({low:.1f}-{high:.1f})"


def by_model(results: Results, quantity: str, motors: str = "train") -> dict[str, float]:
    """Medians of a quantity, models in the usual order."""
    found = results.where(quantity=quantity, motors=motors, statistic="median")
    models = sorted(found.distinct("model"), key=lambda name: MODELS.index(name) if name in MODELS else len(MODELS))
    return {model: found.value(model=model) for model in models}


def fidelity_rows(results: Results, columns: tuple[str, ...], motors: str = "train") -> list[list[str]]:
    """Model and medians of ``columns`` of a fidelity table."""
    values = [by_model(results, column, motors) for column in columns]
    return [[model, *(f"{column[model]:.4f}" for column in values)] for model in values[0]]
