"""The same training with several seeds, and one picture of how they went."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from motorprior.artifacts import atomic_path
from motorprior.bounds import require_count
from motorprior.locomotion.policy import Policy
from motorprior.pipeline.progress import SILENT, Progress
from motorprior.pipeline.stage import in_parallel, threads_here, write_results
from motorprior.pipeline.walking.walk import MOST_WORKERS, POLICY, Walk, require_possible, run_walk
from motorprior.pipeline.walking.walk_metrics import read_metrics
from motorprior.results import Result, Results

PICTURE, MOST_SEEDS, SEED_FOLDER = "seeds.png", 1000, "seed_{}"
SEEDS_APART = 1000
"""Policies of demos or studies with different seeds share no search seed."""


def run_walk_seeds(config: Walk, seeds: int, progress: Progress = SILENT) -> Results:
    """Train with ``seeds`` seeds from the search's own on, each in the folder seed_K of ``config.out``.

    Threads train several seeds side by side. What is finished is not trained again, what was interrupted goes on. The
    picture has the median and the quartiles of return and time upright over the iterations.

    Returns:
        The mean return [m] of each best policy in its own simulation, or on the validation fleet where there is one;
        it is in figures.json, too.

    Raises:
        ConfigError, ArtifactError, SimulationFault, KeyboardInterrupt: see `run_walk`. Settings that cannot be used
            are refused before any seed is touched; of what happens later the other seeds leave a checkpoint.
    """
    require_count("seeds", seeds, 1, MOST_SEEDS)
    require_count("workers", config.workers, 1, MOST_WORKERS)
    side = min(seeds, threads_here(config.workers, progress)) if config.executor == "threads" else 1
    walks = [_of_seed(config, config.search.seed + number, side) for number in range(seeds)]
    for walk in walks:  # all before the first begins, since that throws away what its folder held
        require_possible(walk)
    works = [partial(_train, walk) for walk in walks]
    in_parallel(works, side, progress)
    _draw(config, walks)
    rows = []
    for walk in walks:
        score = float(Policy.load(walk.out / POLICY).provenance["own_return"])
        rows.append(Result("own_return", "m", score, seed=walk.search.seed))
    results = Results.of(rows)
    write_results(config.out, results)
    return results


def _of_seed(config: Walk, seed: int, side: int) -> Walk:
    """The training with one seed, of ``side`` at a time."""
    workers, search = max(1, config.workers // side), replace(config.search, seed=seed)
    return replace(config, out=config.out / SEED_FOLDER.format(seed), search=search, workers=workers)


def _train(walk: Walk, progress: Progress) -> None:
    if not run_walk(walk, progress, f"walk, seed {walk.search.seed}"):
        progress.note(f"{walk.out} is finished with these settings: nothing was trained")


def _draw(config: Walk, walks: list[Walk]) -> None:
    from motorprior.report.plots_style import png_bytes
    from motorprior.report.plots_walk import seed_curves  # here: it imports matplotlib, which nothing else needs

    metrics = [read_metrics(walk.out) for walk in walks]
    quantities = {"mean return [m]": "return_mean", "time upright [-]": "upright"}
    longest = max((each["iteration"] for each in metrics), key=len)

    def held(values: np.ndarray) -> np.ndarray:
        """To the end of the longest: a training that ended early stays where it was."""
        return np.pad(values, (0, len(longest) - len(values)), mode="edge")

    curves = {title: np.array([held(each[name]) for each in metrics]) for title, name in quantities.items()}
    with atomic_path(config.out / PICTURE) as temporary:
        temporary.write_bytes(png_bytes(seed_curves(longest, curves)))
