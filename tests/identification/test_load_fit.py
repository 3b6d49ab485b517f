"""A load that nobody weighed: found with its motor, with deviations that hold, or refused."""

from dataclasses import replace

import numpy as np
import pytest
from swinging_bars import HANGS_AT, INERTIA, WEIGHT, swing

from motorprior.exceptions import LogError
from motorprior.identification.load_fit import FittedLoads, fit_loads, with_fitted_loads
from motorprior.logs.motor_log import POSTURES


@pytest.fixture(scope="module")
def loads() -> FittedLoads:
    return fit_loads(swing(12.0).log)


def test_inertia_and_weight_are_found_within_their_deviations(loads: FittedLoads):
    truth = swing(1.0).gravity
    off = np.log(loads.inertia / INERTIA)
    assert np.all(np.abs(off) < np.maximum(3.0 * loads.inertia_deviation, 0.05)) and np.abs(off).max() < 0.3
    assert np.all(loads.inertia_deviation < 0.5), "the log tells more than nothing"
    assert np.all(np.abs(loads.gravity - truth) < np.maximum(3.0 * loads.gravity_deviation, 0.02 * WEIGHT[:, None]))
    assert np.all(loads.gravity_deviation < 0.2 * WEIGHT[:, None])
    assert np.all(loads.error < 3e-3)


def test_the_log_carries_the_fitted_loads():
    bars = swing(1.0)
    log = with_fitted_loads(
        replace(bars.log, joint_torque=np.zeros_like(bars.log.joint_pos)),
        FittedLoads(INERTIA, np.zeros(2), bars.gravity, np.zeros((2, 2)), np.zeros(2)),
    )
    assert log.load_inertia is not None and log.external_torque is not None and log.load_stiffness is not None
    np.testing.assert_array_equal(log.load_inertia, np.tile(INERTIA, (log.num_rows, 1)))
    pull = -WEIGHT * np.sin(log.joint_pos - HANGS_AT)
    np.testing.assert_allclose(log.external_torque[:-1], 0.5 * (pull[:-1] + pull[1:]), atol=1e-12)
    np.testing.assert_allclose(log.external_torque[-1], pull[-1], atol=1e-12)
    np.testing.assert_allclose(log.load_stiffness, -WEIGHT * np.cos(log.joint_pos - HANGS_AT), atol=1e-12)
    assert log.joint_torque is None, "a motor's current is not the torque on the joint"
    assert log.posture is not None and np.all(log.posture == POSTURES.index("fixed"))


def test_without_a_torque_that_is_known_nothing_can_be_weighed():
    log = swing(1.0).log
    for other in (replace(log, stated_kp=None, stated_kd=None), replace(log, gain_unit="firmware")):
        with pytest.raises(LogError, match="how large a torque is") as refusal:
            fit_loads(other)
        assert refusal.value.remedy is not None and "state kp" in refusal.value.remedy
