"""The film of a planned motion."""

from pathlib import Path

import numpy as np
from PIL import Image

from motorprior.progress import SILENT
from motorprior.report import motion_film
from motorprior.robots.servos import MotionPart
from motorprior.robots.so101.robot import SO101


def test_a_film_has_a_picture_per_fifth_of_a_second_and_moves(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(motion_film, "can_write_mp4", lambda: False)
    targets = np.tile(SO101.nominal_pose, (100, 1))
    targets[:, 0] = np.linspace(-1.0, 1.0, 100)

    path = motion_film.write_motion_film(
        tmp_path, SO101, [MotionPart("turn", targets)], 0.01, SILENT
    )

    film = Image.open(path)
    first = np.asarray(film.convert("L"), dtype=float)
    film.seek(4)
    last = np.asarray(film.convert("L"), dtype=float)

    assert getattr(film, "n_frames", 0) == 5
    assert np.abs(first - last)[60:].max() > 50, "below the title"
