"""What no fit can make better is refused before it, with a way out; what only a fit shows, after it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.exceptions import ArtifactError, ConfigError, LogError
from motorprior.identification import train
from motorprior.identification.presets import PRESETS
from motorprior.logs.motor_log import MotorLog
from motorprior.pipeline import identify
from motorprior.pipeline.identify import fit_prior


class Fitted(Exception):
    """A fit has begun."""


def begin(*_: object) -> None:
    raise Fitted


@pytest.fixture
def log() -> MotorLog:
    """A joint that follows its command a little late."""
    time = 0.002 * np.arange(900)
    angle = np.sin(9.0 * time)[:, None]
    return MotorLog(
        time=time, position_target=angle + 0.01, joint_pos=angle, joint_names=("j",), robot="r", motor="m",
        source="mine.parquet", load_inertia=np.full_like(angle, 0.01), external_torque=0.0 * angle,
    )  # fmt: skip


def stating(log: MotorLog, kp: float, kd: float, unit: str = "N·m/rad") -> MotorLog:
    return replace(log, stated_kp=0.0 * log.joint_pos + kp, stated_kd=0.0 * log.joint_pos + kd, gain_unit=unit)


@pytest.mark.parametrize(
    ("kp", "kd", "words"),
    [
        (2000.0, 20.0, r"kp = 2000 is not from 0\.001 to 1000 N·m/rad"),
        (1.0, 32.0, r"kd_over_kp = 32 is not from .* to 10 s"),
    ],
)
def test_stated_gains_that_no_motor_has_are_refused_before_the_fit(
    log: MotorLog, monkeypatch: pytest.MonkeyPatch, kp: float, kd: float, words: str
):
    monkeypatch.setattr(train, "identify", begin)
    with pytest.raises(LogError, match=rf"(?s)mine\.parquet: stated gains: .*{words}") as error:
        fit_prior(stating(log, kp, kd), "pace")
    assert "N·m/rad" in str(error.value.remedy) and "firmware" in str(error.value.remedy)
    for sound in (stating(log, kp, kd, "firmware"), stating(log, 999.0, 0.0), stating(log, 0.002, 0.01), log):
        with pytest.raises(Fitted):
            fit_prior(sound, "pace")


@pytest.mark.parametrize(("name", "value"), [("encoder_zero", 1.6), ("kp", 1100.0)])
def test_a_central_motor_that_is_none_is_refused_with_what_to_look_for_in_the_log(
    log: MotorLog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, grey_network: Any, name: str, value: float
):
    z = np.zeros((1, 3))
    found = MotorPrior(grey_network(**{name: value}), z, z, "pace", "r", "m", {}, {})
    monkeypatch.setattr(identify, "_fitted", lambda *_: found)
    with pytest.raises(ArtifactError, match=rf"motor_center: {name} = {value:g} is not") as error:
        fit_prior(log, "pace", out=tmp_path)
    for words in ("runs against its command", "zero", "unit", "logs check"):
        assert words in str(error.value.remedy)


def test_steps_of_a_preset_that_trains_no_network_are_refused(log: MotorLog, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(train, "identify", begin)
    for preset in ("long_runs", "first_look", "per_motor", "pace", "pace_long_runs", "coulomb_viscous", "stribeck"):
        with pytest.raises(ConfigError, match=rf"steps 50 has no effect on preset '{preset}'") as error:
            fit_prior(log, preset, steps=50)
        assert error.value.argument == "steps" and "rollout, one_motor, latent_network" in str(error.value.remedy)
        assert not PRESETS[preset].trains
    with pytest.raises(Fitted):
        fit_prior(log, "rollout", steps=50)
