"""A new excitation is an entry of the registry: bench, simulated robot and real robot have it at once."""

import numpy as np
import pytest

from motorprior.bench.excitation import EXCITATIONS, Excitation
from motorprior.bench.recording import PRESETS, trial
from motorprior.hardware import motions
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation import playback


def test_a_new_excitation_is_one_entry(monkeypatch: pytest.MonkeyPatch):
    new = Excitation(lambda rng, steps, dt: np.sin(np.arange(steps) * dt))
    monkeypatch.setitem(EXCITATIONS, "slow sine", new)
    on_bench = trial(np.random.default_rng(0), "slow sine", 500, 3, PRESETS["rollout"], hold=False)
    np.testing.assert_allclose(on_bench.position_target[:, 0], np.sin(np.arange(500) * PRESETS["rollout"].period))
    simulated = playback.excitation_targets(PUPPER_V2, "slow sine", 3.0, 0.2, 0)
    real = motions.excitation_targets(PUPPER_V2, "slow sine", range(12), 3.0, 0.2, 8.0, 0)
    for targets in (simulated, real):
        assert targets.shape == (300, 12) and np.abs(targets - PUPPER_V2.nominal_pose).max() == pytest.approx(0.2)
