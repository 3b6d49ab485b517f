"""The help: every option is explained, in SI units, and no heavy library is imported."""

import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import pytest

import motorprior as mp
from motorprior.cli.command_table import COMMANDS
from motorprior.cli.options import HELP_ALL

WITHOUT_UNIT = {"--search.step-size", "--search.delta-std"}
MAX_LINES = 45


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_is_explained_with_its_unit(motorprior: Callable[..., Any], name: str):
    outcome = motorprior(*name.split(), HELP_ALL)

    assert outcome.code == 0, outcome.err
    assert outcome.out.startswith(f"usage: motorprior {name}")
    assert "``" not in outcome.out, "markup of docstrings"

    # alternately an option and the text after it
    plain = re.sub(r"[│╭╮╰╯─]", " ", outcome.out)
    pieces = re.split(r"^ *(--[a-z][\w.-]+)", plain, flags=re.MULTILINE)
    texts = [" ".join(piece.split()) for piece in pieces[2::2]]

    for option, text in zip(pieces[1::2], texts, strict=True):
        explanation = re.sub(r" \((default|required).*", "", text)
        assert " " in explanation, f"{option} is not explained: {text}"
        if "FLOAT" in text.split(" ")[0] and option not in WITHOUT_UNIT:
            assert re.search(r"\[[^\]]+\]", text), f"{option} has no unit: {text}"


@pytest.mark.parametrize("name", COMMANDS)
def test_the_help_of_common_options_fits_a_screen(motorprior: Callable[..., Any], name: str):
    outcome = motorprior(*name.split(), "--help")

    assert outcome.code == 0, outcome.err
    assert len(outcome.out.splitlines()) <= MAX_LINES, outcome.out

    command = COMMANDS[name]
    settings = {setting.name for setting in fields(command.load_settings())}

    assert {*command.common, *command.positional} <= settings
    assert command.help in " ".join(outcome.out.split())
    if command.common:
        assert HELP_ALL in outcome.out
        assert len(outcome.out) < len(motorprior(*name.split(), HELP_ALL).out)


def test_the_list_of_commands_shows_the_summary_of_every_command(motorprior: Callable[..., Any]):
    listed = motorprior("--help")

    assert listed.code == 0
    assert len(listed.out.splitlines()) <= MAX_LINES

    for name, command in COMMANDS.items():
        assert re.search(rf"^  {name} +{re.escape(command.help)}$", listed.out, re.MULTILINE)

    logs = motorprior("logs", "--help")

    assert logs.code == 0
    assert "import" in logs.out
    assert "walk" not in logs.out.split("commands:")[1]


def test_the_version_is_printed_and_a_mistyped_command_gets_a_suggestion(
    motorprior: Callable[..., Any],
):
    assert motorprior("--version").out == f"motorprior {mp.__version__}\n"

    outcome = motorprior("identfy", "bench")

    assert outcome.code == 2
    assert "'identfy'" in outcome.err
    assert "identify" in outcome.err
    assert "import" in motorprior("logs", "imprt", "a.csv").err
    assert motorprior().code == motorprior("logs").code == 2


def test_the_start_imports_no_command_and_no_heavy_library():
    code = "import sys, motorprior.cli.main; print(*sys.modules)"
    words = [sys.executable, "-c", code]

    done = subprocess.run(words, check=True, capture_output=True, text=True)

    loaded = done.stdout.split()

    assert not {"numpy", "numba", "mujoco", "jax", "matplotlib", "rich", "pyarrow"} & set(loaded)
    assert not [name for name in loaded if name.startswith("motorprior.commands")]


def test_the_settings_of_the_robots_commands_load_no_compiler():
    names = [name for name, command in COMMANDS.items() if command.on_robot]
    code = (
        "import sys\n"
        "from motorprior.cli.command_table import COMMANDS\n"
        f"for name in {names}:\n"
        "    COMMANDS[name].load_settings()\n"
        "print(*sys.modules)"
    )
    loaded = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    ).stdout.split()

    assert not {"numba", "scipy", "mujoco"} & set(loaded)
