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
    empty = np.zeros(0)
    qpos[:, 2] = PUPPER_V2.standing_height
    qpos[:, 3] = 1.0
    qpos[:, 7:] = PUPPER_V2.nominal_pose
    qpos[1:, 8] += 0.5

    return Episode(0.0, fell, 0.0, np.zeros(2), 0, empty, empty, qpos, empty)


@pytest.mark.parametrize("library", ["disable", None])
def test_walks_are_drawn_one_below_the_other_with_labels(
    library: str | None, monkeypatch: pytest.MonkeyPatch
):
    if library:
        monkeypatch.setenv("MUJOCO_GL", library)

    notes: list[str] = []
    pictures = list(film(PUPPER_V2, {"one": walk(3), "two": walk(0)}, 3, 1, notes.append))

    assert len(notes) == 1 or not library

    frames = np.array([np.asarray(picture, int) for picture in pictures])

    assert frames.shape == (3, 2 * HEIGHT, WIDTH, 3)

    upper = frames[:, :HEIGHT]
    lower = frames[:, HEIGHT:]
    difference = np.abs(upper - lower)

    assert difference[:, 60:].max() < 10, "one walk"
    assert difference[:, :60].max() > 10, "two labels, in the upper 60 rows"

    robot = upper[:, 60:]

    assert np.abs(robot[0] - robot[1]).max() > 40
    assert np.abs(robot[1] - robot[2]).max() < 10


def test_a_film_is_written_as_mp4(tmp_path: Path):
    if not can_write_mp4():
        pytest.skip("imageio-ffmpeg is not installed: pip install imageio-ffmpeg")

    path = tmp_path / "half-written.tmp"
    pictures = [Image.new("RGB", (64, 48), "red") for _ in range(5)]

    write_mp4(path, iter(pictures), 0.04)

    assert path.read_bytes()[4:8] == b"ftyp"
