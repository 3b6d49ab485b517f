"""Every example runs in a small size and prints its result."""

import re
import runpy
import sys
from pathlib import Path
from unittest import mock

import pytest

import motorprior as mp
from motorprior.commands.record import Record, run_record

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
