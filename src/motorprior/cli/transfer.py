"""``motorprior transfer``: every policy in its own simulation and on the twin."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from motorprior.cli.console import TERMINAL, table
from motorprior.pipeline.transfer import Transfer, run_transfer
from motorprior.report.tables import TRANSFER_COLUMNS, transfer_rows
from motorprior.results import Results
from motorprior.transfer.study import DRAWS


@dataclass(frozen=True)
class TransferCommand(Transfer):
    """Run policies where they were trained, and on the twin: unseen physical motors, 1 kHz, encoder noise."""

    walks: tyro.conf.Positional[tuple[Path, ...]]


def transfer(config: TransferCommand) -> None:
    """See `run_transfer`."""
    show_transfer(run_transfer(config, TERMINAL))


def show_transfer(results: Results) -> None:
    """The transfer table on the terminal."""
    table(f"Transfer, {DRAWS} motor draws x 5 s, means over seeds", TRANSFER_COLUMNS, transfer_rows(results))
