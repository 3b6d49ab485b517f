"""`deploy` with dry_run computes what a walk with the same settings would, and sends nothing; in simulated time."""

from pathlib import Path

import numpy as np
import pytest

from motorprior.hardware import deploy
from motorprior.hardware.commands import run_deploy
from motorprior.hardware.motions import Walker
from motorprior.hardware.settings import DeploySettings
from motorprior.locomotion.body import YAW_RATE
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from simulated_port import SimulatedPort, on_its_clock


@pytest.mark.parametrize("without_imu", [False, True])
def test_a_rehearsal_without_imu_observes_what_a_walk_without_it_does(
    trot: Path, monkeypatch: pytest.MonkeyPatch, without_imu: bool
):
    walkers, said = [], []

    class Seen(Walker):
        def __init__(self, *args):
            super().__init__(*args)
            walkers.append(self)

    monkeypatch.setattr(deploy, "Walker", Seen)
    settings = DeploySettings(seconds=1.0, forward=0.2, yaw_rate=0.5, dry_run=True, without_imu=without_imu)
    with on_its_clock(SimulatedPort(PUPPER_V2, 0)):
        run_deploy(PUPPER_V2, trot, "a port", settings, said.append)
    (walker,) = walkers
    assert "control steps, nothing was sent" in said[-1]
    assert (walker.observation[YAW_RATE] == pytest.approx(0.5)) == without_imu, "it turns as it is told"
    assert np.isfinite(walker.observation).all()
