"""The doctor has something to say about any log that is one, and never a warning of numpy's."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from motorprior.logs.doctor.checks import check_log
from motorprior.logs.motor_log import MotorLog

SHAPES = ("still", "ramp", "sine", "step", "noise", "huge", "tiny", "coarse")


def series(shape: str, time: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    made = {
        "still": np.zeros_like(time), "ramp": time, "sine": np.sin(5 * time), "step": 1.0 * (time > np.median(time)),
        "noise": rng.normal(size=len(time)), "huge": 1e300 * np.sin(time), "tiny": 1e-300 * np.sin(time),
        "coarse": np.rint(2 * np.sin(3 * time)),
    }  # fmt: skip
    return made[shape]


@given(
    rows=st.lists(st.integers(2, 60), min_size=1, max_size=3),
    shapes=st.lists(st.sampled_from(SHAPES), min_size=6, max_size=6),
    seed=st.integers(0, 99),
)
@settings(max_examples=150, deadline=None)
def test_any_log_is_checked(rows: list[int], shapes: list[str], seed: int):
    rng = np.random.default_rng(seed)
    time = np.concatenate([np.cumsum(rng.uniform(1e-4, 0.2, count)) for count in rows])
    columns = iter(shapes)
    pair = lambda: np.stack([series(next(columns), time, rng), rng.normal(size=len(time))], axis=1)  # noqa: E731
    log = MotorLog(
        time=time, position_target=pair(), joint_pos=pair(), joint_vel=pair(), joint_torque=pair(),
        load_inertia=1e-3 + np.abs(pair()), external_torque=pair(), segment=np.repeat(np.arange(len(rows)), rows),
        joint_names=("a", "b"), robot="r", motor="m", source="made",
    )  # fmt: skip
    with np.errstate(all="raise", under="ignore"):
        report = check_log(log)
    for finding in report.findings:
        assert finding.row is not None and 0 <= finding.row < log.num_rows, finding
        assert np.isfinite(finding.value), finding
