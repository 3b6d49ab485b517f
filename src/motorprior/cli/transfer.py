"""``motorprior transfer``: policies in their training simulation and on the twin, or the transfer study."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import tyro
from rich.markdown import Markdown

from motorprior.cli.console import CONSOLE, TERMINAL, command_line, table
from motorprior.commands.transfer import Transfer, run_transfer
from motorprior.commands.transfer_study.settings import Study
from motorprior.commands.transfer_study.study import TABLES, run_study
from motorprior.exceptions import ConfigError
from motorprior.report.tables import TRANSFER_COLUMNS, transfer_rows
from motorprior.results import Results
from motorprior.stage import PAGE
from motorprior.studies.compare import DRAWS


@dataclass(frozen=True)
class TransferCommand(Transfer, Study):
    """Evaluate policies in their training simulation and on the twin: unseen motors, 1 kHz, encoder noise.

    With --study, policies are trained on each model of a bench's motors, with several seeds, and evaluated in their
    training simulation and four environments; the folder gets walks.csv, figures.json and report.html.
    """

    walks: tyro.conf.Positional[tuple[Path, ...]] = ()
    study: bool = False
    """Run the whole study, about two hours on two cores; a rerun resumes. The options from foreign to quick and those
    of the executor need it."""


def transfer(config: TransferCommand) -> None:
    """See `run_transfer` and `run_study`."""
    study = Study(**{field.name: getattr(config, field.name) for field in fields(Study)})
    if not config.study:
        settings = {field.name: getattr(config, field.name) for field in fields(Transfer)}
        for field in fields(Study):
            if field.name not in settings and getattr(study, field.name) != field.default:
                raise ConfigError(f"{field.name} needs --study", remedy="add --study", argument=field.name)
        return show_transfer(run_transfer(Transfer(**settings), TERMINAL))
    if config.walks or config.engine is not None:
        raise ConfigError("a study trains its own policies", remedy="give neither walks nor an engine")
    run_study(study, TERMINAL, command_line("transfer --study", study))
    CONSOLE.print(Markdown((config.out / TABLES).read_text("utf-8")))
    print(config.out / PAGE)
    return None


def show_transfer(results: Results) -> None:
    """Print the transfer table."""
    table(f"Transfer, {DRAWS} motor samples x 5 s, means over seeds", TRANSFER_COLUMNS, transfer_rows(results))
