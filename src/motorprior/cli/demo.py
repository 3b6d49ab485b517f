"""``motorprior demo``: a small run of everything."""

from __future__ import annotations

import shlex
from dataclasses import fields

from motorprior.cli.console import TERMINAL
from motorprior.cli.real_motors import show_real_motors
from motorprior.cli.replay import show_replay
from motorprior.cli.transfer import show_transfer
from motorprior.cli.validate import show_fidelity
from motorprior.pipeline.demo import Demo, DemoResult, run_demo
from motorprior.pipeline.stage import FIGURES


def demo(config: Demo) -> None:
    """See `run_demo`; prints its tables."""
    _show(config, run_demo(config, TERMINAL, demo_command(config), show_real_motors))


def demo_command(config: Demo) -> str:
    """The command line with the seed and every option that differs from its default; the folder of logs as FOLDER."""
    words = ["motorprior", "demo"]
    for field in fields(Demo):
        value = getattr(config, field.name)
        if field.name in ("out", "workers") or (value == field.default and field.name != "seed"):
            continue  # the result does not depend on out and workers
        words.append(f"--{field.name.replace('_', '-')}")
        if value is not True:
            words.append("FOLDER" if field.name == "logs" else str(value))
    return shlex.join(words)


def _show(config: Demo, found: DemoResult) -> None:
    show_fidelity(found.results)
    if found.results.where(quantity="real_rmse"):
        show_replay(found.results)
    if config.logs is None:
        print(
            "No real logs were given. Those of the shipped robot are in jietan/puppersim, puppersim/data/system_id "
            "(Apache-2.0): --logs FOLDER"
        )
    show_transfer(found.results)
    print(f"Report: {found.page}   Figures: {config.out / FIGURES}")
