"""Errors of motor models on logs, and the warnings that follow from them.

`identify` and `adapt` replay the log that they use, `validate-log` and the quick report evaluate free runs on held-out
logs. All simulate joints from recorded commands and loads without feedback from the recorded motion, compare with a
tuned PD, and use the same results, table (`identification.evaluation.log_tables`) and warnings.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from motorprior.actuator.latent import LatentActuator
from motorprior.exceptions import listed
from motorprior.identification.evaluation.log_tables import error_line
from motorprior.identification.presets import Preset
from motorprior.logs.doctor.excitation import excited_joints, static_joints
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.settings_text import range_text
from motorprior.progress import Progress
from motorprior.results import Result, Results

if TYPE_CHECKING:  # they import JAX
    from motorprior.identification.evaluation.log_fidelity import LogModel
    from motorprior.identification.physics.window_runs import WindowRuns

PRIOR, TUNED_PD = "prior", "tuned_pd"
MAX_UNEXPLAINED = 0.35  # share of the tuned PD's error above which a model lacks physics
ENCODER_ERROR = 0.002  # [rad], counts as explained: an encoder of 12 bits resolves 1.5 mrad
DIVERGED_ERROR = 1.0  # error of a motor whose replay is not finite [rad]


@dataclass(frozen=True)
class LogErrors:
    """Root mean square errors of simulated angles [rad].

    Attributes:
        logs: L names.
        joints: J names.
        models: (L, J) by model; NaN where a joint is not excited.
    """

    logs: tuple[str, ...]
    joints: tuple[str, ...]
    models: dict[str, np.ndarray]

    @classmethod
    def of(cls, logs: Mapping[str, MotorLog], errors: Mapping[str, Mapping[str, np.ndarray]]) -> LogErrors:
        """Errors of the models that ran on all logs, (J,) by log and model; joints that are not excited are NaN."""
        each = list(errors.values())
        static = np.ones((len(logs), len(next(iter(each[0].values())))), dtype=bool)
        for index, log in enumerate(logs.values()):
            static[index, excited_joints(log)] = False
        models = [name for name in each[0] if all(name in found for found in each)]
        tables = {name: np.where(static, np.nan, np.stack([found[name] for found in each])) for name in models}
        return cls(tuple(logs), next(iter(logs.values())).joint_names, tables)

    def results(
        self, quantity: str, statistics: Mapping[str | None, Callable[[np.ndarray], np.floating]] | None = None
    ) -> Results:
        """Statistics of each model over all joints and logs, by default the mean; its means by joint and by log."""
        rows = []
        for model, values in self.models.items():
            for statistic, function in (statistics or {None: np.nanmean}).items():
                rows.append(Result(quantity, "rad", float(function(values)), model, statistic=statistic))
            for column, names, table in (("part", self.joints, values.T), ("log", self.logs, values)):
                rows += [
                    replace(Result(quantity, "rad", float(np.nanmean(row)), model), **{column: name})
                    for name, row in zip(names, table, strict=True)
                    if np.isfinite(row).any()
                ]
        return Results.of(rows)

    def median_and_max(self, model: str) -> list[tuple[int, int]]:
        """Log and joint of the median and of the maximum error of a model; once if they are the same."""
        values = self.models[model]
        order = np.argsort(values, axis=None)[: int(np.isfinite(values).sum())]  # NaN is last
        places = [np.unravel_index(order[rank], values.shape) for rank in (len(order) // 2, -1)]
        return list(dict.fromkeys((int(log), int(joint)) for log, joint in places))

    def unexplained(self, model: str) -> np.ndarray:
        """(J,) √(max(e² - ENCODER_ERROR², 0)) / e_PD with the mean errors e over the logs [-]."""
        errors = (self.models[name] for name in (model, TUNED_PD))
        with np.errstate(invalid="ignore"):  # NaN for joints that are not excited in any log
            error, baseline = (np.nansum(each, axis=0) / np.isfinite(each).sum(axis=0) for each in errors)
        return np.sqrt(np.maximum(error**2 - ENCODER_ERROR**2, 0.0)) / np.maximum(baseline, 1e-9)

    def warnings(self, model: str) -> list[str]:
        """A warning that names the joints for which too much of the tuned PD's error remains."""
        share = self.unexplained(model)
        large = np.flatnonzero(share > MAX_UNEXPLAINED)
        if not large.size:
            return []
        named = listed([f"{self.joints[joint]} {100 * share[joint]:.0f} %" for joint in large], 10)
        return [
            f"warning: more than {100 * MAX_UNEXPLAINED:.0f} % of the tuned PD's error remains on "
            f"{', '.join(self.logs)}: {named}. The model lacks physics of these motors, they differ from the prior's, "
            "or the fit did not converge -> do not interpret their constants; try preset long_runs, another seed or "
            "longer logs"
        ]


