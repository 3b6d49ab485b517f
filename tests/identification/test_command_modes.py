"""Priors of drives under MIT, velocity and torque commands: constants, files, samples, notes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import command_modes as bench
import motorprior as mp
from motorprior.evaluation.errors import replay_errors
from motorprior.identification.load_fit import fit_loads
from motorprior.logs.motor_log import MotorLog
from motorprior.priors.adapt import note_command_mode
from motorprior.progress import SILENT, Note, Progress
from motorprior.signals import rms

pytestmark = pytest.mark.slow
SECONDS = {"mit": 15.0, "torque": 6.0, "velocity": 6.0}


def recorded(mode: str) -> tuple[MotorLog, bench.Constants]:
    rng = np.random.default_rng(4)
    constants = bench.drawn_constants(rng, 1)
    return bench.recorded(rng, constants, mode, SECONDS[mode], firmware_gains=True), constants


def test_gains_that_ramp_and_whole_frames_give_the_constants_of_a_drive():
    log, constants = recorded("mit")
    prior = mp.fit_prior(log, "quick", progress=SILENT)
    errors = bench.errors_of(prior, log, constants)

    assert errors["replay"] < 6e-4
    for name in ("kp", "kd", "coulomb"):
        assert errors[name] < 0.15, name
    assert errors["delay"] < 5e-4
    # gains in firmware units and a load of ten rotors hide the armature
    low, high = prior.intervals()["armature"]
    assert low <= constants["armature"] <= high


def test_velocity_commands_give_kd_and_rotor_of_a_drive_and_no_kp():
    log, constants = recorded("velocity")
    prior = mp.fit_prior(log, "quick", progress=SILENT)
    errors = bench.errors_of(prior, log, constants)

    assert errors["replay"] < 6e-4
    for name in ("kd", "coulomb"):
        assert errors[name] < 0.1, name
    assert errors["delay"] < 5e-4
    names = [row.name for row in prior.constants()]
    assert "kd_per_logged" in names, "in units of the firmware"
    assert not {"kp", "kd_over_kp"} & set(names)

    # a log of other motion, of the same drive
    other = bench.recorded(np.random.default_rng(5), constants, "velocity", 6.0, True)
    posterior = mp.adapt(prior, other, progress=SILENT)
    motors = prior.model.motors(posterior.mean, gains=other.gains)
    assert rms(replay_errors(motors, other, {})[0]) < 6e-4


@pytest.mark.parametrize("command_mode", ["mit", "velocity", "torque"])
def test_an_unknown_load_is_fitted_in_every_command_mode(command_mode: str):
    rng = np.random.default_rng(4)
    constants = bench.drawn_constants(rng, 1)
    log = bench.recorded(rng, constants, command_mode, 6.0)
    inertia = constants["mass"][0] * bench.LENGTH**2
    weight = constants["mass"][0] * bench.GRAVITY * bench.LENGTH

    (load,) = fit_loads(log, restarts=1)

    assert load.gravity[0] == pytest.approx(weight, rel=0.15)
    # without play, the log identifies the sum of load inertia and armature only
    assert 0.3 * inertia < load.inertia < 1.1 * (inertia + constants["armature"][0])


def test_constants_of_a_joint_whose_commands_were_logged_slowly_are_not_identified():
    rng = np.random.default_rng(6)
    constants = bench.drawn_constants(rng, 1)
    log = bench.recorded(rng, constants, "mit", 8.0)
    slow_rows = np.arange(log.num_rows) // 25 * 25  # every 50 ms
    target = log.position_target[slow_rows]
    slow = replace(log, position_target=target, slow_commands={"drive_0": 0.05})
    notes: list[Note] = []

    prior = mp.fit_prior(slow, "quick", progress=Progress(notes.append))

    assert not any(row.identifiable for row in prior.constants())
    assert any("sent between the logged ones (drive_0 50 ms)" in note.text for note in notes)


@pytest.fixture(scope="module")
def torque_prior() -> mp.MotorPrior:
    return mp.fit_prior(recorded("torque")[0], "quick", progress=SILENT)


def test_a_prior_of_torque_commands_states_its_mode_and_no_gains(
    torque_prior: mp.MotorPrior, tmp_path: Path
):
    torque_prior.save(tmp_path / "prior.safetensors")
    prior = mp.MotorPrior.load(tmp_path / "prior.safetensors")

    assert prior.command_mode == "torque"
    names = [row.name for row in prior.constants()]
    assert "armature" in names
    assert not {"kp", "kd_over_kp", "kd"} & set(names)


def test_sampled_motors_of_torque_commands_obey_torques_alone(torque_prior: mp.MotorPrior):
    zeros = np.zeros(1)
    motors = mp.Motors(torque_prior.sample(1, seed=0), bench.PERIOD, zeros)
    pushed = mp.Motors(torque_prior.sample(1, seed=0), bench.PERIOD, zeros)

    torque = pushed_torque = zeros
    for _ in range(50):
        torque, _ = motors.step(zeros + 1.0, zeros, zeros)
        pushed_torque, _ = pushed.step(zeros + 1.0, zeros, zeros, torque_feedforward=5.0)

    assert abs(torque[0]) < 1e-6, "a position target has no effect"
    assert pushed_torque[0] > 1.0


def test_a_log_of_another_mode_is_a_warning_of_what_was_not_measured(torque_prior: mp.MotorPrior):
    notes: list[Note] = []
    note_command_mode(torque_prior, recorded("mit")[0], Progress(notes.append))

    assert [note.severity for note in notes] == ["warning"]
    assert "position gains" in notes[0].text
    assert "feed-forward" not in notes[0].text
