"""The command line explains itself, in SI units, without waking the heavy libraries."""

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from motorprior.cli.adapt import AdaptCommand
from motorprior.cli.demo import demo_command
from motorprior.cli.deploy import Deploy
from motorprior.cli.diff import Diff
from motorprior.cli.doctor import Doctor
from motorprior.cli.identify import IdentifyCommand
from motorprior.cli.logs import LogsCheck, LogsImportCommand
from motorprior.cli.main import RUN, parse
from motorprior.cli.play import PlayCommand
from motorprior.cli.record import Record
from motorprior.cli.replay import ReplayCommand
from motorprior.cli.report import MakeReport
from motorprior.cli.robot_choice import RobotChoice
from motorprior.cli.speed import Speed
from motorprior.cli.transfer import TransferCommand
from motorprior.cli.validate import ValidateCommand
from motorprior.cli.virtual_robot import VirtualRobotCommand
from motorprior.cli.walk import WalkCommand
from motorprior.hardware.settings import DeploySettings, RecordSettings
from motorprior.pipeline.bench import Bench
from motorprior.pipeline.demo import Demo
from motorprior.pipeline.motor_choice import MotorChoice
from motorprior.pipeline.virtual.virtual_robot import Virtual

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
        "virtual-robot",
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


@pytest.mark.parametrize(
    ("line", "config"),
    [
        ("demo --motors 16", Demo(motors=16)),
        ("logs import a b --out c", LogsImportCommand((Path("a"), Path("b")), Path("c"))),
        ("logs check a", LogsCheck((Path("a"),))),
        ("bench --out a --steps 5", Bench(Path("a"), steps=5)),
        ("identify a --out b", IdentifyCommand((Path("a"),), Path("b"))),
        ("validate a b --out c", ValidateCommand((Path("a"), Path("b")), Path("c"))),
        ("diff a b --json c", Diff(Path("a"), Path("b"), Path("c"))),
        ("adapt a b --out c", AdaptCommand(Path("a"), Path("b"), Path("c"))),
        ("replay a --prior b --out c", ReplayCommand(Path("a"), Path("b"), Path("c"))),
        ("walk --out a --actuator pd --kp 8", WalkCommand(Path("a"), MotorChoice("pd", kp=8.0))),
        ("play a b --place twin", PlayCommand((Path("a"), Path("b")), place="twin")),
        ("transfer a --out b", TransferCommand(walks=(Path("a"),), out=Path("b"))),
        ("doctor --port a", Doctor(RobotChoice("a"))),
        ("deploy a --port b --yes", Deploy(Path("a"), RobotChoice("b"), DeploySettings(yes=True))),
        ("record --virtual --joint knee", Record(RobotChoice(virtual=True), RecordSettings(joint="knee"))),
        ("virtual-robot --robot.seed 3", VirtualRobotCommand(Virtual(seed=3))),
        ("report a", MakeReport(Path("a"))),
        ("speed --prior a", Speed(Path("a"))),
    ],
)
def test_a_command_line_is_its_settings(line: str, config: object):
    assert parse(line.split()) == config
    assert type(config) in RUN


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
