"""Quick report of logs with unknown loads: how every joint responds to its command, by models that need none."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from motorprior.logs.joining import joined
from motorprior.pipeline.progress import Progress
from motorprior.pipeline.quick_report.findings import Errors, Findings, constant_results, free_run_trace
from motorprior.pipeline.validation.log_baselines import BaselineFits, fitted_responses, with_some_load
from motorprior.pipeline.validation.log_stretches import Split
from motorprior.report.real_motor_tables import RMSE

SHOWN = {
    "delay": ("delay", 1e3, "ms"), "bandwidth": ("rate", 0.5 / np.pi, "Hz"), "dead_band": ("band", 1e3, "mrad")
}  # fmt: skip
"""What the user is told of: constants of servo_limits, the factor on them, and the unit that this gives."""


def report_without_loads(logs: Split, seed: int, folder: Path, progress: Progress) -> Findings:
    """Fit to the known stretches, judge by the others.

    Args:
        logs: on the prior's grid, of joints that moved.
        seed: of the fit.
        folder: for the constants.
        progress: where to report to.

    Raises:
        LogError: a segment that is too short.
    """
    from motorprior.identification.baselines.response_models import CONSTANTS
    from motorprior.identification.evaluation.log_fidelity import free_run_errors, whole_runs, within_a_turn
    from motorprior.identification.presets import identification_preset

    preset, known = identification_preset("rollout"), joined(list(logs.known.values()))
    models = fitted_responses(known, preset, BaselineFits(folder, seed=seed), progress)
    runs = {name: whole_runs(with_some_load(log), preset, log.source) for name, log in logs.judged.items()}
    found = {name: free_run_errors(each, models) for name, each in runs.items()}
    finite = {name: {model: within_a_turn(values) for model, values in each.items()} for name, each in found.items()}
    errors = Errors.of(logs.judged, finite)
    limits = dict(zip(CONSTANTS, models["servo_limits"].constants.T, strict=True))
    constants = {name: scale * limits[fitted] for name, (fitted, scale, _) in SHOWN.items()}
    units = {name: unit for name, (_, _, unit) in SHOWN.items()}
    places = dict.fromkeys((errors.typical("servo_limits"), errors.worst("servo_limits")))
    drawn = {name: model for name, model in models.items() if name != "pure_delay"}
    traces = tuple(
        free_run_trace(errors.logs[log], errors.joints[joint], joint, runs[errors.logs[log]], drawn)
        for log, joint in places
    )
    lines = (errors.compared(), _told(constants, units), errors.unlike("servo_limits"))
    return Findings(lines, errors.rows(RMSE) + constant_results(constants, units, known.joint_names), traces)


def _told(constants: dict[str, np.ndarray], units: dict[str, str]) -> str:
    quantiles = {name: np.quantile(values, [0.0, 0.5, 1.0]) for name, values in constants.items()}
    said = [
        f"{name.replace('_', ' ')} {middle:.3g} {units[name]} ({low:.3g} to {high:.3g})"
        for name, (low, middle, high) in quantiles.items()
    ]
    return f"how your joints respond, median (least to most): {', '.join(said)}"
