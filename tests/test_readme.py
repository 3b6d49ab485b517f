"""Every command in the README, CONTRIBUTING and docs/ is one that exists: checked without running it."""

import re
import shlex
import tomllib
from collections.abc import Iterator
from contextlib import chdir
from itertools import takewhile
from pathlib import Path

import numpy as np
import pytest
from motor_logs import TABLE_MAP, write_table

from motorprior.actuator.fleet import load_fleet
from motorprior.excitation.robot_targets import excitation_targets
from motorprior.robots.load import load_robot
from motorprior.simulation.playback import simulated_log

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
FENCE = re.compile(r"^ *(```+|~~~+) *(\w*)[^\n]*\n(.*?)^ *\1 *$", re.MULTILINE | re.DOTALL)
# not ours, or the shell's; any other unknown one fails
UNCHECKED = {"cd", "git", "pre-commit", "for", "do", "done"}


def commands(text: str) -> Iterator[list[str]]:
    """Words of every command in the ```sh blocks, less comments, prompts, redirections and variables."""
    blocks = FENCE.findall(text)
    opened = len(re.findall(r"^ *(?:```+|~~~+) *sh\b", text, re.MULTILINE))
    assert opened == sum(language == "sh" for _, language, _ in blocks), (
        "a ```sh block is not closed"
    )
    for _, language, block in blocks:
        assert language not in {"bash", "console", "shell", "zsh"}, (
            f"```{language}: only ```sh is checked"
        )
        for line in block.replace("\\\n", " ").splitlines() if language == "sh" else ():
            lexer = shlex.shlex(line.strip().removeprefix("$ "), posix=True, punctuation_chars=True)
            lexer.whitespace_split = True
            command: list[str] = []
            for word in [*lexer, ";"]:
                if word and set(word) <= set(";&|"):
                    if command:
                        yield list(takewhile(lambda w: not w or not set(w) <= set("<>"), command))
                    command = []
                elif command or not re.match(r"\w+=", word):
                    command.append(word)


def parses(args: list[str]) -> None:
    from motorprior.cli.parse import parse

    try:
        parse(args)
    except SystemExit as stop:  # --help leaves with 0
        assert not stop.code, f"motorprior {shlex.join(args)} does not parse"


def make_succeeds(args: list[str]) -> None:
    targets = set(
        re.findall(r"^([\w.-]+)\s*:(?!=)", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE)
    )
    wanted = [word for word in args if "=" not in word and not word.startswith("-")]
    assert set(wanted) <= targets, f"the Makefile makes {sorted(targets)}"
    if "demo" in wanted:
        parses(
            [
                "demo",
                *(o for word in args if word.startswith("ARGS=") for o in shlex.split(word[5:])),
            ]
        )


def installs(args: list[str]) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    extras = {
        e for word in args for names in re.findall(r"\[(.*?)\]", word) for e in names.split(",")
    }
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


def page_commands() -> list[tuple[str, list[str]]]:
    return [
        (page.name, words)
        for page in PAGES
        if page.is_file()
        for words in commands(page.read_text("utf-8"))
    ]


@pytest.mark.parametrize(
    "words", [pytest.param(w, id=f"{page}: {shlex.join(w)}") for page, w in page_commands()]
)
def test_every_command_exists(words: list[str]):
    check(words)


def test_the_library_section_runs_in_a_small_size(tmp_path: Path):
    section = (ROOT / "README.md").read_text("utf-8").partition("## As a library")[2]
    code = next(block for _, language, block in FENCE.findall(section) if language == "python")
    sizes = {
        "steps=10_000": "steps=300",
        "motors=32": "motors=3",
        'preset="rollout"': 'preset="paper"',
        'out="runs/my_prior"': 'out="runs/my_prior", steps=2',
        "iterations=200": "iterations=1, episode_steps=5",
    }
    for shown, small in sizes.items():
        assert shown in code
        code = code.replace(shown, small)
    names: dict = {}
    with chdir(tmp_path):
        exec(code, names)
    assert names["torque"].shape == (12,) and {row.quantity for row in names["table"]} == {
        "speed",
        "upright",
        "drift",
    }


@pytest.mark.slow
def test_the_library_section_runs_from_a_raw_csv_to_a_walking_policy(tmp_path: Path):
    section = (ROOT / "README.md").read_text("utf-8").partition("## As a library")[2]
    code = next(block for _, language, block in FENCE.findall(section) if language == "python")
    loaded = re.search(r"mp\.load_log\(.*\)", code)
    assert loaded is not None
    code = re.sub(r"mp\.record_bench\(.*?\n\)", loaded[0], code, count=1, flags=re.DOTALL)
    code = code.replace('preset="rollout"', 'preset="quick"').replace(
        "iterations=200", "iterations=2"
    )
    robot = load_robot("pupper_v2")
    fleet = load_fleet("pupper_v2")
    targets = excitation_targets(robot, "chirp", 8.0, 0.2, seed=0)
    log = simulated_log(
        robot, fleet.sample(12, np.random.default_rng(0)).actuator(), targets, 0.001
    )
    write_table(log, tmp_path / "run.csv")
    joints = "".join(f"[joints.{name}]\n" for name in robot.joint_names)
    (tmp_path / "columns.toml").write_text(f'robot = "pupper_v2"\n{TABLE_MAP}{joints}', "utf-8")
    found: dict = {}
    with chdir(tmp_path):
        exec(code, found)
    assert found["prior"].joint_names == robot.joint_names
    assert found["table"].value(quantity="upright", motors="twin") > 0.5


@pytest.mark.parametrize(
    "text",
    [
        "make nothing",
        "pip install 'motorprior[nothing]'",
        "nothing",
        "python no.py",
        "motorprior demo --no",
    ],
)
def test_a_command_that_does_not_exist_is_caught(text: str):
    with pytest.raises(AssertionError):
        check(shlex.split(text))
