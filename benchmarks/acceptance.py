"""Acceptance figures: small runs of all experiments, and a comparison of two such runs.

    python benchmarks/acceptance.py run --data DIR --out runs/acceptance
    python benchmarks/acceptance.py compare runs/before/acceptance.json
    runs/acceptance/acceptance.json

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

import numpy as np
import tyro

BENCHMARKS = Path(__file__).parent
SMALL = ["--motors", "16", "--steps", "2000", "--adam-steps", "100"]
REAL = ["--folds", "1", "--seconds", "12", "--adam-steps", "100"]


def run(data: Path, out: Path) -> None:
    """Run all unfinished commands and collect all figures except times, named after the run.

    Args:
        data: folder with the real logs of `benchmarks/real_logs.py`.
        out: run folder.
    """
    runs = {  # arguments of Python
        "demo": ["-m", "motorprior", "demo"],
        "real_logs": [str(BENCHMARKS / "real_logs.py"), "--data", str(data), *REAL],
        "fidelity": [str(BENCHMARKS / "fidelity.py"), *SMALL],
        "out_of_family": [str(BENCHMARKS / "out_of_family.py"), *SMALL],
    }
    environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    figures = {}
    for name, arguments in runs.items():
        done = out / f"{name}.done"
        if not done.exists():
            command = [sys.executable, *arguments, "--out", str(out / name)]
            subprocess.run(command, check=True, env=environment)
            done.touch()
        found = json.loads((out / name / "figures.json").read_text())
        figures |= {f"{name}/{key}": value for key, value in found.items() if "seconds" not in key}
    (out / "acceptance.json").write_text(json.dumps(figures, indent=0, sort_keys=True) + "\n")


def compare(
    before: tyro.conf.Positional[Path],
    after: tyro.conf.Positional[Path],
    rtol: float = 1e-3,
    atol: float = 1e-6,
) -> int:
    """Print the differences of two collections of figures; 1 if there are any.

    Args:
        before: acceptance.json of the earlier run.
        after: acceptance.json of the later run.
        rtol: relative tolerance [-].
        atol: absolute tolerance, in the unit of the figure.
    """
    old, new = (json.loads(path.read_text()) for path in (before, after))
    changed = [
        f"{name}: {value:.6g} -> {new[name]:.6g}" if name in new else f"{name}: missing"
        for name, value in old.items()
        if name not in new or not np.isclose(new[name], value, rtol, atol, equal_nan=True)
    ]
    print("\n".join(changed))
    print(
        f"{len(old)} figures, {len(changed)} changed or missing, {len(new.keys() - old.keys())} new"
    )
    return min(len(changed), 1)


if __name__ == "__main__":
    sys.exit(
        tyro.extras.subcommand_cli_from_dict({"run": run, "compare": compare}, description=__doc__)
    )
