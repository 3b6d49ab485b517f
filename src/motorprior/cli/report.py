"""``motorprior report``: the page of a run folder, from whatever stages are finished."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from motorprior.pipeline.report import build_report


@dataclass(frozen=True)
class MakeReport:
    """Write the report of a demo's run folder anew."""

    run: tyro.conf.Positional[Path]
    """Folder that `motorprior demo` wrote."""


def run_report(config: MakeReport) -> None:
    """Write the page and say where."""
    print(build_report(config.run))
