"""The help of the command line: every option explained, in SI units, without importing the heavy libraries."""

import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import pytest

import motorprior as mp
from motorprior.cli.main import COMMANDS, COMMON, HELP_ALL, LOGS

WITHOUT_UNIT = {"--search.step-size", "--search.delta-std"}


@pytest.mark.parametrize("command", ["", "logs", *(f"logs {name}" for name in LOGS), *COMMANDS])
def test_every_option_is_explained_with_its_unit(motorprior: Callable[..., Any], command: str):
    outcome = motorprior(*command.split(), HELP_ALL)
    assert outcome.code == 0 and outcome.out.startswith("usage: motorprior"), outcome.err
    plain = re.sub(r"[│╭╮╰╯─]", " ", outcome.out)
    pieces = re.split(r"^ *(--[a-z][\w.-]+)", plain, flags=re.MULTILINE)
    for option, text in zip(
        pieces[1::2], (" ".join(piece.split()) for piece in pieces[2::2]), strict=True
    ):
        explanation = re.sub(r" \((default|required).*", "", text)
        assert " " in explanation, f"{option} is not explained: {text}"
        if "FLOAT" in text.split(" ")[0] and option not in WITHOUT_UNIT:
            assert re.search(r"\[[^\]]+\]", text), f"{option} has no unit: {text}"
    if not command:
        assert {*COMMANDS, "logs"} == set(re.findall(r"• ([\w-]+)", plain))


@pytest.mark.parametrize("command", ["", "logs", *(f"logs {name}" for name in LOGS), *COMMANDS])
def test_the_help_of_common_options_fits_a_screen(motorprior: Callable[..., Any], command: str):
    outcome = motorprior(*command.split(), "--help")
    assert outcome.code == 0 and len(outcome.out.splitlines()) <= 45, outcome.out
    if (name := command.split(" ")[-1]) in COMMON:
        assert HELP_ALL in outcome.out
        shown = COMMON[name]
        settings = dict([*COMMANDS.items(), *LOGS.items()])[name][0]
        assert set(shown) <= {each.name for each in fields(settings)}
        assert len(outcome.out) < len(motorprior(*command.split(), HELP_ALL).out)


def test_the_version_and_a_mistyped_command(motorprior: Callable[..., Any]):
    assert motorprior("--version").out == f"motorprior {mp.__version__}\n"
    outcome = motorprior("identfy", "bench")
    assert outcome.code == 2 and "'identfy'" in outcome.err and "identify" in outcome.err
    assert "import" in motorprior("logs", "imprt", "a.csv").err


def test_the_start_does_not_wait_for_heavy_libraries():
    code = "import sys, motorprior.cli.main; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    ).stdout.split()
    heavy = {
        "jax",
        "optax",
        "matplotlib",
        "jinja2",
        "pyarrow",
        "scipy.optimize",
        "serial",
        "msgpack",
    }
    assert set(loaded) & heavy == set()
