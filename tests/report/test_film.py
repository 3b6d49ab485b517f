"""Films of a walk: rendered or as stick figures, in an endless GIF or an MP4."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from motorprior.report.film import can_write_mp4, film, write_mp4
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.rendering import HEIGHT, WIDTH
from motorprior.simulation.scene import Episode


def walk(fell: int) -> Episode:
    qpos = np.zeros((3, 19))
    nothing = np.zeros(0)
    qpos[:, 2] = PUPPER_V2.standing_height
    qpos[:, 3] = 1.0
    qpos[:, 7:] = PUPPER_V2.nominal_pose
    qpos[1:, 8] += 0.5
    return Episode(0.0, fell, 0.0, np.zeros(2), 0, nothing, nothing, qpos, nothing)


@pytest.mark.parametrize("library", ["disable", None])
def test_walks_are_stacked_labelled_and_move(library: str | None, monkeypatch: pytest.MonkeyPatch):
    if library:
        monkeypatch.setenv("MUJOCO_GL", library)
    notes: list[str] = []
    pictures = list(film(PUPPER_V2, {"one": walk(3), "two": walk(0)}, 3, 1, notes.append))
    assert len(notes) == 1 or not library
    frames = np.array([np.asarray(picture, int) for picture in pictures])
    assert frames.shape == (3, 2 * HEIGHT, WIDTH, 3)
    upper = frames[:, :HEIGHT]
    lower = frames[:, HEIGHT:]
    assert np.abs(upper - lower)[:, 60:].max() < 10 < np.abs(upper - lower)[:, :60].max()
    robot = upper[:, 60:]
    assert np.abs(robot[0] - robot[1]).max() > 40 and np.abs(robot[1] - robot[2]).max() < 10


def test_an_mp4_where_its_encoder_is_installed(tmp_path: Path):
    if not can_write_mp4():
        pytest.skip("imageio-ffmpeg is not installed: pip install 'motorprior[video]'")
    write_mp4(
        tmp_path / "half-written.tmp", (Image.new("RGB", (64, 48), "red") for _ in range(5)), 0.04
    )
    assert (tmp_path / "half-written.tmp").read_bytes()[4:8] == b"ftyp"
