"""Acceptance figures: small runs of all experiments, and a comparison of two such runs.

    python benchmarks/acceptance.py run --data DIR --out runs/acceptance
    python benchmarks/acceptance.py compare before/acceptance.json runs/acceptance/acceptance.json

`run` runs the demo, which is a small transfer study, and the benchmarks on real logs and on fleets,
with one fold per robot and few motors, and collects their figures in acceptance.json. About 40
minutes on two cores. Use a new --out for each commit: finished runs are reused whatever the code.

`compare` lists changed and missing figures and exits with 1 if there are any. The same seed gives
the same figures for any number of workers, so the tolerance only covers differences between
processors.
"""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Literal

import numpy as np
import tyro

BENCHMARKS = Path(__file__).parent
ATOL = 1e-6  # absolute tolerance of `compare`, in the unit of the figure
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
Experiment = Literal["demo", "real_logs", "fidelity", "out_of_family"]
EXPERIMENTS: tuple[Experiment, ...] = ("demo", "real_logs", "fidelity", "out_of_family")


def run(
    data: Path,
    out: Path,
    experiments: tuple[Experiment, ...] = EXPERIMENTS,
    motors: int = 16,
    steps: int = 2000,
    seconds: float = 12.0,
    adam_steps: int = 100,
) -> None:
    """Run all unfinished experiments and collect all figures except times, named after the run.

    Args:
        data: folder with the real logs of `benchmarks/real_logs.py`.
        out: run folder.
        experiments: experiments to run.
        motors: motors of each bench of fidelity and out_of_family.
        steps: samples per motor of these benches.
        seconds: length of the training segments of the real logs [s].
        adam_steps: Adam steps of the networks, except for the demo.
    """
    networks = ["--adam-steps", str(adam_steps)]
    benches = ["--motors", str(motors), "--steps", str(steps), *networks]
    real_logs = ["--data", str(data), "--folds", "1", "--seconds", f"{seconds:g}", *networks]
    commands: dict[Experiment, list[str]] = {  # arguments of Python
        "demo": ["-m", "motorprior", "demo"],
        "real_logs": [str(BENCHMARKS / "real_logs.py"), *real_logs],
        "fidelity": [str(BENCHMARKS / "fidelity.py"), *benches],
        "out_of_family": [str(BENCHMARKS / "out_of_family.py"), *benches],
    }

    figures = {}
    for name in experiments:
        marker = out / f"{name}.done"
        if not marker.exists():
            command = [sys.executable, *commands[name], "--out", str(out / name)]
            subprocess.run(command, check=True, env=os.environ | ONE_THREAD)
            marker.touch()
        for key, value in json.loads((out / name / "figures.json").read_text()).items():
            if "seconds" not in key:
                figures[f"{name}/{key}"] = value
    (out / "acceptance.json").write_text(json.dumps(figures, indent=0, sort_keys=True) + "\n")


def compare(
    earlier: tyro.conf.Positional[Path],
    later: tyro.conf.Positional[Path],
    rtol: float = 1e-3,
) -> int:
    """Print the differences of two collections of figures; 1 if there are any.

    Args:
        earlier: acceptance.json of the earlier run.
        later: acceptance.json of the later run.
        rtol: relative tolerance [-].
    """
    old_figures = json.loads(earlier.read_text())
    new_figures = json.loads(later.read_text())
    differences = []
    for name, old in old_figures.items():
        if name not in new_figures:
            differences.append(f"{name}: missing")
            continue
        new = new_figures[name]
        if not np.isclose(new, old, rtol, ATOL, equal_nan=True):
            differences.append(f"{name}: {old:.6g} -> {new:.6g}")

    num_new = len(new_figures.keys() - old_figures.keys())
    print("\n".join(differences))
    print(f"{len(old_figures)} figures, {len(differences)} changed or missing, {num_new} new")
    return min(len(differences), 1)


if __name__ == "__main__":
    commands = {"run": run, "compare": compare}
    sys.exit(tyro.extras.subcommand_cli_from_dict(commands, description=__doc__))
