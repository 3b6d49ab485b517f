"""``motorprior demo``: a small run of everything."""

from __future__ import annotations

from motorprior.cli.console import TERMINAL, command_line
from motorprior.cli.motors import show_fidelity, show_real_motors
from motorprior.cli.replay import show_replay
from motorprior.cli.transfer import show_transfer
from motorprior.commands.demo import Demo, run_demo
from motorprior.stage import FIGURES, PAGE


def demo(config: Demo) -> None:
    """See `run_demo`; prints its tables."""
    # the result does not depend on out and workers
    results = run_demo(config, TERMINAL, command_line("demo", config, ("out", "workers")), show_real_motors)
    show_fidelity(results)
    if results.where(quantity="real_rmse"):
        show_replay(results)
    if config.logs is None:
        print(
            "No real logs were given. Those of the shipped robot are in jietan/puppersim, puppersim/data/system_id "
            "(Apache-2.0): --logs FOLDER"
        )
    show_transfer(results)
    print(f"Report: {config.out / PAGE}   Figures: {config.out / FIGURES}")
