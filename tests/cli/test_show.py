"""`motorprior show` prints the content of a file, and `motorprior export` writes motors."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from dog import LEGS_TOML, quadruped, written

from motorprior import from_pretrained
from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import read_json
from motorprior.bench.bench_folder import LOG


def test_a_log_a_prior_a_policy_a_fleet_and_a_robot_are_shown(
    motorprior: Callable[..., Any], bench: Path, prior: Path, gait_walk: Path, tmp_path: Path
):
    shown = motorprior("show", prior)

    assert shown.code == 0
    assert "gear_stiffness" in shown.out
    assert "identifiable" in shown.out
    assert shown.out.strip() == str(MotorPrior.load(prior))

    log = motorprior("show", bench / LOG)

    assert "motor log of" in log.out
    assert "angle from [°]" in log.out
    assert "walking policy" in motorprior("show", gait_walk / "policy.safetensors").out
    assert "fleet 'pupper_v2'" in motorprior("show", "pupper_v2").out
    assert "FR_h" in motorprior("show", written(tmp_path, LEGS_TOML, "dog", quadruped())).out


def test_a_posterior_is_shown_with_its_prior_only(
    motorprior: Callable[..., Any], prior: Path, tmp_path: Path
):
    motor_prior = MotorPrior.load(prior)
    latents = motor_prior.model.num_latents
    mean = np.zeros((1, latents))
    covariance = np.eye(latents)[None]
    path = tmp_path / "posterior.safetensors"
    MotorPosterior(motor_prior, mean, covariance, ("pan",), 8.0, (0.4,)).save(path)

    without_prior = motorprior("show", path)

    assert without_prior.code == 2
    assert "--prior" in without_prior.err

    assert "0.4 (pan)" in motorprior("show", path, "--prior", prior).out


def test_samples_of_a_prior_are_exported_with_their_loss(
    motorprior: Callable[..., Any], prior: Path, tmp_path: Path
):
    done = motorprior(
        "export", prior, "--format", "table", "--motors", 2, "--out", tmp_path / "motors"
    )

    assert done.code == 0
    assert "mrad" in done.err + done.out
    assert len(list((tmp_path / "motors").iterdir())) > 0


def test_motors_are_exported_at_gains_in_the_unit_of_their_logs(
    motorprior: Callable[..., Any], tmp_path: Path
):
    """The logs of the shipped servo have kp, 400 in the middle, but no kd."""
    servo = tmp_path / "servo.safetensors"
    from_pretrained("xl330").save(servo)

    def exported_kp(gain: int, *options: object) -> np.ndarray:
        out = tmp_path / f"kp_{gain}"
        done = motorprior("export", servo, "--format", "table", "--out", out, *options)

        assert f"kp {gain}" in done.err + done.out

        return np.array(read_json(out / "motors.json")["samples"]["kp"])

    np.testing.assert_allclose(exported_kp(800, "--kp", 800), 2.0 * exported_kp(400))
