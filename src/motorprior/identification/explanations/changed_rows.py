"""Rows of logs as explanations change them: of which joints, in which logs, with which channels."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from motorprior.identification import windows
from motorprior.identification.explanations.explanation import (
    CHANNELS_WITH_GRAVITY,
    CHANNELS_WITH_MASS,
    CHANNELS_WITH_TURN,
    IS_TURNED,
    LEVER,
    MASS_EXTERNAL,
    MASS_INERTIA,
    MASS_STIFFNESS,
    SLOPE,
    TURNED_EXTERNAL,
    TURNED_INERTIA,
    TURNED_POS,
    TURNED_STIFFNESS,
    Explanation,
    Facts,
)
from motorprior.identification.explanations.registry import EXPLANATIONS
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.windows import TrainingData
from motorprior.logs.loads_bodies import GravityLevers, LinkMass, turned_loads
from motorprior.logs.motor_log import MotorLog


@dataclass(frozen=True)
class LoggedRows:
    """Rows that the explanations are tried on."""

    log: MotorLog
    runs: WindowRuns
    data: TrainingData  # all rows
    subset: TrainingData  # rows of the runs
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
    runs_with_turn: list[WindowRuns] = []
    if levers is not None:
        for joint, loads in enumerate(turned_loads(logs.log, logs.subset.segments)):
            with_turn = _with_turn(logs.subset, joint, loads)
            runs_with_turn.append(WindowRuns(with_turn, logs.runs.recipe))

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
            if levers is not None:
                if joint is not None:
                    is_connected = levers.carries[joint] | levers.carries[:, joint]
                    changed_joints = joints[is_connected[joints]]
                    changed_runs = runs_with_turn[joint]
                elif explanation.is_shared:
                    changed_runs = WindowRuns(_with_gravity(logs.subset, levers), logs.runs.recipe)
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
    for link, mass in enumerate(logs.masses):
        carriers = joints[logs.levers.carries[joints, link]]
        if mass is not None and carriers.size:
            runs = WindowRuns(_with_mass(logs.subset, mass), logs.runs.recipe)
            yield ChangedRows(
                explanation, carriers, runs, [True] * len(logs.subset.segments), None, link
            )


def _with_mass(data: TrainingData, mass: LinkMass) -> TrainingData:
    """The data with channels of a mass on a link."""
    series = _widened(data, CHANNELS_WITH_MASS)
    series[..., MASS_INERTIA] = mass.inertia.transpose(1, 0, 2)
    series[..., MASS_EXTERNAL] = mass.external.transpose(1, 0, 2)
    series[..., MASS_STIFFNESS] = mass.stiffness.transpose(1, 0, 2)
    return replace(data, series=series)


def _with_gravity(data: TrainingData, levers: GravityLevers) -> TrainingData:
    """The data with channels of gravity."""
    series = _widened(data, CHANNELS_WITH_GRAVITY)
    series[..., LEVER] = levers.lever.transpose(1, 0, 2)
    series[..., SLOPE] = levers.slope.transpose(1, 0, 2)
    return replace(data, series=series)


def _with_turn(data: TrainingData, joint: int, loads: np.ndarray) -> TrainingData:
    """The data with channels of a joint that is turned, from its `turned_loads`."""
    series = _widened(data, CHANNELS_WITH_TURN)
    inertia, external, stiffness = loads
    series[..., TURNED_INERTIA] = inertia.transpose(1, 0, 2)
    series[..., TURNED_EXTERNAL] = external.transpose(1, 0, 2)
    series[..., TURNED_STIFFNESS] = stiffness.transpose(1, 0, 2)
    series[..., TURNED_POS] = series[joint, :, windows.POS]
    series[joint, :, IS_TURNED] = 1.0
    return replace(data, series=series)


def _widened(data: TrainingData, channels: int) -> np.ndarray:
    """(M, R, channels) series of the data, with further channels of 0."""
    motors, rows, count = data.series.shape
    series = np.zeros((motors, rows, channels), data.series.dtype)
    series[..., :count] = data.series
    return series