def free_run_spans(log: MotorLog, preset: Preset) -> dict[str, list[WindowRuns]]:
    """A held-out log as free runs of 1 s (``free_run``) and of whole segments (``whole_run``).

    Raises:
        LogError: it lacks a channel, has another sample period, or no segment is long enough.
    """
    from motorprior.identification.evaluation.log_fidelity import free_runs, whole_runs

    return {"free_run": [free_runs(log, preset, log.source)], "whole_run": whole_runs(log, preset, log.source)}


def model_errors(runs: Sequence[WindowRuns], models: Mapping[str, LogModel]) -> dict[str, np.ndarray]:
    """(J,) root mean square errors [rad] of free runs by model, at most one turn."""
    from motorprior.identification.evaluation.log_fidelity import free_run_errors, within_a_turn

    return {name: np.asarray(within_a_turn(values)) for name, values in free_run_errors(runs, models).items()}


def evaluate_replay(motors: LatentActuator, log: MotorLog, recipe: Preset, progress: Progress) -> LogErrors:
    """Replay a log with its motors and with a PD tuned to it; the errors and their warnings are notes."""
    from motorprior.identification.baselines.pd_fit import TUNING
    from motorprior.identification.evaluation.fit_quality import fit_quality

    with progress.start("tune a PD to compare with", TUNING) as task:
        found = fit_quality(motors, log, task.advance, recipe.nominal_conditions)
    errors = {
        name: np.where(np.isfinite(values), values, DIVERGED_ERROR)[None]
        for name, values in zip((PRIOR, TUNED_PD), found, strict=True)
    }
    replayed = LogErrors((log.source,), log.joint_names, errors)
    progress.note(error_line(replayed.results("replay_rmse"), "replay_rmse"))
    for line in replayed.warnings(PRIOR):
        progress.note(line)
    return replayed


def log_warnings(log: MotorLog, recipe: Preset) -> list[str]:
    """Warnings about static joints of a log, and about its conditions outside those that a recipe was fitted to."""
    from motorprior.identification.physics.term_selection import TERM_OF, min_difference

    found = []
    if static := static_joints(log):
        found.append(
            f"warning: did not move: {', '.join(static)}; their constants and errors mean nothing -> exclude these "
            "joints, or record them in motion"
        )
    for name, lowest, nominal, highest in recipe.conditions:
        modelled = TERM_OF[name] in recipe.terms
        if getattr(log, name) is None:
            if modelled:
                found.append(f"note: the log has no {name}: {range_text(name, nominal, nominal)} is assumed")
            continue
        means = np.array([part.conditions[name] for part in log.segments()])
        margin = min_difference(name, nominal)
        if means.min() < lowest - margin or means.max() > highest + margin:
            effect = "extrapolated" if modelled else "not modelled"
            found.append(
                f"warning: {name} is {range_text(name, means.min(), means.max())}, in the prior's logs "
                f"{range_text(name, lowest, highest)}: its effect is {effect} -> check its unit, or identify with "
                "logs of both"
            )
    return found
