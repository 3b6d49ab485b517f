"""The key ``center`` of a column map: the column value at the joint angle ``zero``."""

from pathlib import Path

import numpy as np
import pytest

import motorprior as mp


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("place", ["units", "joint"])
def test_ticks_count_from_the_center(sign: int, place: str, tmp_path: Path):
    angle = 0.3 * np.sin(np.arange(400) / 20.0)
    ticks = sign * (angle - 0.1) * 4096 / (2.0 * np.pi) + 2048.0
    table = np.column_stack([0.01 * np.arange(400), ticks, ticks, 0.0 * ticks])
    names = "t,goal_a,pos_a,vel_a"
    np.savetxt(tmp_path / "run.csv", table, delimiter=",", header=names, comments="", fmt="%.6f")

    center = {"units": "", "joint": ""} | {place: "center = 2048\n"}
    (tmp_path / "columns.toml").write_text(
        'motor = "servo"\ntime = "t"\nposition_target = "goal_{joint}"\njoint_pos = "pos_{joint}"\n'
        'joint_vel = "vel_{joint}"\n'
        f'[units]\nangle = "tick"\nticks_per_turn = 4096\n{center["units"]}'
        f"[joints.a]\nsign = {sign}\nzero = 0.1\n{center['joint']}",
        "utf-8",
    )
    log = mp.read_log(tmp_path / "run.csv", columns=tmp_path / "columns.toml")

    np.testing.assert_allclose(log.joint_pos[:, 0], angle, atol=1e-6)
    assert log.joint_vel is not None
    np.testing.assert_array_equal(log.joint_vel, 0.0)
