"""`play`: what a policy is told, what it is measured by, and a film of it, with or without OpenGL."""

import gzip
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import motorprior as mp
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.locomotion.command import Commands
from motorprior.pipeline.motor_choice import MotorChoice
from motorprior.pipeline.progress import Lines
from motorprior.pipeline.stage import locked
from motorprior.pipeline.walking.walk import Walk, run_walk
from motorprior.pipeline.watching.play import Play, _held, _measured, _notes, commands_of, run_play
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


def test_a_folder_has_one_film_at_a_time(gait_walk: Path, tmp_path: Path):
    """Another thread's folder is refused as another command's is."""
    out = tmp_path / "out"
    with locked(out), ThreadPoolExecutor(1) as other:
        film = other.submit(run_play, Play((gait_walk,), out, seconds=1.0, film="drawn"))
        with pytest.raises(ArtifactError, match="another command writes there"):
            film.result()


def test_policies_are_told_what_all_of_them_were_trained_for(gait_walk: Path, tmp_path: Path, no_encoder: None):
    fast = Walk(tmp_path / "fast", MotorChoice("pd"), iterations=1, episode_steps=5, commands=Commands((0.0, 0.7)))
    run_walk(replace(fast, workers=1))
    speeds = {}
    for name, policies in (("one", (fast.out,)), ("both", (fast.out, gait_walk))):
        played = run_play(Play(policies, tmp_path / name, seconds=3.0, film="drawn"))
        speeds[name] = played.results.value(quantity="speed", model="fast")
    assert speeds["one"] > speeds["both"] + 0.05, "told 0.7 and 0.5 m/s"
    with pytest.raises(ConfigError, match=r"forward 0\.7"):
        run_play(Play((fast.out, gait_walk), tmp_path / "c", forward=0.7, film="drawn"))


def test_a_policy_that_names_no_motors_walks_on_a_twin(tmp_path: Path, no_encoder: None):
    """Those of `train_policy` name none: their motors are no file."""
    file = tmp_path / "policy.safetensors"
    mp.train_policy(PUPPER_V2, mp.load_fleet("mixed"), iterations=1, episode_steps=5, workers=1).save(file)
    config = Play((file,), tmp_path / "out", place="twin", seconds=0.5, film="drawn")
    assert run_play(config).results.value(quantity="upright") == 1.0
    with pytest.raises(ArtifactError, match=r"which motors it walked on .* let it walk on a twin"):
        run_play(replace(config, place="own"))


def test_a_schedule_of_one_command_is_that_command(gait_walk: Path, tmp_path: Path, no_encoder: None):
    (tmp_path / "s.csv").write_text("time_s,forward_m_s,yaw_rate_rad_s\n0,0.3,0.2\n")
    usual = Play((gait_walk,), tmp_path / "a", place="twin", seconds=2.5, film="drawn")
    by_option = run_play(replace(usual, forward=0.3, yaw_rate=0.2))
    by_file = run_play(replace(usual, schedule=tmp_path / "s.csv", out=tmp_path / "b"))
    assert by_file.results == by_option.results and by_file.film.read_bytes() == by_option.film.read_bytes()
    measured = set(by_option.results.distinct("quantity"))
    assert {"speed", "speed_error", "slip", "foot_lift_mm", "lateral_share", "heading_deg_per_m"} <= measured
    assert 0.1 < by_option.results.value(quantity="speed") < 0.5


PER_METRE = {"heading_deg_per_m", "lateral_share", "slip", "transport"}


def played_by(rows: str, walk: Path, folder: Path, seconds: float = 2.5) -> Results:
    (folder / "s.csv").write_text(f"time_s,forward_m_s,yaw_rate_rad_s\n{rows}\n")
    return run_play(Play((walk,), folder / "out", schedule=folder / "s.csv", seconds=seconds, film="drawn")).results


def test_where_commands_change_there_is_no_path_to_keep_to(gait_walk: Path, tmp_path: Path, no_encoder: None):
    played = played_by("0,0.3,0\n1.75,0.1,0", gait_walk, tmp_path)
    measured = set(played.distinct("quantity"))
    assert not {"lateral_share", "heading_deg_per_m", "speed_error"} & measured
    assert {"slip", "transport", "dragged_steps"} <= measured, "it never stands"


@pytest.mark.parametrize("rows", ["0,0.2,0\n1.25,-0.2,0", "0,0.4,0\n1.25,0,0", "0,0,0.6\n1.25,0,-0.6"])
def test_where_a_robot_goes_back_and_forth_or_stands_nothing_is_told_per_metre_or_by_the_mean_command(
    gait_walk: Path, tmp_path: Path, no_encoder: None, rows: str
):
    """The first one's mean is 0 but for rounding: what is off over it was 8e15."""
    played = played_by(rows, gait_walk, tmp_path)
    assert not {"speed_error", *PER_METRE} & set(played.distinct("quantity"))
    off = played.where(quantity="speed_off").rows[0]
    assert off.unit == "m/s" and 0.0 < off.value < 0.3


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


