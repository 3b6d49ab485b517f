"""The command line explains itself, in SI units, without waking the heavy libraries."""

import re
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import pytest

from motorprior.cli.demo import demo_command
from motorprior.cli.main import parse
from motorprior.pipeline.demo import Demo

COMMANDS = (
    *(
        "",
        "demo",
        "logs",
        "logs import",
        "logs check",
        "bench",
        "calibrate",
        "identify",
        "validate",
        "validate-log",
        "diff",
        "adapt",
    ),
    *(
        "simulate",
        "replay",
        "walk",
        "play",
        "transfer",
        "doctor",
        "deploy",
        "record",
        "report",
        "speed",
    ),
)
WITHOUT_UNIT = {"--search.step-size", "--search.delta-std"}


@pytest.fixture
def help_of(
    motorprior: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> Callable[[str], tuple[str, dict[str, str]]]:
    """The help of a sub-command, and of each of its options."""
    monkeypatch.setenv("COLUMNS", "120")  # wider, a long help has two columns

    def run(command: str) -> tuple[str, dict[str, str]]:
        outcome = motorprior(*command.split(), "--help")
        assert outcome.code == 0, outcome.err
        plain = re.sub(r"[│╭╮╰╯─]", " ", outcome.out)
        pieces = re.split(r"^ *(--[a-z][\w.-]+)", plain, flags=re.MULTILINE)
        return plain, {name: " ".join(text.split()) for name, text in zip(pieces[1::2], pieces[2::2], strict=True)}

    return run


@pytest.mark.parametrize("command", COMMANDS)
def test_every_option_is_explained(help_of: Callable, command: str):
    text, options = help_of(command)
    assert text.startswith("usage: motorprior")
    for option, explained in options.items():
        described = re.sub(r" \((default|required).*", "", explained)
        assert described.endswith("."), f"{option} {explained}"


def test_every_sub_command_is_in_the_help(help_of: Callable):
    text = help_of("")[0]
    assert {name.split()[0] for name in COMMANDS if name} == set(re.findall(r"• ([\w-]+)", text))


@pytest.mark.parametrize("command", COMMANDS)
def test_every_quantity_has_its_unit(help_of: Callable, command: str):
    options = help_of(command)[1]
    quantities = {name: text for name, text in options.items() if "FLOAT" in text.split(" ")[0]}
    lacking = {name for name, text in quantities.items() if not re.search(r"\[[^\]]+\]", text)}
    assert lacking <= WITHOUT_UNIT
    assert command != "walk" or len(quantities) > 10


def test_the_start_does_not_wait_for_heavy_libraries():
    code = "import sys, motorprior.cli.main; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split()
    assert (
        set(loaded) & {"jax", "optax", "matplotlib", "jinja2", "pyarrow", "scipy.optimize", "serial", "msgpack"}
        == set()
    )


def test_the_page_names_the_command_with_every_option_that_is_not_the_default():
    line: str = "demo --fleet mixed --logs somewhere --columns any --hung --motors 16 --workers 1 --out elsewhere"
    config = parse([*line.split()])
    assert isinstance(config, Demo)
    words = "motorprior demo --fleet mixed --logs FOLDER --columns any --hung --seed 0 --motors 16"
    assert demo_command(config) == words
    assert demo_command(Demo()) == "motorprior demo --seed 0"
