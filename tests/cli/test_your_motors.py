"""Every command of docs/your-motors.md and docs/logs.md runs, on a few seconds of the real logs that the pages name."""

import gzip
import re
import shlex
import shutil
import textwrap
from collections.abc import Iterator
from contextlib import nullcontext
from itertools import islice
from pathlib import Path
from unittest.mock import Mock

import pytest
from swinging_bars import swing, write_table

from motorprior.cli.main import RUN, parse
from motorprior.commands import demo
from motorprior.identification import load_fit
from motorprior.identification.baselines import response_fit
from motorprior.identification.physics import term_selection
from motorprior.logs.column_map import load_column_map
from motorprior.logs.readers.ros_bag import CLOCK

ROOT = Path(__file__).resolve().parents[2]
ROWS = 800
"""Of each table, header included: four seconds of the Go2."""
WITH_STEPS = {"validate-log": ("--adam-steps", "4")}


class Begun(Exception):
    """The demo has come to its bench."""


def blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", (ROOT / "docs" / page).read_text("utf-8"), re.DOTALL)


def commands(page: str) -> Iterator[list[str]]:
    """The words of every `motorprior …` on a page; of a loop those of its first turn."""
    for block in blocks(page, "sh"):
        for line in re.sub(r"for (\w+) in (\S+).*?; do\n(.*?)\ndone", first_turn, block, flags=re.DOTALL).splitlines():
            if line.startswith("motorprior "):
                yield shlex.split(line)[1:]


def first_turn(loop: re.Match[str]) -> str:
    """What a shell runs first of ``for NAME in VALUE …; do``."""
    name, value, body = loop.groups()
    return textwrap.dedent(body).replace(f"${name}", value)


@pytest.fixture
def folder(shared_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the logs that the pages name, cut, and the robots' files; commands run in it."""
    for name in ("go2", "so101", "xl330"):
        if not (shared_data / name).is_dir():
            pytest.skip(f"no logs of {name}: MOTORPRIOR_SHARED names a folder with {name}/ in it")
        (tmp_path / name).mkdir()
    for path in [
        *(shared_data / "go2").glob("traj_[03].csv.gz"),
        *sorted((shared_data / "so101").glob("c*.csv.gz"))[:2],
    ]:
        with gzip.open(path, "rt") as whole, gzip.open(tmp_path / path.parent.name / path.name, "wt") as cut:
            cut.writelines(islice(whole, ROWS))
    shutil.copy(shared_data / "go2" / "traj_0.pt", tmp_path / "go2")
    for path in sorted((shared_data / "xl330").glob("*_10h2[89]m[0123]*.json.gz")):
        shutil.copy(path, tmp_path / "xl330")
    shutil.copytree(shared_data / "so101" / "original", tmp_path / "so101" / "original")
    shutil.copy(shared_data / "so101" / "chirp_sweep.csv.gz", tmp_path / "so101")
    for name in ("go2", "so101"):
        shutil.copy(shared_data / "robots" / f"{name}.xml", tmp_path)
        shutil.copy(ROOT / "examples" / "robots" / f"{name}.toml", tmp_path)
    write_table(swing(4.0), tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(load_fit, "MAX_ROUNDS", 1)
    monkeypatch.setattr(term_selection, "CANDIDATES", ())  # the terms are tested elsewhere, and take minutes
    monkeypatch.setattr(response_fit, "RESTARTS", 4)
    monkeypatch.setattr(demo, "run_bench", Mock(side_effect=Begun))
    return tmp_path


def expanded(words: list[str]) -> list[str]:
    """With the files that a pattern stands for, as a shell gives them."""
    found = []
    for word in words:
        matches = sorted(map(str, Path().glob(word))) if set("*[") & set(word) else []
        found += matches or [word]
    return found


@pytest.mark.slow
@pytest.mark.parametrize("page", ["your-motors.md", "logs.md"])
def test_every_command_of_the_page_runs(folder: Path, page: str):
    ran = 0
    for words in commands(page):
        parsed = parse([*expanded(words), *WITH_STEPS.get(words[0], ())])
        with pytest.raises(Begun) if words[0] == "demo" else nullcontext():
            RUN[type(parsed)](parsed)
        ran += 1
    assert ran >= 5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("--logs go2 --columns go2_identification --robot go2.toml --suspended", ("prior", "tuned_pd", "traj_3")),
        ("--logs go2 --columns go2_identification", ("loads: unknown", "dead band")),
        ("--logs so101 --columns so101_sage --robot so101.toml", ("rigid bodies of so101", "prior")),
        ("--logs xl330", ("loads: from the logs", "pendulum")),
    ],
)
def test_a_demo_begins_with_the_logs(folder: Path, line: str, words: tuple[str, ...]):
    parsed = parse(["demo", *line.split(), "--out", "run"])
    with pytest.raises(Begun):
        RUN[type(parsed)](parsed)
    page = (folder / "run" / "report.html").read_text("utf-8")
    assert "Your motors" in page and all(word in page for word in words), page


def test_the_column_maps_on_the_page_are_understood(tmp_path: Path):
    path = tmp_path / "columns.toml"
    path.write_text(blocks("your-motors.md", "toml")[0], "utf-8")
    known = load_column_map(path)
    assert [joint.name for joint in known.joints] == ["shoulder_pan", "shoulder_lift"]
    assert known.gain_unit == "firmware" and {joint.kp for joint in known.joints} == {16.0}
    assert known.firmware == {"profile_acceleration": 39} and known.posture == "fixed"
    path.write_text(blocks("your-motors.md", "toml")[2], "utf-8")
    bag = load_column_map(path)
    assert bag.columns_of("joint_pos", bag.joints) == ["/lowstate:motor_state[0].q"] and bag.time == CLOCK
