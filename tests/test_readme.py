"""Every command in the README, CONTRIBUTING and docs/ exists; it is checked without being run."""

import json
import re
import shlex
import tomllib
from collections.abc import Iterator
from contextlib import chdir
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from motor_logs import TABLE_MAP, write_table
from weighed_arm import JOINTS, arm_table, slow_motion, write_arm

import motorprior as mp
from motorprior.actuator.fleet import load_fleet
from motorprior.excitation.robot_targets import excitation_targets
from motorprior.robots.load import load_robot
from motorprior.simulation.playback import simulated_log

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
TUTORIALS = sorted((ROOT / "tutorials").glob("*.ipynb"))
FENCE = re.compile(r"^ *(```+|~~~+) *(\w*)[^\n]*\n(.*?)^ *\1 *$", re.MULTILINE | re.DOTALL)
# programs and words of the shell that are not checked
UNCHECKED = {"cd", "git", "pre-commit", "for", "do", "done", "echo", "sudo"}


def commands(text: str) -> Iterator[list[str]]:
    """Words of the commands in the ```sh blocks, without comments, prompts and redirections."""
    blocks = FENCE.findall(text)
    num_opened = len(re.findall(r"^ *(?:```+|~~~+) *sh\b", text, re.MULTILINE))
    num_closed = [language for _, language, _ in blocks].count("sh")

    assert num_opened == num_closed, "a ```sh block is not closed"

    for _, language, block in blocks:
        assert language not in {"bash", "console", "shell", "zsh"}, f"{language}: use ```sh"
        if language == "sh":
            for line in block.replace("\\\n", " ").splitlines():
                yield from commands_of_line(line)


def commands_of_line(line: str) -> Iterator[list[str]]:
    """Commands of one line, which ; & and | separate; leading NAME=VALUE words are left out."""
    lexer = shlex.shlex(line.strip().removeprefix("$ "), posix=True, punctuation_chars=True)
    lexer.whitespace_split = True
    command: list[str] = []

    for word in [*lexer, ";"]:
        if word and set(word) <= set(";&|"):
            if command:
                yield list(takewhile(is_no_redirection, command))
            command = []
        elif command or not re.match(r"\w+=", word):
            command.append(word)


def is_no_redirection(word: str) -> bool:
    return not word or not set(word) <= set("<>")


def parses(args: list[str]) -> None:
    from motorprior.cli.parse import parse

    try:
        parse(args)
    except SystemExit as stop:  # --help leaves with 0
        assert not stop.code, f"motorprior {shlex.join(args)} does not parse"
    except mp.ConfigError as error:  # an unknown option
        raise AssertionError(f"motorprior {shlex.join(args)}: {error}") from error


def make_succeeds(args: list[str]) -> None:
    makefile = (ROOT / "Makefile").read_text("utf-8")
    targets = set(re.findall(r"^([\w.-]+)\s*:(?!=)", makefile, re.MULTILINE))
    goals = [word for word in args if "=" not in word and not word.startswith("-")]

    assert set(goals) <= targets, f"the Makefile makes {sorted(targets)}"

    if "demo" in goals:
        options = []
        for word in args:
            if word.startswith("ARGS="):
                options += shlex.split(word.removeprefix("ARGS="))
        parses(["demo", *options])


def installs(args: list[str]) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    for names in re.findall(r"\[(.*?)\]", " ".join(args)):
        extras = set(names.split(","))
        assert extras <= set(project["optional-dependencies"]), f"an extra of {args} does not exist"


def runs_python(args: list[str]) -> None:
    if args[:2] == ["-m", "pip"]:
        return installs(args[2:])
    assert args[:1] == ["-m"] or (ROOT / args[0]).is_file(), f"no file {args[0]}"


CHECKS = {
    "motorprior": parses,
    "make": make_succeeds,
    "pip": installs,
    "python": runs_python,
    "python3": runs_python,
}


def check(command: list[str]) -> None:
    program = command[0].removeprefix(".venv/bin/")

    assert program in CHECKS or program in UNCHECKED, f"no check for `{shlex.join(command)}`"

    if program in CHECKS:
        CHECKS[program](command[1:])


def text_of(page: Path) -> str:
    """Text of a page, or of the Markdown cells of a notebook."""
    text = page.read_text("utf-8")
    if page.suffix != ".ipynb":
        return text
    cells = json.loads(text)["cells"]
    return "\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "markdown")


def page_commands() -> Iterator[Any]:
    for page in [*PAGES, *TUTORIALS]:
        if page.is_file():
            for words in commands(text_of(page)):
                yield pytest.param(words, id=f"{page.name}: {shlex.join(words)}")


