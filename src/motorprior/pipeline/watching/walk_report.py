"""The page of some trained policies: how they learned, and how they walk where they were trained."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from motorprior.artifacts import dotted
from motorprior.exceptions import ConfigError, cut
from motorprior.locomotion.policy import Policy
from motorprior.pipeline.progress import SILENT, Progress
from motorprior.pipeline.report import PAGE
from motorprior.pipeline.transfer_study.robustness import robustness
from motorprior.pipeline.transfer_study.transfer import trained_walk
from motorprior.pipeline.walking.walk import CURVE, POLICY
from motorprior.robots.load import load_robot
from motorprior.transfer.twin import EVALUATION_SEED

_OF_A_SEED = ("iteration", "own_return", "start_sha256", "search.seed")
"""What differs between policies of one kind."""
_MOST = 3
"""Settings in a name."""
_LONGEST = 40
"""Bytes of each."""


def kinds_of(policies: Sequence[tuple[str, Policy]]) -> list[str]:
    """What each policy is called on a page: by its motors, and where trainings on these differed, by how they did.

    Policies that have one name are seeds of one training.

    Args:
        policies: the name of its motors, and the policy.
    """
    settings = [_settings(policy) for _, policy in policies]
    called: dict[str, dict[str, Any]] = {}
    names = []
    for (condition, _), mine in zip(policies, settings, strict=True):
        same = [each for (other, _), each in zip(policies, settings, strict=True) if other == condition]
        every = dict.fromkeys(key for each in same for key in each)
        differs = [key for key in every if any(each.get(key) != mine.get(key) for each in same)]
        told = ", ".join(_in_words(key, mine.get(key)) for key in differs[:_MOST])
        name = f"{condition} ({told})" if told else condition
        while called.setdefault(name, mine) != mine:  # what differs did not fit in
            name += "'"
        names.append(name)
    return names


def _settings(policy: Policy) -> dict[str, Any]:
    """What was trained and how, by name; a file counts by its content."""
    began = "from the gait" if policy.provenance.get("start_sha256") is None else "from a policy"
    trained = {"gait": policy.gait, "hidden_units": len(policy.hidden), "begun": began} | dotted(policy.provenance)
    return {key: value for key, value in trained.items() if not (key in _OF_A_SEED or key.endswith("_beside"))}


def _in_words(key: str, value: Any) -> str:
    shown = " to ".join(map(str, value)) if isinstance(value, list) else str(value)
    if key.endswith("_sha256"):
        key, shown = key.removesuffix("_sha256"), shown[:8]
    return cut(f"{key.split('.')[-1].replace('_', ' ')} {shown}", _LONGEST)


def build_walk_report(
    run: Path, robot_name: str, command: str, with_robustness: bool = True, progress: Progress = SILENT
) -> Path:
    """Write report.html beside the policies found in ``run`` or one folder below it; returns its path.

    Args:
        run: folder of one training, or of several.
        robot_name: name or .toml file of the robot that walks.
        command: what makes the same page again, for the page.
        with_robustness: also measure `robustness.robustness` of each policy that is shown, some ten seconds each.
        progress: where to report to.

    Raises:
        ConfigError: no policy there, or no folder.
        ArtifactError, ConfigError: a policy that cannot be read, or whose motors are gone.
    """
    from motorprior.report.gait_sections import gaits, robustness_section  # here: they import matplotlib, which is slow
    from motorprior.report.learning import learning
    from motorprior.report.page import Report, write_report

    folders = [path.parent for path in sorted((*run.glob(POLICY), *run.glob(f"*/{POLICY}")))]
    if run.is_file():
        raise ConfigError("not a folder", where=run, remedy=f"give the folder of the policy: {run.parent}")
    if not folders:
        raise ConfigError(
            f"no {POLICY} in it or one folder below", where=run,
            remedy="give a folder that `motorprior demo` or `motorprior walk` wrote",
        )  # fmt: skip
    robot, traces, maps = load_robot(robot_name), {}, {}
    told = []
    for folder in folders:
        walker = trained_walk(folder / POLICY, robot)
        walker.simulator.close()
        told.append((walker.condition, walker.policy))
    kinds = kinds_of(told)
    for folder, kind in zip(folders, kinds, strict=True):
        if kind not in traces:  # of several seeds the first is shown
            walker = trained_walk(folder / POLICY, robot)
            traces[kind] = walker.simulator.run(walker.policy.arrays(), EVALUATION_SEED, trace=True).trace
            walker.simulator.close()
            if with_robustness:
                maps[kind] = robustness(folder / POLICY, robot, min(2, os.cpu_count() or 1), progress)
    learned: dict[str, list[Path]] = {}
    for folder, kind in zip(folders, kinds, strict=True):
        if (folder / CURVE).is_file():
            learned.setdefault(kind, []).append(folder)
    report = Report(
        title="motorprior",
        subtitle=f"Robot {robot.name}: policies trained on samples of its motors.",
        sections=(
            *(learning(learned) if learned else ()),
            gaits(robot, traces, robot.control_dt),
            *([robustness_section(maps)] if maps else []),
        ),
        settings={"robot": robot_name, "policies": len(folders)},
        command=command,
    )
    write_report(run / PAGE, report)
    return run / PAGE
