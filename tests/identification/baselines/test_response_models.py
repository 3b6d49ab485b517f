"""Response models: closed forms, and recovery of known constants from their own simulation."""

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


def constants(**values: float) -> np.ndarray:
    return np.array([list((RESPONSE_CONSTANTS | values).values())])


def command(seed: int, rows: int = ROWS) -> np.ndarray:
    """(rows,) chirp plus steps [rad]."""
    rng = np.random.default_rng(seed)
    time = DT * np.arange(rows)
    steps = np.repeat(rng.uniform(-0.4, 0.4, rows // 300), 300)
    frequency = 0.3 + 0.2 * time
    return 0.3 * np.sin(2 * np.pi * frequency * time) + steps


def runs_of(
    target: np.ndarray, pos: np.ndarray, external: np.ndarray, warm_up: int = PRESET.history
) -> WindowRuns:
    """Free run over the motion of one joint, from the end of the warm-up on."""
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
    """Free run of a hanging pendulum whose motion does not depend on the commands."""
    gravity = 0.4  # [N·m]
    pos = 2.0 * command(seed + 100)
    # gravity torque, linear around the recorded angle: external + stiffness·angle
    stiffness = -gravity * np.cos(pos)
    external = -gravity * (np.sin(pos) - pos * np.cos(pos))
    runs = runs_of(command(seed), pos, external)
    runs.segments[0].rows[:, STIFFNESS, 0] = stiffness
    return runs


def made_by(truth: np.ndarray, seed: int) -> list[WindowRuns]:
    """Free runs over the motion of a joint with these constants, which starts from rest."""
    target = command(seed)
    external = 0.5 * np.sin(3.0 * DT * np.arange(ROWS) + seed)
    pos = np.zeros(ROWS)
    pos[1:] = ResponseMotors(truth).errors(runs_of(target, pos, external, warm_up=0))[0, 0]

    return [runs_of(target, pos, external)]


def test_a_response_keeps_its_speed_and_acceleration_and_stops_in_its_dead_band():
    target = np.where(np.arange(ROWS) < PRESET.history, 0.0, 3.0)
    runs = runs_of(target, np.zeros(ROWS), np.full(ROWS, 2.0))
    limited = constants(
        rate=40.0, damping=1.0, speed=1.5, acceleration=10.0, band=0.1, compliance=-0.2
    )
    answer = ResponseMotors(limited).errors(runs)[0, 0]
    speed = np.diff(answer) / DT

    assert np.max(np.abs(speed)) == pytest.approx(1.5, abs=1e-9)
    assert np.max(np.abs(np.diff(speed))) / DT == pytest.approx(10.0, abs=1e-6)

    # the command plus compliance times torque
    aim = 3.0 - 0.2 * 2.0

    assert 0.02 < abs(answer[-1] - aim) < 0.1
    assert speed[-1] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("name", "true_values"), [("second_order", LINEAR), ("servo_limits", SERVO)]
)
def test_a_fit_recovers_the_constants_of_its_own_simulation(
    name: str, true_values: dict[str, float]
):
    truth = constants(**true_values)
    training: list[WindowRuns] = [*made_by(truth, 1), *made_by(truth, 2)]

    models = fit_responses(training, "torque")

    fitted = dict(zip(RESPONSE_CONSTANTS, models[name].constants[0], strict=True))
    for constant, value in true_values.items():
        assert fitted[constant] == pytest.approx(value, rel=0.05, abs=1e-3), constant

    errors = free_run_errors(made_by(truth, 4), models)
    assert errors[name][0] < 1e-3
    simpler_models = list(models)[: list(models).index(name)]
    for model in simpler_models:
        assert errors[model][0] > 3 * errors[name][0], model


def test_the_load_along_a_recorded_motion_does_not_reveal_this_motion():
    training = [pendulum_moved_by_hand(1), pendulum_moved_by_hand(2)]
    test = pendulum_moved_by_hand(3)

    servo = fit_responses(training, "torque")["servo_limits"]

    (error,) = free_run_errors([test], {"servo": servo})["servo"]
    assert error > 0.8 * np.std(test.recorded(POS))
