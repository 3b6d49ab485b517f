"""Evaluate policies in their training simulation and on the twin; the transfer study."""

import os
from collections import Counter
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from motorprior.actuator.fleet import fleet_files, load_robot_fleet
from motorprior.artifacts import write_text
from motorprior.bounds import require_count
from motorprior.progress import SILENT, Progress, in_parallel, usable_threads
from motorprior.results import Result, Results, read_results, write_results
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.scene import Engine, Scene, WalkConfig
from motorprior.simulation.training import POLICY, weight_warning
from motorprior.stage import PAGE, description, is_finished, locked, working
from motorprior.studies import compare
from motorprior.studies.compare import TrainedPolicy
from motorprior.studies.statistics import StudyStatistics, summarise
from motorprior.studies.study_settings import Study
from motorprior.studies.transfer import study_walks


@dataclass(frozen=True)
class Transfer:
    """Evaluate policies in their training simulation and on the twin."""

    policies: tuple[Path, ...]
    """Folders of `motorprior walk`. Results of policies with the same training motors are averaged
    over their seeds."""
    out: Path
    """Folder for figures.json."""
    fleet: str | None = None
    """Fleet of the twin's motors; the robot's fleet if not given."""
    engine: Engine | None = None
    """Engine of the walks in the training simulation; the engine of the training if not given. The
    twin is always simulated in MuJoCo."""
    robot: str = DEFAULT_ROBOT
    """Robot: name of a shipped robot, or the .toml file of your robot (docs/your-robot.md)."""
    workers: int = min(2, os.cpu_count() or 1)
    """Number of policies evaluated at a time; the result does not depend on it."""


@dataclass(frozen=True)
class TransferCommand(Transfer, Study):
    """Evaluate policies on held-out robots, or run the study."""

    policies: tuple[Path, ...] = ()
    study: bool = False
    """Train policies on each model of a bench's motors, and evaluate them in their training
    simulation and in five environments: three to four hours on two cores; a rerun resumes. Study
    options require it."""


def run_transfer(
    config: Transfer, progress: Progress = SILENT, num_walks: int = compare.NUM_WALKS
) -> Results:
    """Evaluate the policies with this number of walks each, or read the finished evaluation.

    Raises ArtifactError or ConfigError for a policy, motors or a fleet that cannot be used.
    """
    robot = load_robot(config.robot)
    robot.require_gait()
    require_count("workers", config.workers)
    fleet = load_robot_fleet(robot, config.fleet)
    files = [path if path.is_file() else path / POLICY for path in config.policies]
    policies = [TrainedPolicy.load(path, robot) for path in files]

    settings = asdict(config)
    del settings["workers"]  # the result does not depend on it
    if num_walks != compare.NUM_WALKS:
        settings["num_walks"] = num_walks
    inputs = [*files, *fleet_files(robot, config.fleet), *robot.files]
    stage = description("transfer", settings, inputs)
    if is_finished(config.out, stage):
        return read_results(config.out)

    shared_speeds = compare.with_shared_speeds(robot, (trained.policy for trained in policies))
    commands = compare.straight_ahead(shared_speeds)
    works = []
    seeds = Counter[str]()
    for trained in policies:
        warning = weight_warning(trained.policy, robot)
        if warning:
            progress.warn(warning)
        walk = WalkConfig(
            compare.DURATION_STEPS, randomization=trained.randomization, commands=commands
        )
        scenes = {
            "own": trained.scene(walk, config.engine),
            "twin": compare.motors_scene(robot, trained.policy, fleet, commands),
        }
        condition = trained.motors.condition
        seed = seeds[condition]
        works.append(partial(_evaluate, trained, scenes, condition, seed, num_walks))
        seeds[condition] += 1

    with working(config.out, stage):
        threads = usable_threads(config.workers, progress)
        rows_of_policies = in_parallel(works, threads, progress)
        write_results(config.out, Results(row for rows in rows_of_policies for row in rows))
    return read_results(config.out)


def _evaluate(
    trained: TrainedPolicy,
    scenes: dict[str, Scene],
    condition: str,
    seed: int,
    num_walks: int,
    progress: Progress,
) -> list[Result]:
    name = trained.path.parent.name
    title = f"transfer of {name}: {len(scenes)} x {num_walks} walks"
    with progress.start(title, 1):
        return compare.evaluate(trained.policy, scenes, condition, seed, num_walks)


def run_study(config: Study, progress: Progress = SILENT, command: str = "") -> StudyStatistics:
    """Run every stage that is not finished.

    Writes walks.csv, results.json, figures.json and report.html; ``command`` makes the same page.
    """
    from motorprior.report.transfer_page import transfer_page  # here: it imports matplotlib

    config.require_valid()
    with locked(config.out):
        walks, study = study_walks(config, progress)
        summary = summarise(walks)
        write_results(config.out, summary.as_results())
        settings = _settings_on_page(study)
        write_text(config.out / PAGE, transfer_page(summary, settings, command))
    return summary


def _settings_on_page(study: Study) -> dict[str, Any]:
    """Settings of a study, with those that the study has selected."""
    settings = asdict(study)
    settings["speed"] = study.commanded
    settings["validation"] = study.validation_fleet(load_robot(study.robot))
    # the result does not depend on them
    for name in ("out", "workers", "executor", "ray_address"):
        del settings[name]
    return settings
