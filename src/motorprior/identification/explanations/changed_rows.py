"""Rows of logs as explanations change them: of which joints, in which logs, with which channels."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from motorprior.identification import windows
from motorprior.identification.explanations.explanation import (
    AXIS,
    CHANNELS_WITH_GRAVITY,
    CHANNELS_WITH_MASS,
    IS_TURNED,
    LEVER,
    MASS_EXTERNAL,
    MASS_INERTIA,
    MASS_STIFFNESS,
    SLOPE,
    TURNED_POS,
    Explanation,
    Facts,
)
from motorprior.identification.explanations.registry import EXPLANATIONS
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.windows import TrainingData
from motorprior.logs.loads_bodies import GravityLevers, LinkMass


@dataclass(frozen=True)
class LoggedRows:
    """Rows that the explanations are tried on."""

    runs: WindowRuns
    data: TrainingData  # all rows
    segments: tuple[slice, ...]  # rows of the runs
    with_gravity: TrainingData | None  # rows of the runs, if the bodies are known
    logs_of_segments: list[int]  # index of the log of each segment of the runs
    levers: GravityLevers | None
    masses: Sequence[LinkMass | None]  # of the link of each joint


@dataclass(frozen=True)
class ChangedRows:
    """An explanation of the inputs of some joints, for all logs or for one."""

    explanation: Explanation
    joints: np.ndarray  # indices
    runs: WindowRuns
    is_changed: list[bool]  # for each segment of the runs
    scope: int | None  # index of the log, None for all
    turned: int | None  # joint that the explanation turns, or whose link gets a mass
    predicted: np.ndarray | None = None  # (M, P) parameters over their units


def changed_rows(joints: np.ndarray, logs: LoggedRows, facts: Facts) -> Iterator[ChangedRows]:
    """`EXPLANATIONS` of these joints, for all logs, for single logs and for single joints."""
    levers = logs.levers
    for explanation in EXPLANATIONS:
        if not explanation.applies(facts):
            continue
        if explanation.adds_mass:
            yield from _mass_inputs(explanation, joints, logs)
            continue
        scopes: list[int | None] = [None]
        if explanation.per_log and len(facts.logs) > 1:
            scopes += list(range(len(facts.logs)))
        if explanation.only_per_log:
            scopes = scopes[1:]
        turned: list[int | None] = [None]
        if explanation.turns and levers is not None:
            turned = list(range(len(facts.joint_names)))

        for joint in turned:
            changed_joints = joints
            changed_runs = logs.runs
            if levers is not None and logs.with_gravity is not None:
                if joint is not None:
                    changed_joints = joints[levers.carries[joint, joints]]
                    changed_data = _with_axis(logs.with_gravity, levers, joint)
                    changed_runs = WindowRuns(changed_data, logs.runs.recipe)
                elif explanation.is_shared:
                    changed_runs = WindowRuns(logs.with_gravity, logs.runs.recipe)
            if not changed_joints.size:
                continue
            for scope in scopes:
                is_changed = [scope is None or log == scope for log in logs.logs_of_segments]
                yield ChangedRows(
                    explanation, changed_joints, changed_runs, is_changed, scope, joint
                )


def _mass_inputs(
    explanation: Explanation, joints: np.ndarray, logs: LoggedRows
) -> Iterator[ChangedRows]:
    """A mass on each link, for the joints that carry it."""
    assert logs.levers is not None
    assert logs.with_gravity is not None
    for link, mass in enumerate(logs.masses):
        carriers = joints[logs.levers.carries[joints, link]]
        if mass is not None and carriers.size:
            runs = WindowRuns(_with_mass_channels(logs.with_gravity, mass), logs.runs.recipe)
            yield ChangedRows(explanation, carriers, runs, [True] * len(logs.segments), None, link)


def _with_mass_channels(data: TrainingData, mass: LinkMass) -> TrainingData:
    """The data with channels of a mass in the place of those of gravity."""
    series = data.series[..., :CHANNELS_WITH_MASS].copy()
    series[..., MASS_INERTIA] = mass.inertia.transpose(1, 0, 2)
    series[..., MASS_EXTERNAL] = mass.external.transpose(1, 0, 2)
    series[..., MASS_STIFFNESS] = mass.stiffness.transpose(1, 0, 2)
    return replace(data, series=series)


def with_gravity_channels(data: TrainingData, levers: GravityLevers) -> TrainingData:
    """The data with channels of gravity."""
    motors, rows, _ = data.series.shape
    series = np.zeros((motors, rows, CHANNELS_WITH_GRAVITY), data.series.dtype)
    series[..., : data.series.shape[2]] = data.series
    series[..., LEVER] = levers.lever.transpose(1, 0, 2)
    series[..., SLOPE] = levers.slope.transpose(1, 0, 2)
    return replace(data, series=series)


def _with_axis(data: TrainingData, levers: GravityLevers, moved: int) -> TrainingData:
    """The data with the axis of the moved joint, for the joints that it carries."""
    series = data.series.copy()
    series[moved, :, IS_TURNED] = 1.0
    for joint in np.flatnonzero(levers.carries[moved]):
        series[joint, :, AXIS] = levers.axis[:, moved]
        series[joint, :, TURNED_POS] = series[moved, :, windows.POS]
    return replace(data, series=series)
