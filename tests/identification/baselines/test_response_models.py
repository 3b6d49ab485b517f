"""Response models: closed forms, and recovery of known constants from their own simulation."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from series import complete

from motorprior.evaluation.free_runs import free_run_errors
from motorprior.identification.baselines.response_fit import (
    RESPONSE_CONSTANTS,
    ResponseMotors,
    fit_responses,
)
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import PRESETS
from motorprior.identification.windows import (
    EXTERNAL,
    INERTIA,
    POS,
    READING,
    STIFFNESS,
    TARGET,
    VEL,
    TrainingData,
)

DT = 0.002
ROWS = 3000
PRESET = PRESETS["rollout"]
LINEAR = {"delay": 0.012, "rate": 30.0, "damping": 0.8, "offset": 0.03}
SERVO = LINEAR | {
    "speed": 1.5, "acceleration": 40.0, "band": 0.02, "gain": 0.97, "compliance": 0.04,
}  # fmt: skip


def constants(**known: float) -> np.ndarray:
    return np.array([list((RESPONSE_CONSTANTS | known).values())])


def command(seed: int, rows: int = ROWS) -> np.ndarray:
    """(rows,) a chirp with steps on it [rad]."""
    rng = np.random.default_rng(seed)
    time = DT * np.arange(rows)
    steps = np.repeat(rng.uniform(-0.4, 0.4, rows // 300), 300)
    return 0.3 * np.sin(2 * np.pi * (0.3 + 0.2 * time) * time) + steps


def runs_of(
    target: np.ndarray, pos: np.ndarray, external: np.ndarray, warm_up: int = PRESET.history
) -> WindowRuns:
    """One joint's motion as a free run of all that follows the warm-up."""
    rows = len(target)
    series = complete(np.zeros((1, rows, 1), np.float32))
    series[0, :, TARGET] = target
    series[0, :, POS] = pos
    series[0, :, EXTERNAL] = external
    series[0, 1:, VEL] = np.diff(pos) / DT
    series[0, :, INERTIA] = 0.01
    series[0, :, READING] = pos
    data = TrainingData(series, np.arange(rows), (slice(0, rows),), {}, False)
    return WindowRuns(data, replace(PRESET, taps=(0,), warm_up=warm_up, window=rows - 1 - warm_up))


def pendulum_moved_by_hand(seed: int) -> WindowRuns:
    """A hanging pendulum whose motion has nothing to do with the commands."""
    pos = 2.0 * command(seed + 100)
    runs = runs_of(command(seed), pos, -0.4 * (np.sin(pos) - pos * np.cos(pos)))
    runs.segments[0].rows[:, STIFFNESS, 0] = -0.4 * np.cos(pos)
    return runs


def made_by(truth: np.ndarray, seed: int) -> list[WindowRuns]:
    """The motion of a joint with these constants, from rest."""
    target = command(seed)
    external = 0.5 * np.sin(3.0 * DT * np.arange(ROWS) + seed)
    pos = np.zeros(ROWS)
    pos[1:] = ResponseMotors(truth).errors(runs_of(target, pos, external, warm_up=0))[0, 0]
    return [runs_of(target, pos, external)]


def test_limits_of_speed_and_acceleration_and_a_dead_band():
    target = np.where(np.arange(ROWS) < PRESET.history, 0.0, 3.0)
    runs = runs_of(target, np.zeros(ROWS), np.full(ROWS, 2.0))
    limited = constants(
        rate=40.0, damping=1.0, speed=1.5, acceleration=10.0, band=0.1, compliance=-0.2
    )
    answer = ResponseMotors(limited).errors(runs)[0, 0]
    speed = np.diff(answer) / DT
    assert np.max(np.abs(speed)) == pytest.approx(1.5, abs=1e-9)
    assert np.max(np.abs(np.diff(speed))) / DT == pytest.approx(10.0, abs=1e-6)
    aim = 3.0 - 0.2 * 2.0
    assert 0.02 < abs(answer[-1] - aim) < 0.1 and speed[-1] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("known", [LINEAR, SERVO], ids=["second_order", "servo_limits"])
def test_known_constants_are_recovered(known: dict[str, float], request: pytest.FixtureRequest):
    truth = constants(**known)
    name = request.node.callspec.id
    training: Sequence[WindowRuns] = [run for seed in (1, 2) for run in made_by(truth, seed)]
    models = fit_responses(training, "torque")
    found = dict(zip(RESPONSE_CONSTANTS, models[name].constants[0], strict=True))
    for constant, value in known.items():
        assert found[constant] == pytest.approx(value, rel=0.05, abs=1e-3), constant
    errors = free_run_errors(made_by(truth, 4), models)
    assert errors[name][0] < 1e-3
    simpler = list(models)[: list(models).index(name)]
    assert all(errors[model][0] > 3 * errors[name][0] for model in simpler)


def test_the_load_along_a_recorded_motion_does_not_reveal_this_motion():
    found = fit_responses([pendulum_moved_by_hand(1), pendulum_moved_by_hand(2)], "torque")[
        "servo_limits"
    ]
    test = pendulum_moved_by_hand(3)
    assert free_run_errors([test], {"": found})[""][0] > 0.8 * np.std(test.recorded(POS))
