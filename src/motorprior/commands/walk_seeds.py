"""One training with several seeds, and a plot of their learning curves."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from motorprior.artifacts import atomic_path
from motorprior.bounds import require_count
from motorprior.commands.walk import POLICY, Walk, run_walk
from motorprior.locomotion.policy import Policy
from motorprior.progress import SILENT, Progress, in_parallel, usable_threads
from motorprior.results import Result, Results
from motorprior.simulation.walk_metrics import read_metrics
from motorprior.stage import write_results

PICTURE, SEED_FOLDER = "seeds.png", "seed_{}"
SEEDS_APART = 1000  # demos and studies with different seeds share no search seed


def run_walk_seeds(config: Walk, seeds: int, progress: Progress = SILENT) -> Results:
    """Train with ``seeds`` seeds, from that of the search on, each in the folder seed_K of ``config.out``.

    The executor "threads" trains several seeds at a time. The plot has median and quartiles of return and time upright.

    Returns:
        The mean return [m] of each best policy in its training simulation, or on the validation fleet if there is one.

    Raises:
        ConfigError, ArtifactError, SimulationFault, KeyboardInterrupt: see `run_walk`.
    """
    require_count("seeds", seeds)
    require_count("workers", config.workers)
    threads = min(seeds, usable_threads(config.workers, progress)) if config.executor == "threads" else 1
    walks = [_of_seed(config, config.search.seed + number, threads) for number in range(seeds)]
    in_parallel([partial(_train, walk) for walk in walks], threads, progress)
    _draw(config, walks)
    results = Results.of(
        Result("own_return", "m", float(Policy.load(walk.out / POLICY).provenance["own_return"]), seed=walk.search.seed)
        for walk in walks
    )
    write_results(config.out, results)
    return results


def _of_seed(config: Walk, seed: int, threads: int) -> Walk:
    out, search = config.out / SEED_FOLDER.format(seed), replace(config.search, seed=seed)
    return replace(config, out=out, search=search, workers=max(1, config.workers // threads))


def _train(walk: Walk, progress: Progress) -> None:
    if not run_walk(walk, progress, f"walk, seed {walk.search.seed}"):
        progress.note(f"{walk.out} is finished with these settings: nothing was trained")


def _draw(config: Walk, walks: list[Walk]) -> None:
    from motorprior.report.plots_style import png_bytes
    from motorprior.report.plots_walk import seed_curves  # here, since it imports matplotlib

    metrics = [read_metrics(walk.out) for walk in walks]
    longest = max((each["iteration"] for each in metrics), key=len)

    def padded(values: np.ndarray) -> np.ndarray:
        return np.pad(values, (0, len(longest) - len(values)), mode="edge")  # a training that ended early

    quantities = {"mean return [m]": "return_mean", "time upright [-]": "upright"}
    curves = {title: np.array([padded(each[name]) for each in metrics]) for title, name in quantities.items()}
    with atomic_path(config.out / PICTURE) as temporary:
        temporary.write_bytes(png_bytes(seed_curves(longest, curves)))
