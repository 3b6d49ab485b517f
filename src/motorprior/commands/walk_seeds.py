"""One training with several seeds, and a plot of their learning curves."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from motorprior.artifacts import atomic_path, read_json
from motorprior.bounds import require_count
from motorprior.commands.walk import CURVE, POLICY, Walk, run_walk
from motorprior.locomotion.policy import Policy
from motorprior.progress import SILENT, Progress, in_parallel, usable_threads
from motorprior.results import Result, Results
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
    walks = [
        replace(
            config, out=config.out / SEED_FOLDER.format(seed), search=replace(config.search, seed=seed),
            workers=max(1, config.workers // threads),
        )
        for seed in range(config.search.seed, config.search.seed + seeds)
    ]  # fmt: skip
    in_parallel([partial(_train, walk) for walk in walks], threads, progress)
    _draw(config, walks)
    results = Results.of(
        Result("own_return", "m", float(Policy.load(walk.out / POLICY).provenance["own_return"]), seed=walk.search.seed)
        for walk in walks
    )
    write_results(config.out, results)
    return results


def _train(walk: Walk, progress: Progress) -> None:
    if not run_walk(walk, progress, f"walk, seed {walk.search.seed}"):
        progress.note(f"{walk.out} is finished with these settings: nothing was trained")


def _draw(config: Walk, walks: list[Walk]) -> None:
    from motorprior.report.plots_style import png_bytes
    from motorprior.report.plots_walk import seed_curves  # here, since it imports matplotlib

    curves = [read_json(walk.out / CURVE) for walk in walks]
    longest = max(map(len, curves))

    def values(name: str) -> np.ndarray:
        rows = [np.array([point[name] for point in curve]) for curve in curves]
        return np.array([np.pad(row, (0, longest - len(row)), mode="edge") for row in rows])  # some ended early

    quantities = {
        "mean return [m]": values("mean_return"),
        "time upright [-]": values("mean_steps") / config.episode_steps,
    }
    with atomic_path(config.out / PICTURE) as temporary:
        temporary.write_bytes(png_bytes(seed_curves(np.arange(longest), quantities)))
