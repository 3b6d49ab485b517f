"""The command walk: the return of the best policy is printed, and how to play it."""

from pathlib import Path

from motorprior.cli.terminal import print_table
from motorprior.commands.walk import PICTURE, Walk, run_walk, run_walk_seeds
from motorprior.progress import Progress
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.training import SEED_FOLDER


def run(config: Walk, progress: Progress) -> None:
    """Train one seed or several, and print the returns of the best policies."""
    folder = _train(config, progress) if config.seeds == 1 else _train_seeds(config, progress)
    robot_option = "" if config.robot == DEFAULT_ROBOT else f" --robot {config.robot}"
    print(f"play it: motorprior play {folder}{robot_option}")


def _train(config: Walk, progress: Progress) -> Path:
    """Train one seed; returns the folder of its policy."""
    provenance = run_walk(config, progress).provenance
    iteration = provenance["iteration"]
    mean_return = provenance["best_return"]
    print(
        f"best policy: iteration {iteration}, mean return {mean_return:.2f} m "
        f"on {_evaluation_motors(config)}"
    )
    if mean_return < 0.0:
        progress.warn(
            "a negative return: the robot falls or barely walks -> play it; "
            "if it falls at once, check the motors and the model, or else train longer"
        )
    return config.out


def _train_seeds(config: Walk, progress: Progress) -> Path:
    """Train several seeds; returns the folder of the best policy."""
    results = run_walk_seeds(config, progress)
    rows = [(str(row.seed), f"{row.value:.2f}") for row in results]
    title = f"Best policies on {_evaluation_motors(config)}"
    print_table(title, ("seed", "mean return [m]"), rows)
    print(config.out / PICTURE)
    best = max(results, key=lambda row: row.value)
    return config.out / SEED_FOLDER.format(best.seed)


def _evaluation_motors(config: Walk) -> str:
    if config.validation is None:
        return "its training simulation"
    return f"validation motors ({config.validation})"
