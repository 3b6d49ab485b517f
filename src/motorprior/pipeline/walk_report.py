"""The page of some trained policies: how they learned, and how they walk where they were trained."""

from __future__ import annotations

from pathlib import Path

from motorprior.exceptions import ConfigError
from motorprior.pipeline.report import PAGE
from motorprior.pipeline.transfer import walker_of
from motorprior.pipeline.walk import CURVE, POLICY
from motorprior.robots.load import load_robot
from motorprior.transfer.study import STUDY_SEED


def build_walk_report(run: Path, robot_name: str, command: str) -> Path:
    """Write report.html beside the policies found in ``run`` or one folder below it; returns its path.

    Args:
        run: folder of one training, or of several.
        robot_name: name or .toml file of the robot that walks.
        command: what makes the same page again, for the page.

    Raises:
        ConfigError: no policy there.
        ArtifactError, ConfigError: a policy that cannot be read, or whose motors are gone.
    """
    from motorprior.report import sections  # here: they import matplotlib, a second that nothing else needs
    from motorprior.report.page import Report, write_report

    folders = [path.parent for path in sorted((*run.glob(POLICY), *run.glob(f"*/{POLICY}")))]
    if not folders:
        raise ConfigError(
            f"no {POLICY} in it or one folder below", where=run,
            remedy="give a folder that `motorprior demo` or `motorprior walk` wrote",
        )  # fmt: skip
    robot, traces = load_robot(robot_name), {}
    for folder in folders:
        walker = walker_of(folder / POLICY, robot)
        policy = walker.policy
        episode = walker.own.run(
            policy.weights, policy.observation_mean, policy.observation_std, STUDY_SEED, trace=True
        )
        traces.setdefault(walker.condition, episode.trace)
        walker.own.close()
    learned = sections.walk([folder for folder in folders if (folder / CURVE).is_file()])
    report = Report(
        title="motorprior",
        subtitle=f"Robot {robot.name}: policies trained on samples of its motors.",
        sections=(*learned, sections.gaits(robot, traces, robot.control_dt)),
        settings={"robot": robot_name, "policies": len(folders)},
        command=command,
    )
    write_report(run / PAGE, report)
    return run / PAGE
