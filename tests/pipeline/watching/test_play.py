"""`play`: what a policy is told, what it is measured by, and a film of it, with or without OpenGL."""

from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from motorprior.exceptions import ConfigError
from motorprior.pipeline.progress import Lines
from motorprior.pipeline.watching.play import Play, _held, _measured, _notes, run_play
from motorprior.pipeline.watching.schedule_file import read_schedule
from motorprior.report import film
from motorprior.results import Results
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.rollout import Episode


@pytest.fixture
def no_encoder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(film, "can_write_mp4", lambda: False)


def frames_of(path: Path) -> tuple[int, tuple[int, int]]:
    with Image.open(path) as image:
        return image.n_frames, image.size  # pyright: ignore[reportAttributeAccessIssue]


def test_two_policies_are_one_under_the_other_in_a_film_that_repeats_exactly(
    gait_walk: Path, tmp_path: Path, no_encoder: None
):
    config = Play((gait_walk, gait_walk / "policy.safetensors"), tmp_path / "a", forward=0.2, seconds=1.0, film="drawn")
    first, second = run_play(config), run_play(replace(config, out=tmp_path / "b"))
    assert first.film.read_bytes() == second.film.read_bytes()
    assert frames_of(first.film) == (20, (480, 2 * 288))
    assert set(first.steps) == {"gait_0", "gait_0 (2)"}
    assert [(row.quantity, row.value) for row in first.results] == 2 * [("upright", 1.0)], "too short for the rest"
    assert (tmp_path / "a" / "figures.json").is_file()


PER_METRE = {"heading_deg_per_m", "lateral_share", "slip", "transport"}


def played_by(rows: str, walk: Path, folder: Path, seconds: float = 2.5) -> Results:
    (folder / "s.csv").write_text(f"time_s,forward_m_s,yaw_rate_rad_s\n{rows}\n")
    return run_play(Play((walk,), folder / "out", schedule=folder / "s.csv", seconds=seconds, film="drawn")).results


def test_where_commands_change_there_is_no_path_to_keep_to(gait_walk: Path, tmp_path: Path, no_encoder: None):
    played = played_by("0,0.3,0\n1.75,0.1,0", gait_walk, tmp_path)
    measured = set(played.distinct("quantity"))
    assert not {"lateral_share", "heading_deg_per_m", "speed_error"} & measured
    assert {"slip", "transport", "dragged_steps"} <= measured, "it never stands"


def test_a_turn_on_the_spot_is_told_nothing_per_metre(gait_walk: Path, tmp_path: Path, no_encoder: None):
    played = run_play(Play((gait_walk,), tmp_path / "a", forward=0.0, yaw_rate=0.6, seconds=2.5, film="drawn"))
    measured = set(played.results.distinct("quantity"))
    assert not {"speed_error", "speed_off", *PER_METRE} & measured and {"upright", "speed", "foot_lift_mm"} <= measured


def test_how_far_off_a_schedule_is_counts_the_command_in_force():
    """It is the mean that the walk itself has kept, in m/s."""
    told = np.repeat([(0.2, 0.0), (-0.2, 0.0)], 100, axis=0)
    trace, motion = np.zeros((200, 19)), np.zeros((200, 30))
    trace[:, 3] = 1.0
    walked = Episode(0.0, 200, 0.1, np.zeros(2), 0, 200, np.zeros(1), np.zeros(1), trace, motion)
    found = _measured(Play(()), PUPPER_V2, "walk", walked, told)
    assert found.value(quantity="speed_off") == 0.1 and not found.where(quantity="speed_error")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time_s,forward_m_s,yaw_rate_rad_s\n0,0.1,0\n1,fast,0\n", ("line 3", "forward_m_s", "fast")),
        ("time_s,forward_m_s,yaw_rate_rad_s\n0,0.1,0\n\n1,fast,0\n", ("line 4", "forward_m_s", "fast")),
        ("time_s,forward_m_s,yaw_rate_rad_s\n0,0.1,0\n1,0.1\n", ("line 3 has 2 cells",)),
        ("time_s,forward_m_s,yaw_rate_rad_s\r\n0,0.1,0\r\n\r\n1,9,0\r\n", ("line 4", "forward_m_s 9")),
        ("time_s,forward_m_s,yaw_rate_rad_s\n0,0.1,0\n1,9,0\n", ("line 3", "forward_m_s 9", "-0.2 to 0.5")),
        ("time_s,forward_m_s,yaw_rate_rad_s\n0,0.1,nan\n", ("line 2", "yaw_rate_rad_s nan", "0.6")),
        ("time_s,forward_m_s,yaw_rate_rad_s\n0,0.1,0\n0,0.2,0\n", ("line 3", "time_s 0", "not after")),
        ("time_s,forward_m_s,yaw_rate_rad_s\n-1,0.1,0\n", ("line 2", "time_s -1")),
        ("time,forward_m_s,yaw_rate_rad_s\n0,0.1,0\n", ("'time'", "time_s")),
        ('time_s,forward_m_s,yaw_rate_rad_s\n0,0.1,0\n1,"0.2,0\n', ("a quote is opened in line 3",)),
        ('time_s,forward_m_s,yaw_rate_rad_s\n0,0.1,0\n1,"0.\n2",0\n', ("the rows from line 2",)),
        ("time_s,forward_m_s,row 99\n0,0.1,0\n", ("'row 99'",)),
        ("time_s,forward_m_s,yaw_rate_rad_s\n", ("no rows",)),
    ],
)
def test_a_schedule_that_is_none_is_refused_by_file_line_and_value(tmp_path: Path, text: str, words: tuple[str, ...]):
    (tmp_path / "plan.csv").write_text(text)
    with pytest.raises(ConfigError) as error:
        read_schedule(tmp_path / "plan.csv", PUPPER_V2)
    assert [word for word in ("plan.csv", *words) if word not in str(error.value)] == []
    assert error.value.remedy


def test_without_opengl_the_film_is_drawn_and_that_is_said(
    gait_walk: Path, tmp_path: Path, no_encoder: None, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("MUJOCO_GL", "nothing")
    said = StringIO()
    config = Play((gait_walk,), tmp_path / "a", seconds=0.2)
    played = run_play(config, Lines(said))
    assert "drawn as lines" in said.getvalue() and frames_of(played.film) == (4, (480, 288))
    with pytest.raises(ConfigError, match=r"cannot draw here \(.*nothing"):
        run_play(replace(config, film="rendered"))


def test_a_robot_that_fell_lies_still_until_the_end_of_the_film():
    trace = np.array([[0.0] * 19, [0.2] + [0.0] * 18])
    np.testing.assert_array_equal(_held(trace, 4)[:, 0], [0.0, 0.2, 0.2, 0.2])
    fell = Episode(0.0, 2, 0.0, np.zeros(2), 0, 2, np.zeros(1), np.zeros(1), trace, np.zeros((0, 30)))
    notes = _notes(PUPPER_V2, fell, _held(trace, 4), np.full((4, 2), 0.1))
    assert [note.endswith("fell") for note in notes] == [False, False, True, True]
    assert "told 0.10 m/s" in notes[1] and "0.01 s    0.20 m" in notes[1]
