"""Evaluate policies in their training simulation and on the twin; the transfer study."""

import os
from collections import Counter
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from motorprior.artifacts import read_json, write_text
from motorprior.bench.fleet import fleet_files, load_robot_fleet
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
from motorprior.studies.transfer import SELECTION, study_walks


@dataclass(frozen=True)
class Transfer:
    """Evaluate policies in their training simulation and on the twin."""

    policies: tuple[Path, ...]
    """Folders of `motorprior walk`; seeds of one actuator model are averaged."""
    out: Path
    """Folder for figures.json."""
    fleet: str | None = None
    """The twin's fleet; the robot's own if not given."""
    engine: Engine | None = None
    """Engine of the training simulation; the one of the training if not given. The twin is always in MuJoCo."""
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md)."""
    workers: int = min(2, os.cpu_count() or 1)
    """Policies at a time; the result does not depend on it."""


def run_transfer(config: Transfer, progress: Progress = SILENT) -> Results:
    """Evaluate, or read the finished evaluation; errors for a policy, motors or a fleet that cannot be used."""
    robot = load_robot(config.robot)
    robot.require_gait()
    fleet = load_robot_fleet(robot, config.fleet)
    files = [path if path.is_file() else path / POLICY for path in config.policies]
    require_count("workers", config.workers)
    policies = [TrainedPolicy.load(path, robot) for path in files]
    settings = asdict(config)
    del settings["workers"]  # the result does not depend on it
    wanted = description(
        "transfer", settings, [*files, *fleet_files(robot, config.fleet), *robot.files]
    )
    if is_finished(config.out, wanted):
        return read_results(config.out)
    commands = compare.straight_ahead(
        compare.with_shared_speeds(robot, (each.policy for each in policies))
    )
    works = []
    seeds = Counter[str]()
    for each in policies:
        if warning := weight_warning(each.policy, robot):
            progress.warn(warning)
        walk = WalkConfig(
            compare.DURATION_STEPS, randomization=each.randomization, commands=commands
        )
        twin = compare.motors_scene(robot, each.policy, fleet, commands)
        scenes = {"own": each.scene(walk, config.engine), "twin": twin}
        condition = each.motors.condition
        works.append(partial(_evaluate, each, scenes, condition, seeds[condition]))
        seeds[condition] += 1
    with working(config.out, wanted):
        found = in_parallel(works, usable_threads(config.workers, progress), progress)
        write_results(config.out, Results(row for rows in found for row in rows))
    return read_results(config.out)


def _evaluate(
    trained: TrainedPolicy, scenes: dict[str, Scene], condition: str, seed: int, progress: Progress
) -> list[Result]:
    with progress.start(
        f"transfer of {trained.path.parent.name}: {len(scenes)} x {compare.NUM_WALKS} walks", 1
    ):
        return compare.evaluate(trained.policy, scenes, condition, seed)


def run_study(config: Study, progress: Progress = SILENT, command: str = "") -> StudyStatistics:
    """Run every stage that is not finished; write walks.csv, results.json, figures.json and report.html."""
    from motorprior.report.page import page  # here: they import matplotlib
    from motorprior.report.study import study_sections

    config.require_valid()
    with locked(config.out):
        found = summarise(study_walks(config, progress))
        write_results(config.out, found.as_results())
        validation = config.validation_fleet(load_robot(config.robot))
        selected = {
            name: read_json(config.out / SELECTION / f"{name}.json")["chosen"]
            for name in config.to_select()
        }
        settings = asdict(config) | {"speed": config.commanded, "validation": validation} | selected
        # the result does not depend on them
        for name in ("out", "workers", "executor", "ray_address"):
            del settings[name]
        write_text(
            config.out / PAGE, page("Transfer study", study_sections(found), settings, command)
        )
    return found
