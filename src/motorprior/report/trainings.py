"""The page of trained policies: learning curves, and films in the training simulation."""

from __future__ import annotations

import re
from pathlib import Path

from motorprior.artifacts import write_text
from motorprior.exceptions import ConfigError
from motorprior.report.chapters import gaits, learning
from motorprior.report.page import page
from motorprior.robots.load import load_robot
from motorprior.simulation.scene import WalkConfig
from motorprior.stage import PAGE
from motorprior.studies.compare import DURATION_STEPS, POLICY, TrainedPolicy, run_walks, straight_ahead


def write_training_page(run: Path, robot_name: str, command: str) -> Path:
    """Write report.html on the policies in ``run`` or one folder below it; returns its path.

    Folders with the same name except for a number, such as slow_0 and slow_1, are seeds of one training; the page has
    a film of the first seed.

    Args:
        run: folder of one training, or of several.
        robot_name: name or .toml file of the robot.
        command: the command that makes the same page.

    Raises:
        ConfigError, ArtifactError: no policy there, or one that cannot be read or whose motors cannot be found.
    """
    trainings: dict[str, list[Path]] = {}
    for policy in sorted((*run.glob(POLICY), *run.glob(f"*/{POLICY}"))):
        trainings.setdefault(_training(run, policy.parent), []).append(policy.parent)
    if not trainings:
        remedy = "give a folder that `motorprior walk` wrote"
        raise ConfigError(f"no {POLICY} in it or one folder below", where=run, remedy=remedy)
    robot, traces, learned = load_robot(robot_name), {}, {}
    for name, seeds in trainings.items():
        trained = TrainedPolicy.load(seeds[0] / POLICY, robot)
        walk = WalkConfig(DURATION_STEPS, randomization=trained.randomization, commands=straight_ahead(trained.robot))
        traces[name] = run_walks(trained.scene(walk), trained.policy.arrays, [0])[0].trace
        if with_curve := [folder for folder in seeds if (folder / "curve.json").is_file()]:
            learned[name] = with_curve
    sections = [*([learning(learned)] if learned else []), gaits(robot, traces)]
    settings = {"robot": robot_name, "policies": sum(map(len, trainings.values()))}
    write_text(run / PAGE, page(f"Policies of robot {robot.name}", sections, settings, command))
    return run / PAGE


def _training(run: Path, folder: Path) -> str:
    """Name of the training: its folder without the number of a seed."""
    stem = re.sub(r"_\d+$", "", folder.name)
    return run.resolve().name if folder == run or stem == "seed" else stem
