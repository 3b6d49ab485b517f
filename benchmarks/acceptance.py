"""Acceptance figures: small runs of all experiments, and a comparison of two such runs.

    python benchmarks/acceptance.py run --data DIR --out runs/acceptance
    python benchmarks/acceptance.py compare runs/before/acceptance.json runs/acceptance/acceptance.json

`run` runs the demo, which is a small transfer study, and the benchmarks on real logs and on fleets, with one fold per
robot and few motors, and collects their figures in acceptance.json. About 40 minutes on two cores.
Use a new --out for each commit: finished runs are reused whatever the code.
`compare` lists changed and missing figures and exits with 1 if there are any. The same seed gives the same figures for
any number of workers, so the tolerance only covers differences between processors.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

BENCHMARKS = Path(__file__).parent
SMALL = ["--motors", "16", "--steps", "2000", "--adam-steps", "100"]
COLLECTED = "acceptance.json"


@dataclass(frozen=True)
class Run:
    """Compute the figures."""

    data: Path  # folder with the real logs of `benchmarks/real_logs.py`
    out: Path  # run folder


@dataclass(frozen=True)
class Compare:
    """Compare two collections of figures."""

    before: tyro.conf.Positional[Path]  # acceptance.json of the earlier run
    after: tyro.conf.Positional[Path]  # acceptance.json of the later run
    rtol: float = 1e-3  # relative tolerance [-]
    atol: float = 1e-6  # absolute tolerance, in the unit of the figure


def commands(data: Path, out: Path) -> dict[str, list[str]]:
    """Python arguments of every run, by name."""
    product, real = ["-m", "motorprior"], [str(BENCHMARKS / "real_logs.py"), "--data", str(data)]
    return {
        "demo": [*product, "demo", "--out", str(out / "demo")],
        "real_logs": [*real, "--folds", "1", "--seconds", "12", "--adam-steps", "100", "--out", str(out / "real_logs")],
        "fidelity": [str(BENCHMARKS / "fidelity.py"), *SMALL, "--out", str(out / "fidelity")],
        "out_of_family": [str(BENCHMARKS / "out_of_family.py"), *SMALL, "--out", str(out / "out_of_family")],
    }


def run(config: Run) -> None:
    """Run all unfinished commands and collect the figures."""
    environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    for name, arguments in commands(config.data, config.out).items():
        done = config.out / f"{name}.done"
        if not done.exists():
            subprocess.run([sys.executable, *arguments], check=True, env=environment)
            done.touch()
    text = json.dumps(collected(config.out), indent=0, sort_keys=True)
    (config.out / COLLECTED).write_text(text + "\n")


def collected(out: Path) -> dict[str, float]:
    """All figures except times, named after the run."""
    figures: dict[str, float] = {}
    for path in (out / name / "figures.json" for name in ("demo", "real_logs", "fidelity", "out_of_family")):
        found = json.loads(path.read_text())
        figures |= {f"{path.parent.name}/{name}": value for name, value in found.items() if "seconds" not in name}
    return figures


def compare(config: Compare) -> int:
    """Print the differences; 1 if there are any."""
    before, after = (json.loads(path.read_text()) for path in (config.before, config.after))
    changed = [
        f"{name}: {value:.6g} -> {after[name]:.6g}" if name in after else f"{name}: missing"
        for name, value in before.items()
        if name not in after or not np.isclose(after[name], value, config.rtol, config.atol, equal_nan=True)
    ]
    print("\n".join(changed))
    print(f"{len(before)} figures, {len(changed)} changed or missing, {len(after.keys() - before.keys())} new")
    return min(len(changed), 1)


def main() -> int:
    """Run or compare."""
    config = tyro.cli(
        Annotated[Run, tyro.conf.subcommand("run")] | Annotated[Compare, tyro.conf.subcommand("compare")],  # pyright: ignore
        description=__doc__,
    )
    return compare(config) if isinstance(config, Compare) else run(config) or 0


if __name__ == "__main__":
    sys.exit(main())
