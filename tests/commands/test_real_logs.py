"""The benchmark on real logs: its first robot on a few seconds of two logs, its keys, and what is skipped."""

import gzip
import shutil
import sys
from itertools import islice
from pathlib import Path

import pytest

import real_logs
from motorprior.artifacts import read_json
from motorprior.identification.baselines import response_fit
from motorprior.identification.physics import term_selection

SHARES = ("coverage50", "coverage90")
ROWS = 600
"""Of each log, header included: three seconds."""


@pytest.fixture
def data(shared_data: Path, tmp_path: Path) -> Path:
    """Two logs of the suspended quadruped, cut, and its model; no other robot's."""
    logs, model = sorted((shared_data / "go2").glob("*.csv.gz"))[:2], shared_data / "robots" / "go2.xml"
    if len(logs) < 2 or not model.is_file():
        pytest.skip("MOTORPRIOR_SHARED names a folder without go2/*.csv.gz and robots/go2.xml")
    for folder in ("go2", "robots"):
        (tmp_path / "data" / folder).mkdir(parents=True)
    shutil.copy(model, tmp_path / "data" / "robots")
    for path in logs:
        with gzip.open(path, "rt") as whole, gzip.open(tmp_path / "data" / "go2" / path.name, "wt") as cut:
            cut.writelines(islice(whole, ROWS))
    return tmp_path / "data"


@pytest.mark.slow
def test_every_model_is_tested_on_held_out_logs(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(term_selection, "CANDIDATES", ())  # the terms are tested elsewhere, and take minutes
    monkeypatch.setattr(response_fit, "RESTARTS", 4)
    out, quick = tmp_path / "out", ("--seconds", "4", "--adam-steps", "4", "--folds", "1")
    line = ["real_logs.py", "--data", str(data), "--out", str(out), *quick, "--robots", "go2", "xl330"]
    monkeypatch.setattr(sys, "argv", line)
    real_logs.main()
    shown = capsys.readouterr().out
    assert "xl330: skipped, no folder" in shown and "| servo_limits |" in shown
    found = read_json(out / "figures.json")
    models = ("pure_delay", "second_order", "servo_limits", "per_motor", "pooled_network", "prior", "adapted")
    models += ("coulomb_viscous", "stribeck")  # beside a prior with windows of a second
    coverage = {f"go2/{name}" for name in SHARES}
    out_of = {f"go2/leave_one_motor_out/{name}" for name in ("prior", "adapted", "per_motor", *SHARES)}
    assert set(found) == {f"go2/leave_one_log_out/{model}" for model in models} | coverage | out_of
    learned = found.pop("go2/leave_one_log_out/pooled_network")  # hardly
    shares = {name: value for name, value in found.items() if name.endswith(SHARES)}
    assert learned > 0.0 and all(0.0 <= value <= 1.0 for value in shares.values())
    broken = {name: value for name, value in found.items() if name not in shares and not 0.0 < value < 1.0}
    assert broken == {}
    assert found["go2/leave_one_log_out/servo_limits"] < found["go2/leave_one_log_out/pure_delay"]
    before = (out / "go2" / "traj_0" / "figures.json").stat().st_mtime_ns
    real_logs.main()
    assert (out / "go2" / "traj_0" / "figures.json").stat().st_mtime_ns == before, "once"
    assert read_json(out / "figures.json") == found | {"go2/leave_one_log_out/pooled_network": learned}


def test_every_log_is_held_out_once():
    paths = [Path(f"{name}.parquet") for name in "abcd"]
    folds = real_logs.leave_out(paths, [paths[:1], paths[1:3], paths[3:]])
    assert [path for fold in folds for path in fold.test] == paths
    assert all(set(fold.train) | set(fold.test) == set(paths) for fold in folds)
    assert not any(set(fold.train) & set(fold.test) for fold in folds)
