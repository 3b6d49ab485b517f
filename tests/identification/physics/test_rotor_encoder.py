"""Logs of encoders on the rotors do not identify backlash and encoder zero."""

from dataclasses import replace

import numpy as np
import pytest
from series import complete

from motorprior.actuator.geared_motor_step import PARAMETERS
from motorprior.actuator.grey_box import ROTOR_POS, ROTOR_VEL, GreyBox, GreyBoxActuator
from motorprior.actuator.kernels import reset_actuator, step_actuator
from motorprior.identification.physics.motor_problem import grey_box, initial_center, motor_search
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.presets import PRESETS
from motorprior.identification.windows import TrainingData

PRESET = replace(PRESETS["rollout"], window=100)
SCALES = {"error_scale": 0.2, "velocity_scale": 3.0, "torque_scale": 1.0, "torque_limit": 3.0}
MOTORS = 3
DT = PRESET.period
INERTIA = np.array([0.0008, 0.002, 0.004])
BACKLASH = PARAMETERS.index("backlash")
HIDDEN = ("backlash", "encoder_zero")


@pytest.fixture(scope="module")
def box() -> GreyBox:
    """Decoder around the initial motor, with one latent per constant."""
    return grey_box(initial_center(()), (), PRESET)


@pytest.fixture(scope="module")
def z() -> np.ndarray:
    """Latents of motors with the central backlash and different encoder zeros."""
    drawn = 0.3 * np.random.default_rng(2).standard_normal((MOTORS, len(PARAMETERS)))
    drawn[:, BACKLASH] = 0.0
    return drawn


@pytest.fixture(scope="module")
def series(box: GreyBox, z: np.ndarray) -> np.ndarray:
    """(MOTORS, rows, channels) readings of the rotors' encoders, each motor under a load."""
    rng = np.random.default_rng(1)
    rows = PRESET.history + PRESET.window + 1
    targets = np.cumsum(rng.normal(0.0, 0.02, (rows, MOTORS)), axis=0)
    external = np.cumsum(rng.normal(0.0, 0.01, (rows, MOTORS)), axis=0)
    arrays = GreyBoxActuator(box, z).arrays(DT)
    zero = box.constants(z)["encoder_zero"]
    assert np.abs(zero).max() > 0.005  # large enough to change the motion
    q = targets[0] - zero
    dq = np.zeros(MOTORS)
    torque = np.zeros(MOTORS)
    readings = []
    reset_actuator(arrays, targets[0], q)

    for row in range(rows):
        readings.append((arrays.memory[ROTOR_POS] + zero, arrays.memory[ROTOR_VEL].copy()))
        step_actuator(arrays, DT, targets[row], q, dq, torque)
        dq = (dq + DT * (torque + external[row]) / INERTIA) / (1.0 + DT * arrays.damping / INERTIA)
        q = q + DT * dq

    pos, vel = np.array(readings).transpose(1, 0, 2)
    channels = (
        targets,
        pos,
        vel,
        np.zeros_like(pos),
        external,
        np.broadcast_to(INERTIA, pos.shape),
    )

    return complete(np.stack(channels, axis=-1).transpose(1, 0, 2)).astype(np.float32)


def loss(box: GreyBox, series: np.ndarray, z: np.ndarray, at_rotor: bool) -> float:
    rows = series.shape[1]
    data = TrainingData(
        series, np.arange(1), (slice(0, rows),), SCALES, has_torque=False, at_rotor=at_rotor
    )
    return float(motor_search(box, WindowRuns(data, PRESET)).losses(z).mean())


def test_a_perfect_model_replays_rotor_angles_only_as_such(box, series, z):
    assert loss(box, series, z, at_rotor=True) < 1e-5
    assert loss(box, series, z, at_rotor=False) > 1e-3


@pytest.mark.parametrize("name", HIDDEN)
def test_rotor_encoders_do_not_identify_zero_and_backlash(box, series, z, name: str):
    moved = z.copy()
    moved[:, PARAMETERS.index(name)] += 0.5

    assert loss(box, series, moved, at_rotor=True) == loss(box, series, z, at_rotor=True)


@pytest.mark.parametrize("name", ["kp", "coulomb", "armature"])
def test_rotor_encoders_identify_other_constants(box, series, z, name: str):
    moved = z.copy()
    moved[:, PARAMETERS.index(name)] += 0.5

    assert loss(box, series, moved, at_rotor=True) > loss(box, series, z, at_rotor=True)
