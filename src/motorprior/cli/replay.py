"""``motorprior replay``: real logs of a robot against simulated motors."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from motorprior.cli.console import TERMINAL, table
from motorprior.pipeline.replay.replay import Replay, run_replay
from motorprior.report.tables import replay_models, replay_rows
from motorprior.results import Results


@dataclass(frozen=True)
class ReplayCommand(Replay):
    """Replay the commands of real logs on simulated motors and compare the joint angles."""

    logs: tyro.conf.Positional[Path]


def replay(config: ReplayCommand) -> None:
    """See `run_replay`."""
    show_replay(run_replay(config, TERMINAL))


def show_replay(results: Results) -> None:
    """Print the table."""
    models = replay_models(results)
    table("Real logs: joint RMSE [mrad], start included", ["log", "joint", *models], replay_rows(results))
