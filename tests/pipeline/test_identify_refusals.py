"""What no fit can make better is refused before it, with a way out; what only a fit shows, after it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.exceptions import ArtifactError
from motorprior.logs.motor_log import MotorLog
from motorprior.pipeline import identify
from motorprior.pipeline.identify import fit_prior


@pytest.fixture
def log() -> MotorLog:
    """A joint that follows its command a little late."""
    time = 0.002 * np.arange(900)
    angle = np.sin(9.0 * time)[:, None]
    return MotorLog(
        time=time, position_target=angle + 0.01, joint_pos=angle, joint_names=("j",), robot="r", motor="m",
        source="mine.parquet", load_inertia=np.full_like(angle, 0.01), external_torque=0.0 * angle,
    )  # fmt: skip


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
