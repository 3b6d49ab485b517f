"""What a quick report of real logs finds: errors of models, constants of motors, and what to say about them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from motorprior.logs.doctor.excitation import excited_joints
from motorprior.logs.motor_log import MotorLog
from motorprior.report.real_motor_tables import CONSTANT, NAMES, Trace
from motorprior.results import Result, Results

if TYPE_CHECKING:  # they import JAX
    from motorprior.identification.evaluation.log_fidelity import LogModel
    from motorprior.identification.physics.window_runs import WindowRuns


@dataclass(frozen=True)
class Findings:
    """What was found.

    Attributes:
        lines: for the user.
        results: errors and constants.
        traces: to be drawn.
    """

    lines: tuple[str, ...] = ()
    results: Results = field(default_factory=Results)
    traces: tuple[Trace, ...] = ()

    def __add__(self, other: Findings) -> Findings:
        return Findings(self.lines + other.lines, self.results + other.results, self.traces + other.traces)


@dataclass(frozen=True)
class Errors:
    """Root mean square errors [rad].

    Attributes:
        logs: names.
        joints: names.
        models: (logs, joints) by model; nan where a joint did not move.
    """

    logs: tuple[str, ...]
    joints: tuple[str, ...]
    models: dict[str, np.ndarray]

    @classmethod
    def of(cls, logs: Mapping[str, MotorLog], found: Mapping[str, Mapping[str, np.ndarray]]) -> Errors:
        """Of the models that have (joints,) errors in all logs, in each the joints that moved."""
        each = list(found.values())
        models = [name for name in each[0] if all(name in errors for errors in each)]
        still = np.ones((len(logs), len(each[0][models[0]])), dtype=bool)
        for index, log in enumerate(logs.values()):
            still[index, excited_joints(log)] = False
        joints = next(iter(logs.values())).joint_names
        tables = {name: np.where(still, np.nan, np.stack([errors[name] for errors in each])) for name in models}
        return cls(tuple(logs), joints, tables)

    def rows(self, quantity: str) -> Results:
        """Means over all, over the logs for every joint, and over the joints for every log."""
        rows = []
        for model, values in self.models.items():
            rows.append(Result(quantity, "rad", float(np.nanmean(values)), model))
            rows += _means(quantity, model, "part", self.joints, values.T)
            rows += _means(quantity, model, "log", self.logs, values)
        return Results.of(rows)

    def worst(self, model: str) -> tuple[int, int]:
        """Log and joint with the largest error of a model."""
        return self._place(model, -1)

    def typical(self, model: str) -> tuple[int, int]:
        """Log and joint with the median error of a model."""
        return self._place(model, int(np.isfinite(self.models[model]).sum()) // 2)

    def _place(self, model: str, rank: int) -> tuple[int, int]:
        values = self.models[model]
        order = np.argsort(values, axis=None)[: int(np.isfinite(values).sum())]  # nan is last
        log, joint = np.unravel_index(order[rank], values.shape)
        return int(log), int(joint)

    def compared(self) -> str:
        """A sentence: how far every model is from what the motors did."""
        parts = [f"{NAMES[name]} {1e3 * np.nanmean(self.models[name]):.1f}" for name in NAMES if name in self.models]
        return f"error of the angle, command in and motion out [mrad, mean of joints that moved]: {', '.join(parts)}"

    def unlike(self, model: str) -> str:
        """A sentence: the joint and the log that a model is farthest from, beside its usual error."""
        log, joint = self.worst(model)
        most, usual = self.models[model][log, joint], np.nanmedian(self.models[model])
        return (
            f"unlike {NAMES[model]} most of all: {self.joints[joint]} in {self.logs[log]}, {1e3 * most:.1f} mrad off; "
            f"half of the joints and logs have less than {1e3 * usual:.1f}"
        )


def _means(quantity: str, model: str, column: str, names: Sequence[str], values: np.ndarray) -> list[Result]:
    """A result per name that has a number in its row of ``values``."""
    return [
        replace(Result(quantity, "rad", float(np.nanmean(row)), model), **{column: name})
        for name, row in zip(names, values, strict=True)
        if np.isfinite(row).any()
    ]


def free_run_trace(
    log: str, name: str, joint: int, runs: Sequence[WindowRuns], models: Mapping[str, LogModel]
) -> Trace:
    """The longest of ``runs`` of one log, of the joint of this name and index."""
    from motorprior.identification.evaluation.log_fidelity import angle_errors
    from motorprior.identification.training_data.windows import POS, SECONDS, TARGET

    longest = max(runs, key=lambda one: one.preset.window)
    time, target, measured = (longest.recorded(channel)[joint, 0] for channel in (SECONDS, TARGET, POS))
    simulated = {model: measured + angle_errors(longest, motors)[joint, 0] for model, motors in models.items()}
    return Trace(log, name, time, target, measured, simulated)


def constant_results(values: Mapping[str, np.ndarray], units: Mapping[str, str], joints: Sequence[str]) -> Results:
    """A row per constant and joint."""
    return Results.of(
        Result(f"{CONSTANT}{name}", units[name], float(value), part=joint)
        for name, column in values.items()
        for joint, value in zip(joints, column, strict=True)
    )
