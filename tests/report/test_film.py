"""Films: pictures one under the other, in an endless GIF or an MP4."""

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from motorprior.report.film import can_write_mp4, gif_bytes, labelled, stacked, write_mp4

RED, BLUE = Image.new("RGB", (64, 48), "red"), Image.new("RGB", (64, 32), "blue")


def test_walks_stand_one_under_the_other_as_long_as_all_have_pictures():
    pictures = list(stacked([[RED, RED, RED], [BLUE, BLUE]]))
    assert [picture.size for picture in pictures] == [(64, 80), (64, 80)]
    assert pictures[0].getpixel((5, 47)) == (255, 0, 0) and pictures[0].getpixel((5, 48)) == (0, 0, 255)


def test_a_gif_takes_pictures_one_by_one_and_repeats_for_ever():
    colours = (Image.new("RGB", (32, 32), "white" if i % 2 else "black") for i in range(5))
    with Image.open(BytesIO(gif_bytes(colours, 0.04))) as image:
        assert image.n_frames == 5  # pyright: ignore[reportAttributeAccessIssue]
        assert (image.info["duration"], image.info["loop"]) == (40, 0)


def test_a_label_leaves_the_robot_alone():
    frame = np.full((2 * 288, 480, 3), 77, np.uint8)
    image = np.asarray(labelled(frame, ["one", "two"], ["1 s", "2 s"]))
    for top in (0, 288):
        assert (image[top + 60 : top + 288] == 77).all()
        assert image[top : top + 58].min() < 60 and image[top : top + 58].max() == 255


def test_an_mp4_where_its_encoder_is_installed(tmp_path: Path):
    if not can_write_mp4():
        pytest.skip("imageio-ffmpeg is not installed: pip install 'motorprior[video]'")
    write_mp4(tmp_path / "half-written.tmp", (RED for _ in range(5)), 0.04)
    assert (tmp_path / "half-written.tmp").read_bytes()[4:8] == b"ftyp"
