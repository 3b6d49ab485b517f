"""Every command of docs/your-motors.md, logs.md and your-robot.md runs in a small size."""

import gzip
import re
import shlex
import shutil
import textwrap
import tomllib
from collections.abc import Iterator
from contextlib import chdir, nullcontext, suppress
from itertools import islice
from pathlib import Path
from unittest.mock import patch

import pytest
from swinging_bars import bars_table, swing

from motorprior.cli.parse import parse
from motorprior.cli.terminal import TERMINAL
from motorprior.commands import demo
from motorprior.locomotion.policy import Policy
from motorprior.logs.column_map import load_column_map

ROOT = Path(__file__).resolve().parents[2]
ROWS = 800
"""Lines that are kept of a table, header included: four seconds of the Go2."""
SMALL = {
    "walk": "--iterations 2 --episode-steps 40 --workers 1 "
    "--search.num-directions 4 --search.num-top-directions 2",
    "bench": "--motors 12 --steps 1500",
    "simulate": "--seconds 2",
    "adapt": "--allow-outliers",
    "replay": "--samples 2",
    "validate": "--adam-steps 4",
}
"""Options that make a command small enough for a test."""


class Begun(Exception):
    """The demo has reported on the logs and begins its bench."""


def blocks(page: str, language: str, chapter: str = "") -> list[str]:
    """Code blocks of a language on a page of the documentation, or in one of its chapters."""
    text = (ROOT / "docs" / page).read_text("utf-8")
    if chapter:
        text = text.split(f"\n## {chapter}\n")[1].split("\n## ")[0]
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


def commands(page: str, chapter: str = "") -> Iterator[list[str]]:
    """Words of the `motorprior …` commands on a page; a loop is run once, with its first value."""
    loop = re.compile(r"for (\w+) in (\S+).*?; do\n(.*?)\ndone", re.DOTALL)
    for block in blocks(page, "sh", chapter):
        for line in loop.sub(first_turn, block).splitlines():
            if line.startswith("motorprior "):
                yield shlex.split(line)[1:]


def first_turn(loop: re.Match[str]) -> str:
    """The body of ``for NAME in VALUE …; do`` with the first value."""
    name, value, body = loop.groups()
    return textwrap.dedent(body).replace(f"${name}", value)


def run(words: list[str]) -> None:
    """Run a command; patterns are replaced by the matching files, as a shell does."""
    expanded = []
    for word in words:
        files = []
        if set("*[") & set(word):
            files = sorted(map(str, Path().glob(word)))
        expanded += files or [word]

    command, settings = parse([*expanded, *shlex.split(SMALL.get(words[0], ""))])
    command.load_run()(settings, TERMINAL)


@pytest.fixture
def robots(shared_data: Path, tmp_path: Path) -> Iterator[Path]:
    """A folder with two models and the examples' descriptions of them; commands run in it."""
    for name in ("go2",):
        shutil.copy(shared_data / "robots" / f"{name}.xml", tmp_path)
        for description in (ROOT / "examples" / "robots").glob(f"{name}*.toml"):
            shutil.copy(description, tmp_path)
    with chdir(tmp_path):
        yield tmp_path


@pytest.fixture
def folder(shared_data: Path, robots: Path) -> Iterator[Path]:
    """The folder of the robots with the logs that the pages name, shortened."""
    for name in ("go2", "so101", "xl330"):
        (robots / name).mkdir()

    tables = [
        *(shared_data / "go2").glob("traj_[03].csv.gz"),
        *sorted((shared_data / "so101").glob("c*.csv.gz"))[:2],
    ]

    for path in tables:
        with (
            gzip.open(path, "rt") as whole,
            gzip.open(robots / path.parent.name / path.name, "wt") as cut,
        ):
            cut.writelines(islice(whole, ROWS))

    shutil.copy(shared_data / "go2" / "traj_0.pt", robots / "go2")

    for path in sorted((shared_data / "xl330").glob("*_10h2[89]m[0123]*.json.gz")):
        shutil.copy(path, robots / "xl330")

    shutil.copytree(shared_data / "so101" / "original", robots / "so101" / "original")
    shutil.copy(shared_data / "so101" / "chirp_sweep.csv.gz", robots / "so101")
    bars_table(swing(4.0), robots)

    with patch.object(demo, "record_benches", side_effect=Begun):
        yield robots


@pytest.mark.slow
@pytest.mark.parametrize("page", ["your-motors.md", "logs.md"])
def test_every_command_on_logs_runs(folder: Path, page: str):
    commands_of_page = list(commands(page))

    assert len(commands_of_page) >= 5

    for words in commands_of_page:
        with suppress(Begun):
            run(words)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "walks", "words"),
    [
        (
            "--logs go2 --columns go2_identification --robot go2.toml --suspended",
            True,
            ("prior", "tuned PD", "traj_3"),
        ),
        ("--logs go2 --columns go2_identification", False, ("loads: unknown", "dead_band")),
        (
            "--logs so101 --columns so101_sage --robot so101",
            False,
            ("rigid bodies of so101", "prior"),
        ),
        ("--logs xl330", False, ("loads: from the log", "pendulum")),
    ],
)
def test_a_demo_reports_on_the_logs_and_goes_on_if_their_robot_walks(
    folder: Path, line: str, walks: bool, words: tuple[str, ...]
):
    with pytest.raises(Begun) if walks else nullcontext():
        run(["demo", *line.split(), "--out", "run"])

    page = (folder / "run" / "report.html").read_text("utf-8")

    assert "Your motors" in page
    assert all(word in page for word in words)


def test_a_users_quadruped_walks_on_a_pd_and_on_sampled_motors_and_in_the_report(
    robots: Path,
):
    chapter = list(commands("your-robot.md", "A legged robot"))
    names = [words[0] for words in chapter]

    assert names == ["walk", "bench", "identify", "walk", "report", "transfer"]

    for words in chapter:
        run(words)

    policy = Policy.load(robots / "runs" / "walk" / "rollout_0" / "policy.safetensors")

    assert policy.robot == "go2"
    assert policy.arrays.weights.shape == (17, 24)

    page = (robots / "runs" / "walk" / "report.html").read_text("utf-8")

    assert "Robot go2" in page
    assert "data:image/gif" in page
    assert (robots / "runs" / "transfer" / "figures.json").is_file()


@pytest.mark.slow
def test_an_arm_goes_through_bench_identify_adapt_and_simulate(robots: Path):
    chapter = list(commands("your-robot.md", "An arm"))
    names = [words[0] for words in chapter]

    assert names == ["bench", "identify", "simulate", "logs", "adapt", "simulate", "replay"]

    for words in chapter:
        run(words)

    assert (robots / "runs" / "arm" / "simulated" / "log.parquet").is_file()
    assert (robots / "runs" / "arm" / "replay" / "figures.json").is_file()


def test_the_robot_description_on_the_page_equals_the_example():
    shown = tomllib.loads(blocks("your-robot.md", "toml")[0])
    example = tomllib.loads((ROOT / "examples" / "robots" / "go2.toml").read_text("utf-8"))
    legs = shown.pop("legs")

    assert legs["FL"] == example["legs"]["FL"]
    assert shown == {name: value for name, value in example.items() if name != "legs"}


def test_the_column_maps_on_the_page_can_be_loaded(tmp_path: Path):
    path = tmp_path / "columns.toml"
    for index in (0, 2):  # of a table and of a bag
        path.write_text(blocks("your-motors.md", "toml")[index], "utf-8")
        assert load_column_map(path).joints
