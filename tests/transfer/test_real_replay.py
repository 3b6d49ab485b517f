"""The shipped fleet is what the logs of a real robot say: its central motor replays them."""

from pathlib import Path

import numpy as np
import pytest

from motorprior.bench.fleet import load_fleet
from motorprior.logs.puppersim import read_puppersim_logs
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.transfer.real_replay import prepare, replay_log

BOUND = 0.028
"""[rad]; the logs gave 0.0229-0.0255 when the fleet was identified."""


@pytest.mark.parametrize("name", ["0116", "bf", "lr"])
def test_the_central_motor_replays_a_real_log(shared_data: Path, name: str):
    folder = shared_data / "pupper_v2"
    if not folder.is_dir():
        pytest.skip("no logs of a real Pupper")
    log = read_puppersim_logs(folder, PUPPER_V2)[name]
    center = load_fleet("pupper_v2").center(spec.NUM_JOINTS).actuator()
    error = replay_log(log, PUPPER_V2, center, prepare(log, PUPPER_V2, name)).rmse
    assert np.nanmean(error) <= BOUND
