"""The examples run, each in its smallest size."""

import runpy
import sys
from pathlib import Path

import pytest

import motorprior as mp

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def run(monkeypatch: pytest.MonkeyPatch, name: str, *words: object) -> None:
    monkeypatch.setattr(sys, "argv", [name, *map(str, words)])
    runpy.run_path(str(EXAMPLES / name), run_name="__main__")


@pytest.fixture(scope="module")
def prior(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("prior")
    with pytest.MonkeyPatch.context() as patch:
        sizes = ("--preset", "paper", "--motors", 3, "--samples", 300, "--steps", 2)
        run(patch, "log_to_prior.py", *sizes, "--out", out)
    return out / "prior.safetensors"


def test_own_logs_become_a_prior(prior: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys):
    mp.write_log(tmp_path / "mine.parquet", mp.record_bench(motors=2, steps=300, preset="paper", seed=3))
    run(
        monkeypatch,
        "log_to_prior.py",
        tmp_path / "mine.parquet",
        "--period=0.01",
        "--preset=paper",
        "--steps=1",
        "--out",
        tmp_path,
    )
    out = capsys.readouterr().out
    assert "2 motors" in out and "five new motors" in out
    assert len(mp.MotorPrior.load(tmp_path / "prior.safetensors").mean) == 2


def test_a_prior_drives_an_arm(prior: Path, monkeypatch: pytest.MonkeyPatch, capsys):
    run(monkeypatch, "prior_into_your_model.py", prior, "--draws=2", "--seconds=0.1")
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in lines] == ["motors 0", "motors 1"]


def test_a_prior_becomes_a_policy(prior: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys):
    out = tmp_path / "policy.safetensors"
    run(monkeypatch, "prior_to_policy.py", prior, "--iterations=1", "--episode-steps=5", "--out", out)
    assert mp.Policy.load(out).robot == "pupper_v2"
    assert len([line for line in capsys.readouterr().out.splitlines() if "upright" in line]) == 4


def test_the_paper_reads_top_to_bottom_and_runs(monkeypatch: pytest.MonkeyPatch, capsys):
    sizes = ("--motors=3", "--samples=300", "--steps=3", "--iterations=1", "--directions=1", "--seconds=0.1")
    run(monkeypatch, "paper.py", *sizes)
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in lines] == [
        f"trained on {name}, on {place} motors" for name in ("prior", "ideal PD") for place in (name, "held-out")
    ]
    assert len((EXAMPLES / "paper.py").read_text("utf-8").splitlines()) <= 150
