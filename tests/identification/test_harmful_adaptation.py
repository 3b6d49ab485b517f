"""An adaptation that does not carry over to other rows of its log is reported."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from grey_boxes import METRICS
from motor_logs import log_of

from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.dynamometer import run, trial_of
from motorprior.identification.presets import PRESETS
from motorprior.logs.motor_log import MotorLog
from motorprior.priors.adapt import harmed_joints

NAMES = ("FL_calf", "FR_calf")
PERIOD = 0.002
SECONDS = 8.0


def recorded(box: GreyBox, contact: float) -> MotorLog:
    """Log of two central motors; an unlogged contact holds the second in the first half.

    The contact has a torque of ``contact`` times the target [N·m/rad].
    """
    time = PERIOD * np.arange(round(SECONDS / PERIOD))
    target = 0.3 * np.sin(np.array([9.0, 7.0]) * time[:, None])
    in_contact = (time < 0.5 * SECONDS)[:, None] * np.array([0.0, 1.0])
    log = log_of(
        time,
        target,
        0.0 * target,
        joint_names=NAMES,
        joint_vel=0.0 * target,
        load_inertia=np.full_like(target, 0.01),
        external_torque=-contact * in_contact * target,
    )
    response = run(box.motors(np.zeros((2, box.num_latents))), trial_of(log))
    return replace(
        log,
        joint_pos=response.joint_pos,
        joint_vel=response.joint_vel,
        external_torque=0.0 * target,
    )


def prior_of(box: GreyBox) -> MotorPrior:
    z = np.random.default_rng(0).standard_normal((4, box.num_latents))
    provenance = {"recipe": PRESETS["pace"].as_json()}
    misfit = np.full(len(z), 0.5)
    return MotorPrior(box, z, 0.0 * z, "pace", "r", "m", provenance, METRICS, misfit=misfit)


def test_only_joints_whose_adaptation_does_not_carry_over_are_named(
    grey_box: Callable[..., GreyBox],
):
    box = grey_box()
    prior = prior_of(box)

    assert harmed_joints(prior, recorded(box, contact=0.0)) == {}
    harmed = harmed_joints(prior, recorded(box, contact=3.0))
    assert list(harmed) == ["FR_calf"]
    unadapted, adapted = harmed["FR_calf"]
    assert adapted > unadapted


def test_a_short_log_cannot_be_split(grey_box: Callable[..., GreyBox]):
    box = grey_box()
    log = recorded(box, contact=3.0).rows(slice(0, 500))
    assert harmed_joints(prior_of(box), log) == {}
