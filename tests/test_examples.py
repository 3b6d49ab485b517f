"""Every example runs in a small size and prints its result."""

import re
import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from unittest import mock

import numpy as np
import pytest

import motorprior as mp
from motorprior.commands.record import Record, run_record
from motorprior.robots.so101.robot import SO101

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def run(name: str, *words: object) -> None:
    with mock.patch.object(sys, "argv", [name, *map(str, words)]):
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")


@pytest.fixture(scope="module")
def prior(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("prior")
    sizes = ("--preset=paper", "--motors=3", "--samples=300", "--steps=2")
    run("log_to_prior.py", *sizes, "--out", out)

    return out / "prior.safetensors"


def test_a_users_log_becomes_a_prior(prior: Path, tmp_path: Path, capsys):
    path = tmp_path / "mine.parquet"
    mp.write_log(path, mp.record_bench(motors=2, steps=300, preset="paper", seed=3))

    sizes = ("--period=0.01", "--preset=paper", "--steps=1")
    run("log_to_prior.py", path, *sizes, "--out", tmp_path)
    out = capsys.readouterr().out

    assert "2 motors" in out
    assert "five new motors" in out
    assert len(mp.MotorPrior.load(tmp_path / "prior.safetensors").mean) == 2


def test_sampled_motors_of_a_prior_drive_an_arm(prior: Path, capsys):
    run("prior_into_your_model.py", prior, "--arms=2", "--seconds=0.1")
    lines = capsys.readouterr().out.splitlines()

    assert [line.split(":")[0] for line in lines] == ["motors 0", "motors 1"]


def test_a_policy_is_trained_on_a_prior(prior: Path, tmp_path: Path, capsys):
    out = tmp_path / "policy.safetensors"
    run("prior_to_policy.py", prior, "--iterations=1", "--episode-steps=5", "--out", out)

    assert mp.Policy.load(out).robot == "pupper_v2"
    assert len([line for line in capsys.readouterr().out.splitlines() if "upright" in line]) == 4


@pytest.mark.slow
def test_a_virtual_arm_is_recorded_and_becomes_an_mjcf(tmp_path: Path, capsys):
    pytest.importorskip("rustypot", reason="pip install rustypot")
    recording = tmp_path / "recording"
    run_record(Record(robot="so101", virtual=True, yes=True, seconds=40.0, out=recording))

    run("so101.py", recording / "run.servolog", "--out", tmp_path / "example")
    out = capsys.readouterr().out

    error = re.search(r"so101_000\.xml: \[(.*)\] rad from a target after 1 s", out)
    assert error is not None, out
    # the joints sag under gravity
    assert max(abs(float(value)) for value in error[1].split()) < 0.2


class FollowerOfLeRobot:
    """The interface of LeRobot's SO101Follower, as in version 0.4.4, and what was sent to it."""

    def __init__(self, config: SimpleNamespace):
        assert config.use_degrees
        self.registers: dict[str, dict[str, int]] = {name: {} for name in SO101.joint_names}
        self.bus = SimpleNamespace(motors=self.registers, write=self._write)
        self.actions: list[dict[str, float]] = []
        self.is_connected = False

    def _write(self, register: str, motor: str, value: int) -> None:
        self.registers[motor][register] = value

    def connect(self) -> None:
        for motor in self.registers:
            self._write("Acceleration", motor, 254)
        self.is_connected = True

    def get_observation(self) -> dict[str, float]:
        rest = {f"{name}.pos": 10.0 for name in SO101.joint_names}
        return rest | (self.actions[-1] if self.actions else {})

    def send_action(self, action: dict[str, float]) -> dict[str, float]:
        self.actions.append(action)
        return action

    def disconnect(self) -> None:
        self.is_connected = False


def test_targets_for_lerobot_have_the_profile_of_the_motors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
):
    robots = []

    def follower(config: SimpleNamespace) -> FollowerOfLeRobot:
        robots.append(FollowerOfLeRobot(config))
        return robots[-1]

    module = ModuleType("lerobot.robots.so_follower")
    vars(module).update(SO101Follower=follower, SO101FollowerConfig=SimpleNamespace)
    for name in ("lerobot", "lerobot.robots"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    monkeypatch.setitem(sys.modules, "lerobot.robots.so_follower", module)
    exported = mp.export(
        mp.from_pretrained("so101"), "mjcf", tmp_path, model=SO101.model.path,
        joints=SO101.joint_names,
    )  # fmt: skip
    (motors,) = [file for file in exported.files if file.name == "motors.json"]

    rate = 100.0
    options = ("--motors", motors, "--rate", rate, "--seconds", 1.5)
    run("so101_lerobot.py", "--port=/dev/ttyACM0", *options)

    (robot,) = robots
    assert not robot.is_connected
    assert all(registers == {"Acceleration": 0} for registers in robot.registers.values())
    assert set(robot.actions[0]) == {f"{name}.pos" for name in SO101.joint_names[:-1]}
    elbow = np.radians([action["elbow_flex.pos"] for action in robot.actions])
    acceleration = np.diff(elbow, 2) * rate**2
    assert 30.0 < np.abs(acceleration).max() < 39.5
    assert elbow[-1] - elbow[0] == pytest.approx(0.1, abs=1e-3)
    assert "0. 0. 0. 0. 0." in capsys.readouterr().out.replace("-", "")


def test_every_example_is_run_here():
    tests = Path(__file__).read_text("utf-8")
    for example in EXAMPLES.glob("*.py"):
        assert f'run("{example.name}"' in tests


@pytest.mark.slow
def test_ppo_trains_on_sampled_motors(prior: Path, capsys):
    pytest.importorskip(
        "stable_baselines3", reason="it is not installed: pip install stable-baselines3"
    )
    run("train_ppo.py", prior, 4096)
    line = r"commanded 0\.3 m/s on 10 new sets of motors: -?\d\.\d\d m/s, upright for \d\.\d of 5 s"

    assert re.fullmatch(line, capsys.readouterr().out.splitlines()[-1])


@pytest.mark.slow
def test_mjlab_trains_on_motors_of_a_card(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    pytest.importorskip("mjlab", reason="it is not installed: pip install mjlab")
    monkeypatch.chdir(tmp_path)
    run("train_in_mjlab.py", "--card=go2", "--worlds=2", "--iterations=1")

    assert list((tmp_path / "runs" / "mjlab").rglob("*.pt"))


def test_the_example_of_the_paper_compares_two_policies_on_two_sets_of_motors(capsys):
    sizes = (
        "--motors=3",
        "--samples=300",
        "--steps=3",
        "--iterations=1",
        "--directions=1",
        "--seconds=0.1",
    )
    run("paper.py", *sizes)
    lines = capsys.readouterr().out.splitlines()

    assert [line.split(":")[0] for line in lines] == [
        "trained on prior, on prior motors",
        "trained on prior, on held-out motors",
        "trained on ideal PD, on ideal PD motors",
        "trained on ideal PD, on held-out motors",
    ]
