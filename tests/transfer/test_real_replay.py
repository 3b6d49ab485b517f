"""The shipped fleet is what the logs of a real robot say: its central motor replays them."""

from pathlib import Path

import numpy as np
import pytest

from motorprior.bench.fleet import load_fleet
from motorprior.logs.formats.puppersim import read_puppersim_logs
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.transfer.posture import find_posture, with_posture
from motorprior.transfer.real_replay import Replayer, prepare

BOUND = {"0116": 0.0160, "1_joint": 0.0060, "bf": 0.0165, "lr": 0.0165}
"""[rad]; the logs gave 0.0153, 0.0053, 0.0157 and 0.0158 with the shipped fleet."""


@pytest.mark.parametrize("name", BOUND)
def test_the_central_motor_replays_a_real_log_in_the_posture_that_it_finds(shared_data: Path, name: str):
    folder = shared_data / "pupper_v2"
    if not folder.is_dir():
        pytest.skip("no logs of a real Pupper")
    log = read_puppersim_logs(folder, PUPPER_V2)[name]
    center, prepared = load_fleet("pupper_v2").center(spec.NUM_JOINTS).actuator(), prepare(log, PUPPER_V2, name)
    posture = find_posture(log, prepared, PUPPER_V2, center)
    assert posture.name == ("hung" if name == "1_joint" else "standing"), posture.evidence
    replayer = Replayer(with_posture(log, posture.name), PUPPER_V2, with_posture(prepared, posture.name))
    assert np.nanmean(replayer.run(center).rmse) <= BOUND[name]
