"""The page of some trained policies: how they learned, and how they walk where they were trained."""

from __future__ import annotations

import os
from pathlib import Path

from motorprior.exceptions import ConfigError
from motorprior.pipeline.progress import SILENT, Progress
from motorprior.pipeline.report import PAGE
from motorprior.pipeline.robustness import robustness
from motorprior.pipeline.transfer import walker_of
from motorprior.pipeline.walk import CURVE, POLICY
from motorprior.robots.load import load_robot
from motorprior.transfer.study import STUDY_SEED


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
        ConfigError: no policy there.
        ArtifactError, ConfigError: a policy that cannot be read, or whose motors are gone.
    """
    from motorprior.report import sections  # here: they import matplotlib, a second that nothing else needs
    from motorprior.report.gait_sections import gaits, robustness_section
    from motorprior.report.page import Report, write_report

    folders = [path.parent for path in sorted((*run.glob(POLICY), *run.glob(f"*/{POLICY}")))]
    if not folders:
        raise ConfigError(
            f"no {POLICY} in it or one folder below", where=run,
            remedy="give a folder that `motorprior demo` or `motorprior walk` wrote",
        )  # fmt: skip
    robot, traces, maps = load_robot(robot_name), {}, {}
    for folder in folders:
        walker = walker_of(folder / POLICY, robot)
        if walker.condition not in traces:  # of several seeds the first is shown
            traces[walker.condition] = walker.own.run(walker.policy.arrays(), STUDY_SEED, trace=True).trace
            if with_robustness:
                maps[walker.condition] = robustness(folder / POLICY, robot, min(2, os.cpu_count() or 1), progress)
        walker.own.close()
    learned = sections.walk([folder for folder in folders if (folder / CURVE).is_file()])
    report = Report(
        title="motorprior",
        subtitle=f"Robot {robot.name}: policies trained on samples of its motors.",
        sections=(*learned, gaits(robot, traces, robot.control_dt), *([robustness_section(maps)] if maps else [])),
        settings={"robot": robot_name, "policies": len(folders)},
        command=command,
    )
    write_report(run / PAGE, report)
    return run / PAGE
