"""Of a limit that no log shows the user hears where the prior is made, and where a policy is trained on it."""

import io
from pathlib import Path

import numpy as np
import pytest

import motorprior as mp
from motorprior.actuator.motor_prior import MotorPrior, unidentified_limits
from motorprior.bench.recording import bench_names
from motorprior.pipeline.motor_choice import MotorChoice
from motorprior.pipeline.progress import Lines
from motorprior.pipeline.walking.walk import Walk, run_walk
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.search.ars import ArsConfig


def fitted(excitation: str, said: io.StringIO) -> MotorPrior:
    log = mp.record_bench(PUPPER_V2, motors=4, steps=1500, preset=excitation)
    return mp.fit_prior(log, "pace", progress=Lines(said))


def test_sinusoids_without_load_show_no_torque_limit(tmp_path: Path):
    said = io.StringIO()
    prior = fitted("narrow", said)
    found = unidentified_limits(prior.metrics)
    assert found.keys() == {"torque_limit"} and found["torque_limit"] > 5.0
    whose = f"the logs of 4 of 4 motors ({', '.join(bench_names(4))}) do not show"
    assert f"{whose} a torque limit of {found['torque_limit']:.3g} N·m" in said.getvalue()
    assert "with half of it, or with double, the loss of such a log is at most 1.02 times what it is" in said.getvalue()
    prior.save(tmp_path / "prior.safetensors")
    assert unidentified_limits(MotorPrior.load(tmp_path / "prior.safetensors").metrics) == found

    heard = io.StringIO()
    search = ArsConfig(num_directions=2, num_top_directions=1)
    motors = MotorChoice("prior", tmp_path / "prior.safetensors")
    run_walk(Walk(tmp_path / "walk", motors, iterations=1, episode_steps=20, search=search, workers=1), Lines(heard))
    told = "N·m of the prior was not seen in its logs (the description of pupper_v2: 1.26 at most)"
    assert told in heard.getvalue()
    heard = io.StringIO()
    mp.train_policy(PUPPER_V2, prior, iterations=1, episode_steps=20, workers=1, progress=Lines(heard))
    assert told in heard.getvalue()


def test_of_gaits_with_impacts_only_the_motor_whose_log_is_too_short_is_told():
    said = io.StringIO()
    prior = fitted("rollout", said)
    limits = prior.network.constants(prior.mean)["torque_limit"]
    assert (limits > 2.0).sum() == 1 and np.median(limits) == pytest.approx(1.26, rel=0.1)
    assert unidentified_limits(prior.metrics)["torque_limit"] == pytest.approx(limits.max(), rel=0.2)
    worst = bench_names(4)[int(limits.argmax())]
    assert f"the logs of 1 of 4 motors ({worst}) do not show a torque limit" in said.getvalue()