@pytest.mark.parametrize("words", list(page_commands()))
def test_every_command_of_a_page_exists(words: list[str]):
    check(words)


def library_code() -> str:
    """The first Python block of the section "As a library" of the README."""
    section = (ROOT / "README.md").read_text("utf-8").partition("## As a library")[2]
    return next(block for _, language, block in FENCE.findall(section) if language == "python")


def test_the_library_section_runs_in_a_small_size(tmp_path: Path):
    code = library_code()
    sizes = {
        "steps=5_000": "steps=300",
        "motors=8": "motors=3",
        'preset="rollout"': 'preset="paper"',
        'preset="quick"': 'preset="paper"',
        'out="runs/my_prior"': 'out="runs/my_prior", steps=2',
        "iterations=200": "iterations=1, episode_steps=5",
    }

    for shown, small in sizes.items():
        assert shown in code
        code = code.replace(shown, small)

    names: dict = {}
    with chdir(tmp_path):
        exec(code, names)

    assert names["torque"].shape == (12,)
    assert np.all(np.abs(names["torque"]) > 0.0), "the loop is longer than the delay"
    assert {row.quantity for row in names["table"]} == {"speed", "upright", "drift"}


NUMBER = re.compile(r"\d+(\.\d+)?(e-?\d+)?")


def test_a_motor_in_ten_seconds_prints_what_the_page_shows(capsys: pytest.CaptureFixture):
    section = (ROOT / "README.md").read_text("utf-8").partition("## A motor in ten seconds")[2]
    (_, _, code), (_, language, shown), *_ = FENCE.findall(section)

    exec(code, {})
    printed = capsys.readouterr().out

    assert language == "text"
    # cards may be fitted again, so numbers may change
    assert NUMBER.sub("#", printed) == NUMBER.sub("#", shown)


def test_the_readme_can_be_read_in_a_few_minutes():
    assert len((ROOT / "README.md").read_text("utf-8").split()) <= 900


@pytest.mark.slow
def test_the_section_on_your_log_runs(tmp_path: Path):
    section = (ROOT / "README.md").read_text("utf-8").partition("## Your log")[2]
    code = next(block for _, language, block in FENCE.findall(section) if language == "python")
    robot = Path(write_arm(tmp_path))
    table, _ = arm_table(slow_motion(str(robot)), tmp_path)
    robot.rename(tmp_path / "my_robot.toml")
    table.rename(tmp_path / "run.csv")

    names: dict = {"mp": mp}
    with chdir(tmp_path):
        exec(code, names)

    assert names["prior"].joint_names == JOINTS
    assert (tmp_path / "runs" / "mine" / "prior.safetensors").is_file()


def test_no_text_installs_motorprior_from_an_index_that_does_not_have_it():
    paths = [*PAGES, *TUTORIALS]
    for folder in ("src", "examples", "benchmarks"):
        paths += sorted((ROOT / folder).rglob("*.py"))

    for path in paths:
        line = re.search(r"pip install ['\"]?motorprior(?!-).*", path.read_text("utf-8"))
        assert line is None, f"{path}: {line}"


@pytest.mark.slow
def test_the_library_section_runs_from_a_raw_csv_to_a_walking_policy(tmp_path: Path):
    code = library_code()
    loading = 'mp.load_log("run.csv", columns="columns.toml", robot=robot, suspended=True)'
    code, count = re.subn(r"mp\.record_bench\(.*?\)", loading, code)

    assert count == 1

    code = code.replace("iterations=200", "iterations=2")

    # a recording of simulated motors as a user has it: a table and its column map
    robot = load_robot("pupper_v2")
    motors = load_fleet("pupper_v2").sample(12, np.random.default_rng(0)).actuator()
    targets = excitation_targets(robot, "chirp", 8.0, 0.2, seed=0)
    write_table(simulated_log(robot, motors, targets, 0.001), tmp_path / "run.csv")
    joints = "".join(f"[joints.{name}]\n" for name in robot.joint_names)
    (tmp_path / "columns.toml").write_text(f'robot = "pupper_v2"\n{TABLE_MAP}{joints}', "utf-8")

    names: dict = {}
    with chdir(tmp_path):
        exec(code, names)

    assert names["prior"].joint_names == robot.joint_names
    assert names["table"].value(quantity="upright", motors="twin") > 0.5


@pytest.mark.parametrize(
    "text",
    [
        "make nothing",
        "pip install '.[nothing]'",
        "nothing",
        "python no.py",
        "motorprior demo --no",
    ],
)
def test_a_command_that_does_not_exist_is_caught(text: str):
    with pytest.raises(AssertionError):
        check(shlex.split(text))
