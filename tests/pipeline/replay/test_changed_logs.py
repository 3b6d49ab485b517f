"""Logs that changed are replayed again, also where a log is a folder whose files lie deeper."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foreign_files import ROWS, write_sage

from motorprior.pipeline.replay import calibrate, replay
from motorprior.pipeline.replay.calibrate import Calibrate, run_calibrate
from motorprior.pipeline.replay.replay import Replay, run_replay
from motorprior.pipeline.stage import write_results
from motorprior.results import Results
from motorprior.robots.pupper_v2.robot import PUPPER_V2 as ROBOT


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    """A folder of motions of SAGE, each a folder itself: one, in which a hip moves."""
    folder, target = tmp_path / "logs", np.tile(ROBOT.nominal_pose, (ROWS, 1))
    folder.mkdir()
    target[:, 1] += np.linspace(0.0, 0.3, ROWS)
    write_sage(folder, joints=ROBOT.joint_names, target=target, angle=target + 0.01)
    return folder


@pytest.mark.parametrize(
    ("module", "work", "stage"),
    [
        (replay, "_replay_all", lambda logs, out: run_replay(Replay(logs, logs.parent / "prior", out))),
        (calibrate, "_calibrate", lambda logs, out: run_calibrate(Calibrate(logs, out, posture="hung"))),
    ],
)
def test_an_edit_of_a_nested_file_is_seen(
    monkeypatch: pytest.MonkeyPatch, logs: Path, module: Any, work: str, stage: Callable[[Path, Path], Results]
):
    done: list[str] = []

    def worked(config: Any, *_: Any) -> None:
        done.append(work)
        write_results(config.out, Results())

    monkeypatch.setattr(module, work, worked)
    monkeypatch.setattr(module, "load_prior", lambda *_: None)
    (logs.parent / "prior").touch()
    out, nested = logs.parent / "out", logs / "motion" / "state_motor.csv"
    for _ in range(2):
        stage(logs, out)
    assert done == [work]
    nested.write_text(nested.read_text().replace(",0.0", ",0.1"))
    stage(logs, out)
    assert done == [work, work]
