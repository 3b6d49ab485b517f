"""Robustness maps of a policy, on its training motors."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from motorprior.artifacts import read_json, write_json
from motorprior.commands.walk import POLICY
from motorprior.progress import SILENT, Progress
from motorprior.robots.load import load_robot
from motorprior.stage import description, is_finished, working
from motorprior.studies.robustness import UprightMap, robustness

MAPS = "robustness.json"


def run_robustness(walk: Path, out: Path, robot_name: str, progress: Progress = SILENT) -> list[UprightMap]:
    """Measure the maps of the policy in the folder ``walk``, or read those that ``out`` has.

    Raises:
        ArtifactError, ConfigError: an unreadable policy, or missing motors.
    """
    robot, path = load_robot(robot_name), walk / POLICY
    wanted = description("robustness", {"robot": robot_name, "file": MAPS}, [path, *robot.files])
    if not is_finished(out, wanted):
        with working(out, wanted):
            write_json(out / MAPS, [asdict(each) for each in robustness(path, robot, progress=progress)])
    return [UprightMap(**each) for each in read_json(out / MAPS)]
