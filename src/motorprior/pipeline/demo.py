"""The whole mission, small: logs, prior, simulation, policies, transfer, report."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar

from motorprior.artifacts import read_json, write_json
from motorprior.exceptions import ArtifactError
from motorprior.locomotion.command import Commands
from motorprior.pipeline.bench import Bench, run_bench
from motorprior.pipeline.demo_settings import Demo, comparison_of, require_settings, that_walks
from motorprior.pipeline.first_look.real_motors import RealMotors, Show, is_replayed, run_real_motors
from motorprior.pipeline.identify import PRIOR, Identify, run_identify
from motorprior.pipeline.motor_choice import MotorChoice
from motorprior.pipeline.progress import SILENT, Progress
from motorprior.pipeline.replay.replay import Replay, run_replay
from motorprior.pipeline.report import PAGE, REPLAYED, SETTINGS, STAGES, WALKER, build_report
from motorprior.pipeline.stage import FIGURES, MARKER, RESULTS, digest, in_parallel, locked, write_results
from motorprior.pipeline.transfer_study.robustness import Robustness, run_robustness
from motorprior.pipeline.transfer_study.transfer import Transfer, run_transfer
from motorprior.pipeline.validation.validate import GAINS_FILE, TUNED, Validate, run_validate
from motorprior.pipeline.walking.walk import Walk, run_walk
from motorprior.pipeline.walking.walk_seeds import SEEDS_APART
from motorprior.results import Result, Results
from motorprior.robots.load import load_robot
from motorprior.search.ars import ArsConfig
from motorprior.simulation.randomization import Randomization

_EPISODE_STEPS, _HOLD = 500, 1.25
"""Control steps of an episode of training, and seconds that a command is held: less than `Walk` has by default."""
PRESETS = ("rollout", "paper", "one_network", "paper_wide")
Made = TypeVar("Made")


@dataclass(frozen=True)
class DemoResult:
    """What a demo found.

    Attributes:
        results: every measurement; also in results.json and, by name, in figures.json.
        page: the report.
    """

    results: Results
    page: Path


def run_demo(
    config: Demo,
    progress: Progress = SILENT,
    started: float | None = None,
    command: str = "",
    show: Show = lambda found, lines: None,
) -> DemoResult:
    """Run every stage that is not finished; the report is written after those that say most, and at the end.

    Args:
        config: settings.
        progress: where to report to.
        started: time.monotonic() when the process began, so that ``seconds`` counts imports; now if not given.
        command: what makes the same page again, for the page.
        show: called with how the motors of real logs compare, as soon as that is known.

    Raises:
        MotorPriorError: a stage cannot run; what is finished stays.
    """
    started = time.monotonic() if started is None else started
    given, config = config, that_walks(config)
    comparison = comparison_of(given)
    replayed = comparison is not None and is_replayed(comparison, config.robot)
    require_settings(config, replayed)
    settings = asdict(given) | {"out": str(given.out), "logs": None if given.logs is None else str(given.logs)}
    settings |= {WALKER: config.robot, REPLAYED: replayed}
    with locked(config.out):
        _write_if_changed(config.out / SETTINGS, {"settings": settings, "command": command or repr(config)})
        results = _all_stages(config, comparison, replayed, progress, show)
        page = build_report(config.out)
        results += Results((Result("seconds", "s", time.monotonic() - started),))
        write_results(config.out, results)
    return DemoResult(results, page)


def _all_stages(config: Demo, comparison: RealMotors | None, replayed: bool, progress: Progress, show: Show) -> Results:
    """Of the run folder; all results are written before the page is, which shows some."""
    for name in (RESULTS, FIGURES):  # or the page would show those of other settings
        (config.out / name).unlink(missing_ok=True)
    stages = _Stages(config.out)
    results = Results()
    if comparison is not None:
        results += stages.run("real_motors", lambda: run_real_motors(comparison, progress, show))
        _page_so_far(config.out)
        progress.note(f"your motors: {config.out / PAGE}; from here on motors are those of a virtual {config.robot}")
    _learn(config, stages, progress)
    results += stages.run("validate", lambda: _validate(config, progress))
    _page_so_far(config.out)
    if replayed:
        results += stages.run("replay", lambda: _replay(config, config.logs, progress))
    _train_policies(config, stages, progress)
    results += stages.run("transfer", lambda: _transfer(config, progress))
    _map_robustness(config, stages, progress)
    write_results(config.out, results)
    return results


class _Stages:
    """The stages that the present settings asked for, in ``stages.json``: folder -> digest of its marker.

    The page shows these only: whatever else lies in the run folder is of other settings.
    """

    def __init__(self, run: Path):
        """Take the folder; from here on no stage belongs to it until it has been asked for."""
        self._run, self._found, self._lock = run, {}, Lock()
        write_json(run / STAGES, self._found)

    def run(self, folder: str, work: Callable[[], Made]) -> Made:
        """Run the stage of a folder, or find it finished."""
        result = work()
        with self._lock:
            self._found[folder] = digest(self._run / folder / MARKER)
            write_json(self._run / STAGES, self._found)
        return result

    def run_all(self, works: Mapping[str, Callable[[Progress], object]], threads: int, progress: Progress) -> None:
        """Run the stages of several folders, ``threads`` at a time, or find them finished."""
        stages = [
            lambda progress, folder=folder, work=work: self.run(folder, partial(work, progress))
            for folder, work in works.items()
        ]
        in_parallel(stages, threads, progress)


def _learn(config: Demo, stages: _Stages, progress: Progress) -> None:
    out = config.out
    for preset in ("rollout", "paper"):
        bench = Bench(
            out / "bench" / preset, config.fleet, preset, config.motors, config.bench_steps, config.seed, config.robot
        )
        stages.run(f"bench/{preset}", lambda bench=bench: run_bench(bench, progress))
    _page_so_far(out)
    progress.note(f"first pictures: {out / PAGE}")
    fits = {}
    for preset in PRESETS:
        folder = "paper" if preset == "paper" else "rollout"
        identify = Identify(out / "bench" / folder, out / "priors" / preset, preset, config.seed, config.adam_steps)
        fits[f"priors/{preset}"] = partial(run_identify, identify)
    stages.run_all(fits, config.workers, progress)


def _train_policies(config: Demo, stages: _Stages, progress: Progress) -> None:
    """One thread per policy: threads of one search would wait for its slowest episode in every iteration."""
    robot = load_robot(config.robot)
    longest_first = sorted(_walks(config), key=lambda walk: walk.motors.physics_dt(robot))  # or one would end up alone
    works = {
        f"walk/{walk.out.name}": partial(run_walk, walk, name=f"walk on {walk.out.name}") for walk in longest_first
    }
    stages.run_all(works, config.workers, progress)


def _map_robustness(config: Demo, stages: _Stages, progress: Progress) -> None:
    """Of the first policy of every condition."""
    first = [walk.out for walk in _walks(config) if walk.out.name.endswith("_0")]
    works = {
        f"robustness/{walk.name}": partial(
            run_robustness, Robustness(walk, config.out / "robustness" / walk.name, config.robot, workers=1)
        )
        for walk in first
    }
    stages.run_all(works, config.workers, progress)


def _page_so_far(out: Path) -> None:
    """Write the page again, unless it is younger than settings and every finished stage: drawing it takes seconds."""
    page, sources = out / PAGE, (out / SETTINGS, *out.rglob(MARKER))
    if not page.is_file() or page.stat().st_mtime_ns < max(path.stat().st_mtime_ns for path in sources):
        build_report(out)


def _write_if_changed(path: Path, value: Any) -> None:
    """JSON; its time stays that of the last change."""
    with suppress(ArtifactError):  # none there, or a damaged one
        if read_json(path) == value:
            return
    write_json(path, value)


def _validate(config: Demo, progress: Progress) -> Results:
    priors = tuple(config.out / "priors" / preset / PRIOR for preset in PRESETS)
    return run_validate(
        Validate(priors, config.out / "validate", config.seed, held_out=False, robot=config.robot), progress
    )


def _replay(config: Demo, logs: Path | None, progress: Progress) -> Results:
    assert logs is not None
    prior = config.out / "priors" / "rollout" / PRIOR
    posture = "hung" if config.hung else "auto"
    replay = Replay(
        logs, prior, config.out / "replay", config.fleet, seed=config.seed, robot=config.robot, posture=posture
    )
    return run_replay(replay, progress)


def _walks(config: Demo) -> list[Walk]:
    """Every policy to train, first seeds first."""
    gains, tuned = (read_json(config.out / "validate" / name) for name in (GAINS_FILE, TUNED))
    conditions = {
        "rollout": MotorChoice("prior", config.out / "priors" / "rollout" / PRIOR, fleet=config.fleet),
        "oracle": MotorChoice("fleet", fleet=config.fleet),
        "ideal_pd": MotorChoice("pd", fleet=config.fleet, **gains),
        "tuned_pd": MotorChoice("pd", fleet=config.fleet, **tuned),
        "paper": MotorChoice("prior", config.out / "priors" / "paper" / PRIOR, fleet=config.fleet),
    }
    policies = config.seeds * len(conditions)
    return [
        Walk(
            config.out / "walk" / f"{name}_{seed}",
            motors,
            iterations=config.iterations,
            episode_steps=_EPISODE_STEPS,
            commands=Commands(hold=_HOLD),
            randomization=Randomization(),  # the motors alone differ between conditions
            search=ArsConfig(seed=SEEDS_APART * config.seed + seed),
            workers=max(1, config.workers // policies),  # more than one where cores are left over
            robot=config.robot,
        )
        for seed in range(config.seeds)
        for name, motors in conditions.items()
    ]


def _transfer(config: Demo, progress: Progress) -> Results:
    walks = tuple(sorted(walk.out for walk in _walks(config)))
    transfer = Transfer(walks, config.out / "transfer", config.fleet, robot=config.robot, workers=config.workers)
    return run_transfer(transfer, progress)
