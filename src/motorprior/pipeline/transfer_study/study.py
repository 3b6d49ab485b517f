"""The transfer study: every condition, every seed, every twin; resumable per policy."""

from __future__ import annotations

from dataclasses import asdict, replace

from motorprior.artifacts import read_tensors, write_json, write_tensors
from motorprior.pipeline.progress import SILENT, Progress
from motorprior.pipeline.stage import locked, threads_here, write_results
from motorprior.pipeline.transfer_study.condition import Condition
from motorprior.pipeline.transfer_study.study_cells import walk_table
from motorprior.pipeline.transfer_study.study_conditions import adapt_robots, conditions, learn
from motorprior.pipeline.transfer_study.study_report import STUDY, TRACES, WALKS
from motorprior.pipeline.transfer_study.study_settings import OWN_MOTORS, Study
from motorprior.pipeline.transfer_study.study_spreads import with_spread
from motorprior.robots.load import load_robot
from motorprior.transfer.study_results import study_results
from motorprior.transfer.study_summary import Summary, summarise
from motorprior.transfer.walk_table import OWN_ABROAD


def run_study(config: Study, progress: Progress = SILENT) -> Summary:
    """Run every cell that is not finished; write walks.csv, traces, results.json and figures.json.

    Raises:
        MotorPriorError: settings out of range, or a stage cannot run; what is finished stays.
    """
    config = config.sized()
    robot = load_robot(config.robot)
    with locked(config.out):
        threads = threads_here(config.workers, progress)
        if config.ray_address is None:  # told once, not at every policy
            config = replace(config, workers=threads)
        learn(config, threads, progress)
        config = with_spread(config, progress)
        adapt_robots(config, threads, progress)
        cells = [(condition, seed) for seed in range(config.seeds) for condition in conditions(config, seed)]
        table = walk_table(config, cells, progress)
        table.save(config.out / WALKS)
        _keep_traces(config, cells)
        contests = config.fleet_of_contests(robot) or OWN_MOTORS
        settings = asdict(config) | {"speed": config.told(robot), "validation": contests}
        for where in ("out", "workers", "executor", "ray_address"):  # the result does not depend on them
            del settings[where]
        write_json(config.out / STUDY, {name: str(value) for name, value in settings.items()})
        summary = summarise(table)
        write_results(config.out, study_results(summary))
    return summary


def _keep_traces(config: Study, cells: list[tuple[Condition, int]]) -> None:
    """Of the first seed, for the page."""
    robot, kept = load_robot(config.robot), {}
    for condition, seed in cells:
        if seed == 0:
            traces, _ = read_tensors(config.out / "watched" / condition.folder(seed) / TRACES)
            kept |= {f"{place}/{condition.name}": trace for place, trace in traces.items() if place != OWN_ABROAD}
    write_tensors(config.out / TRACES, kept, {"control_dt": robot.control_dt, "robot": config.robot})
