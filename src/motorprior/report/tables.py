"""Rows of the tables that page and terminal both show."""

from __future__ import annotations

from motorprior.transfer.metrics import COLUMNS, CONDITIONS, MODELS


def conditions_in(figures: dict[str, float]) -> list[str]:
    """Conditions of a transfer table, in the usual order."""
    found = {name.split("/")[1] for name in figures if name.startswith("twin_speed/")}
    return [name for name in CONDITIONS if name in found] + sorted(found - set(CONDITIONS))


def transfer_rows(figures: dict[str, float]) -> list[list[str]]:
    """The transfer table as text: own simulation, then twin."""
    rows = []
    for name in conditions_in(figures):
        seeds = sum(key.startswith(f"twin_speed/{name}/seed_") for key in figures)
        cells = [name, str(seeds)]
        for place in ("own", "twin"):
            cells.append(f"{figures[f'{place}_speed/{name}']:.2f}")
            cells.append(f"{100 * figures[f'{place}_upright/{name}']:.0f} %")
            cells.append(f"{figures[f'{place}_drift/{name}']:.2f}")
        rows.append(cells)
    return rows


TRANSFER_COLUMNS = (
    "trained on", "seeds", "own: speed [m/s]", "upright", "drift in 5 s [m]",
    "twin: speed [m/s]", "upright", "drift in 5 s [m]",
)  # fmt: skip


def replay_models(figures: dict[str, float]) -> tuple[list[str], list[str]]:
    """Logs and models of a replay table."""
    names = [key.split("/")[1:] for key in figures if key.startswith("real_rmse/")]
    return list(dict.fromkeys(log for log, _ in names)), list(dict.fromkeys(model for _, model in names))


def replay_rows(figures: dict[str, float]) -> list[list[str]]:
    """Joint RMSE [mrad] per log, mean over its joints and then each; draws as median and 90 % band."""
    logs, models = replay_models(figures)
    rows = []
    for log in logs:
        rows.append([log, "mean", *(_mean_cell(figures, log, model) for model in models)])
        prefix = f"real_joint_rmse/{log}/"
        joints = dict.fromkeys(key.split("/")[2] for key in figures if key.startswith(prefix))
        for joint in joints:
            rows.append([log, joint, *(f"{1000 * figures[f'{prefix}{joint}/{model}']:.1f}" for model in models)])
    return rows


def _mean_cell(figures: dict[str, float], log: str, model: str) -> str:
    cell = f"{1000 * figures[f'real_rmse/{log}/{model}']:.1f}"
    if f"real_rmse_p05/{log}/{model}" not in figures:
        return cell
    low, high = (1000 * figures[f"real_rmse_{side}/{log}/{model}"] for side in ("p05", "p95"))
    return f"{cell} ({low:.1f}-{high:.1f})"


def fidelity_rows(figures: dict[str, float], columns: tuple[str, ...] = COLUMNS, ending: str = "") -> list[list[str]]:
    """Model and ``columns`` of a fidelity table; ``ending`` of the figures' names, for example ``/held_out``."""
    prefix = f"{columns[0]}/"
    found = [name.removeprefix(prefix) for name in figures if name.startswith(prefix) and name.count("/") == 1]
    models = sorted(found, key=lambda name: MODELS.index(name) if name in MODELS else len(MODELS))
    return [[name, *(f"{figures[f'{column}/{name}{ending}']:.4f}" for column in columns)] for name in models]
