"""Every command of docs/your-robot.md runs, on the published models; its description is the example's."""

import re
import shlex
import shutil
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from motorprior.cli.main import RUN, parse
from motorprior.identification.physics import term_selection
from motorprior.locomotion.policy import Policy

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "your-robot.md").read_text("utf-8")
SMALL = {
    "walk": "--iterations 2 --episode-steps 40 --search.num-directions 4 --search.num-top-directions 2 --workers 1",
    "bench": "--motors 12 --steps 1500",
    "simulate": "--seconds 2",
    "adapt": "--anyway",
    "replay": "--draws 2",
}
"""What makes a command small enough for a test."""


def commands(title: str) -> Iterator[list[str]]:
    chapter = PAGE.split(f"\n## {title}\n")[1].split("\n## ")[0]
    for block in re.findall(r"```sh\n(.*?)```", chapter, re.DOTALL):
        for line in block.splitlines():
            words = shlex.split(line)
            assert words[0] == "motorprior"
            yield words[1:]


@pytest.fixture
def folder(shared_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The two models with the examples' descriptions beside them, and the present folder of the commands."""
    for name in ("go2", "so101"):
        model = shared_data / "robots" / f"{name}.xml"
        if not model.is_file():
            pytest.skip(f"no {name}.xml: MOTORPRIOR_SHARED names a folder with robots/{name}.xml in it")
        for path in (model, *(ROOT / "examples" / "robots").glob(f"{name}*.toml")):
            shutil.copy(path, tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(term_selection, "CANDIDATES", ())  # the terms are tested elsewhere, and take minutes
    return tmp_path


def run(words: list[str]) -> None:
    config = parse([*words, *shlex.split(SMALL.get(words[0], ""))])
    RUN[type(config)](config)


def test_a_users_quadruped_walks_on_a_pd_and_on_sampled_motors_and_the_report_draws_it(folder: Path):
    names = [words[0] for words in commands("A legged robot")]
    assert names == ["walk", "bench", "identify", "walk", "report", "transfer"]
    for words in commands("A legged robot"):
        run(words)
    policy = Policy.load(folder / "runs" / "walk" / "rollout_0" / "policy.safetensors")
    assert policy.robot == "go2" and policy.arrays.weights.shape == (17, 24)
    page = (folder / "runs" / "walk" / "report.html").read_text("utf-8")
    assert "Robot go2" in page and "data:image/gif" in page
    assert (folder / "runs" / "transfer" / "figures.json").is_file()


@pytest.mark.slow
def test_an_arm_goes_through_bench_identify_adapt_and_simulate(folder: Path):
    names = [words[0] for words in commands("An arm")]
    assert names == ["bench", "identify", "simulate", "logs", "adapt", "simulate", "replay"]
    for words in commands("An arm"):
        run(words)
    assert (folder / "runs" / "arm" / "simulated" / "log.parquet").is_file()
    assert (folder / "runs" / "arm" / "replay" / "figures.json").is_file()


def test_the_description_on_the_page_is_that_of_the_example():
    shown = tomllib.loads(re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)[0])
    example = tomllib.loads((ROOT / "examples" / "robots" / "go2.toml").read_text("utf-8"))
    legs = shown.pop("legs")
    assert legs["FL"] == example["legs"]["FL"]
    assert shown == {name: value for name, value in example.items() if name != "legs"}
