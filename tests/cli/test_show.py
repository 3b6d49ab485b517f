"""`motorprior show` prints what a file holds, and `motorprior export` writes motors."""

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


def test_a_log_a_prior_a_posterior_a_policy_a_fleet_and_a_robot_are_shown(
    motorprior: Callable[..., Any], bench: Path, prior: Path, gait_walk: Path, tmp_path: Path
):
    shown = motorprior("show", prior)
    assert shown.code == 0 and "gear_stiffness" in shown.out and "identifiable" in shown.out
    assert shown.out.strip() == str(MotorPrior.load(prior))
    log = motorprior("show", bench / LOG)
    assert "motor log of" in log.out and "angle from [°]" in log.out
    assert "walking policy" in motorprior("show", gait_walk / "policy.safetensors").out
    assert "fleet 'pupper_v2'" in motorprior("show", "pupper_v2").out
    assert "FR_h" in motorprior("show", written(tmp_path, LEGS_TOML, "dog", quadruped())).out
    of = MotorPrior.load(prior)
    latents = of.model.num_latents
    posterior = MotorPosterior(
        of, np.zeros((1, latents)), np.eye(latents)[None], ("pan",), 8.0, (0.4,)
    )
    posterior.save(tmp_path / "posterior.safetensors")
    missing = motorprior("show", tmp_path / "posterior.safetensors")
    assert missing.code == 2 and "--prior" in missing.err
    assert (
        "0.4 (pan)" in motorprior("show", tmp_path / "posterior.safetensors", "--prior", prior).out
    )


def test_samples_of_a_prior_are_exported_with_their_loss(
    motorprior: Callable[..., Any], prior: Path, tmp_path: Path
):
    done = motorprior(
        "export", prior, "--format", "table", "--motors", 2, "--out", tmp_path / "motors"
    )
    assert done.code == 0 and "mrad" in done.err + done.out
    assert len(list((tmp_path / "motors").iterdir())) > 0


def test_motors_are_exported_at_gains_in_the_unit_of_their_logs(
    motorprior: Callable[..., Any], tmp_path: Path
):
    """Samples of the shipped servo, whose logs have kp but no kd, at their middle gain and at twice this gain."""
    servo = tmp_path / "servo.safetensors"
    kp = []
    from_pretrained("xl330").save(servo)
    for name, options in (("middle", ()), ("double", ("--kp", 800))):
        done = motorprior("export", servo, "--format", "table", "--out", tmp_path / name, *options)
        assert f"kp {800 if options else 400}" in done.err + done.out
        kp.append(read_json(tmp_path / name / "motors.json")["samples"]["kp"])
    np.testing.assert_allclose(kp[1], 2.0 * np.array(kp[0]))