def test_a_robot_told_to_stop_stops(gait_walk: Path, tmp_path: Path):
    (tmp_path / "s.csv").write_text("time_s,forward_m_s,yaw_rate_rad_s\n0.5,0.4,0\n1.5,0,0.1\n")
    told = commands_of(Play((gait_walk,), schedule=tmp_path / "s.csv"), PUPPER_V2).schedule(PUPPER_V2, 7, 200)
    wanted = np.repeat([(0.0, 0.0), (0.4, 0.0), (0.0, 0.1)], [50, 100, 50], axis=0)
    np.testing.assert_array_equal(told, wanted)


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


def test_lines_of_a_packed_schedule_are_those_of_its_text(tmp_path: Path):
    path = tmp_path / "plan.csv.gz"
    path.write_bytes(gzip.compress(b"time_s,forward_m_s,yaw_rate_rad_s\n\n0,9,0\n"))
    with pytest.raises(ConfigError, match="line 3: forward_m_s 9"):
        read_schedule(path, PUPPER_V2)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"forward": 0.7}, ("forward 0.7", "0.5")),
        ({"yaw_rate": -2.0}, ("yaw_rate -2.0", "0.6")),
        ({"forward": 0.1, "schedule": Path("s.csv")}, ("schedule", "forward")),
        ({"seconds": 0.0}, ("seconds",)),
        ({"policies": ()}, ("0 policies", "1 to 4")),
        ({"policies": (Path("nowhere"),)}, ("nowhere",)),
    ],
)
def test_what_cannot_be_played_is_refused(gait_walk: Path, tmp_path: Path, change: dict, words: tuple[str, ...]):
    config = replace(Play((gait_walk,), tmp_path / "out"), **change)
    with pytest.raises(Exception) as error:
        run_play(config)
    assert [word for word in words if word not in str(error.value)] == []
    assert not (tmp_path / "out").exists()


def test_a_folder_of_several_seeds_is_refused_with_a_policy_in_it(gait_walk: Path, tmp_path: Path):
    walks = tmp_path / "walks"
    for seed in (3, 4):
        shutil.copytree(gait_walk, walks / f"seed_{seed}")
    with pytest.raises(ConfigError, match="in 2 folders of seeds below") as error:
        run_play(Play((walks,), tmp_path / "out"))
    assert str(walks / "seed_3" / "policy.safetensors") in str(error.value) and not (tmp_path / "out").exists()
    shutil.copy(gait_walk / "policy.safetensors", walks)
    assert run_play(Play((walks,), tmp_path / "out", seconds=0.2, film="drawn")).steps == {"walks": 20}


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


def test_without_a_screen_there_is_no_window(gait_walk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    with pytest.raises(ConfigError, match="no screen") as error:
        run_play(Play((gait_walk,), tmp_path / "a", viewer=True))
    assert error.value.argument == "viewer" and not (tmp_path / "a").exists()


def test_a_robot_that_fell_lies_still_until_the_end_of_the_film():
    trace = np.array([[0.0] * 19, [0.2] + [0.0] * 18])
    np.testing.assert_array_equal(_held(trace, 4)[:, 0], [0.0, 0.2, 0.2, 0.2])
    fell = Episode(0.0, 2, 0.0, np.zeros(2), 0, 2, np.zeros(1), np.zeros(1), trace, np.zeros((0, 30)))
    notes = _notes(PUPPER_V2, fell, _held(trace, 4), np.full((4, 2), 0.1))
    assert [note.endswith("fell") for note in notes] == [False, False, True, True]
    assert "told 0.10 m/s" in notes[1] and "0.01 s    0.20 m" in notes[1]


def test_the_way_of_the_film_is_along_the_robots_heading():
    """Half a circle of 1 m around, at whose end it is 0.64 m to the left of where it began."""
    steps = 400
    yaw = np.pi * np.arange(steps) / (steps - 1)
    trace = np.zeros((steps, 19))
    trace[:, 3], trace[:, 6] = np.cos(yaw / 2), np.sin(yaw / 2)
    trace[1:, 0], trace[1:, 1] = (np.cumsum(each[:-1]) / (steps - 1) for each in (np.cos(yaw), np.sin(yaw)))
    walked = Episode(0.0, steps, 0.0, np.zeros(2), 0, steps, np.zeros(1), np.zeros(1), trace, np.zeros((0, 30)))
    assert abs(trace[-1, 0]) < 0.01
    assert "1.00 m" in _notes(PUPPER_V2, walked, trace, np.zeros((steps, 2)))[-1]
