"""The page of a study, from the files in its folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from motorprior.artifacts import read_json, read_tensors, write_text
from motorprior.exceptions import ArtifactError
from motorprior.pipeline.report import PAGE
from motorprior.pipeline.transfer_study.study_effort import effort_sections
from motorprior.pipeline.transfer_study.study_settings import AGAIN
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.transfer.study_summary import Summary, summarise
from motorprior.transfer.walk_table import WalkTable

WALKS, TRACES, STUDY, TABLES = "walks.csv", "traces.safetensors", "study.json", "tables.md"


def build_study_report(run: Path, command: str, summary: Summary | None = None) -> Path:
    """Write report.html and TABLES from WALKS, TRACES, STUDY and what the PDs took; returns the path of the first.

    Args:
        run: folder of a study.
        command: what makes the same page again, for the page.
        summary: of the same walks; made again, which takes a minute, if not given.

    Raises:
        ArtifactError: one of the files is missing or damaged.
        ConfigError: the robot is gone.
    """
    from motorprior.report.page import Report, write_report  # here: they import matplotlib, a second
    from motorprior.report.study_sections import first_paragraph, study_sections
    from motorprior.report.study_tables import headline_markdown, verdicts_markdown

    table = WalkTable.load(run / WALKS)
    traces, header = read_tensors(run / TRACES, _check_header)
    settings = read_json(run / STUDY)
    if not isinstance(settings, dict):
        raise ArtifactError("its settings are not a table", where=run / STUDY, remedy=AGAIN)
    robot, summary = load_robot(header["robot"]), summary or summarise(table)
    _check_traces(traces, robot, run / TRACES)
    first, effort = first_paragraph(summary), effort_sections(run)
    report = Report(
        title="Does a distribution of motors transfer?",
        subtitle=first,
        sections=(*study_sections(table, summary, traces, robot, header["control_dt"]), *effort),
        settings=settings,
        command=command,
    )
    write_report(run / PAGE, report)
    judged = (verdicts_markdown(summary.targets, "target"), verdicts_markdown(summary.claims, "the paper says"))
    write_text(run / TABLES, "\n".join((f"{first}\n", headline_markdown(summary), *judged)))
    return run / PAGE


def _check_header(header: Mapping[str, Any], path: Path) -> None:
    name, control_dt = header.get("robot"), header.get("control_dt")
    if not isinstance(name, str) or not isinstance(control_dt, float) or not control_dt > 0.0:
        raise ArtifactError("its header names no robot and control_dt", where=path, remedy=AGAIN)


def _check_traces(traces: Mapping[str, np.ndarray], robot: Robot, path: Path) -> None:
    for name, trace in traces.items():
        if trace.ndim != 2 or trace.shape[1] != 7 + robot.num_joints:
            problem = f"trace {name} has shape {trace.shape}, not (steps, {7 + robot.num_joints})"
            raise ArtifactError(problem, where=path, remedy=AGAIN)
