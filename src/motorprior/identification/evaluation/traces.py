"""Traces of free runs that a page draws: the joints with the median and the maximum error."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motorprior.artifacts import read_tensors, write_tensors
from motorprior.identification.evaluation.errors import LogErrors, MotorModel, angle_errors
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.training_data.windows import POS, SECONDS, TARGET

TRACES = "traces.safetensors"
_CHANNELS = ("time", "target", "measured")


@dataclass(frozen=True)
class Trace:
    """One joint of one log: (T,) time [s], target, measured and simulated angles by model [rad]."""

    log: str
    joint: str
    time: np.ndarray
    target: np.ndarray
    measured: np.ndarray
    models: dict[str, np.ndarray]


def traces(
    errors: LogErrors,
    model: str,
    runs: Mapping[str, Sequence[WindowRuns]],
    models: Mapping[str, MotorModel],
    drawn: Collection[str],
) -> list[Trace]:
    """Longest free runs, by log, of the joints with the median and the maximum error of a model."""
    found = []
    for log, joint in errors.median_and_max(model):
        name = errors.logs[log]
        longest = max(runs[name], key=lambda run: run.preset.window)
        time, target, measured = (longest.recorded(channel)[joint, 0] for channel in (SECONDS, TARGET, POS))
        simulated = {key: measured + angle_errors(longest, models[key])[joint, 0] for key in drawn}
        found.append(Trace(name, errors.joints[joint], time, target, measured, simulated))
    return found


def write_traces(folder: Path, traces: Sequence[Trace], lines: Sequence[str] = ()) -> None:
    """Write the traces, and lines for the user."""
    arrays = {f"{index}/{name}": getattr(trace, name) for index, trace in enumerate(traces) for name in _CHANNELS}
    arrays |= {f"{i}/model/{name}": values for i, trace in enumerate(traces) for name, values in trace.models.items()}
    write_tensors(
        folder / TRACES, arrays, {"lines": list(lines), "traces": [[trace.log, trace.joint] for trace in traces]}
    )


def read_traces(folder: Path) -> tuple[list[Trace], list[str]]:
    """What `write_traces` wrote."""
    tensors, header = read_tensors(folder / TRACES)
    found = []
    for index, (log, joint) in enumerate(header["traces"]):
        prefix = f"{index}/model/"
        models = {name.removeprefix(prefix): values for name, values in tensors.items() if name.startswith(prefix)}
        time, target, measured = (tensors[f"{index}/{name}"] for name in _CHANNELS)
        found.append(Trace(log, joint, time, target, measured, models))
    return found, header["lines"]
