"""A small run of everything: logs, prior, simulation, policies, transfer, report."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from threading import Lock
from typing import TypeVar

from motorprior.artifacts import read_json, write_json
from motorprior.locomotion.command import Commands
from motorprior.pipeline.bench import Bench, run_bench
from motorprior.pipeline.demo_settings import Demo, comparison_of, require_settings, that_walks
from motorprior.pipeline.first_look.real_motors import Show, is_replayed, run_real_motors
from motorprior.pipeline.identify import PRIOR, Identify, run_identify
from motorprior.pipeline.motor_choice import MotorChoice
from motorprior.pipeline.progress import SILENT, Progress
from motorprior.pipeline.replay.replay import Replay, run_replay
from motorprior.pipeline.report import REPLAYED, SETTINGS, STAGES, WALKER, build_report
from motorprior.pipeline.stage import FIGURES, RESULTS, in_parallel, locked, write_results
from motorprior.pipeline.transfer_study.robustness import Robustness, run_robustness
from motorprior.pipeline.transfer_study.transfer import Transfer, run_transfer
from motorprior.pipeline.validation.validate import GAINS_FILE, TUNED, Validate, run_validate
from motorprior.pipeline.walking.walk import Walk, run_walk
from motorprior.pipeline.walking.walk_seeds import SEEDS_APART
from motorprior.results import Results
from motorprior.robots.load import load_robot
from motorprior.search.ars import ArsConfig
from motorprior.simulation.randomization import Randomization

# control steps of a training episode, and seconds between commands: less than the defaults of `Walk`
_EPISODE_STEPS, _HOLD = 500, 1.25
PRESETS = ("rollout", "paper", "one_network", "paper_wide")
Made = TypeVar("Made")


@dataclass(frozen=True)
class DemoResult:
    """Every measurement, also in results.json and, by name, in figures.json; and the path of the report."""

    results: Results
    page: Path


def run_demo(
    config: Demo,
    progress: Progress = SILENT,
    command: str = "",
    show: Show = lambda found, lines: None,
) -> DemoResult:
    """Run every stage that is not finished; the report is written after some stages and at the end.

    Args:
        config: settings.
        progress: where to report to.
        command: the command that makes the same page, for the page.
        show: called with the comparison of the motors of real logs, as soon as it is known.

    Raises:
        MotorPriorError: a stage cannot run; finished stages remain.
    """
    given, config = config, that_walks(config)
    comparison = comparison_of(given)
    replayed = comparison is not None and is_replayed(comparison, config.robot)
    require_settings(config, replayed)
    settings = asdict(given) | {"out": str(given.out), "logs": None if given.logs is None else str(given.logs)}
    settings |= {WALKER: config.robot, REPLAYED: replayed}
    with locked(config.out):
        write_json(config.out / SETTINGS, {"settings": settings, "command": command or repr(config)})
        for name in (RESULTS, FIGURES):  # those of other settings
            (config.out / name).unlink(missing_ok=True)
        stages, results = _Stages(config.out), Results()
        if comparison is not None:
            results += stages.run("real_motors", lambda: run_real_motors(comparison, progress, show))
            progress.note(f"your motors: {build_report(config.out)}; the next stages use a virtual {config.robot}")
        _learn(config, stages, progress)
        results += stages.run("validate", lambda: _validate(config, progress))
        progress.note(f"first pictures: {build_report(config.out)}")
        if replayed:
            results += stages.run("replay", lambda: _replay(config, config.logs, progress))
        _train_policies(config, stages, progress)
        results += stages.run("transfer", lambda: _transfer(config, progress))
        _map_robustness(config, stages, progress)
        write_results(config.out, results)
        return DemoResult(results, build_report(config.out))


class _Stages:
    """The finished stages of the present settings, in ``stages.json``: the page shows no others."""

    def __init__(self, run: Path):
        """Begin an empty list in the folder of the run."""
        self._run, self._finished, self._lock = run, [], Lock()
        write_json(run / STAGES, [])

    def run(self, folder: str, work: Callable[[], Made]) -> Made:
        """Run the stage of a folder, or read its results if it is finished."""
        result = work()
        with self._lock:
            self._finished.append(folder)
            write_json(self._run / STAGES, sorted(self._finished))
        return result

    def run_all(self, works: Mapping[str, Callable[[Progress], object]], threads: int, progress: Progress) -> None:
        """Run the stages of several folders, ``threads`` at a time."""
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
    fits = {}
    for preset in PRESETS:
        folder = "paper" if preset == "paper" else "rollout"
        identify = Identify(out / "bench" / folder, out / "priors" / preset, preset, config.seed, config.adam_steps)
        fits[f"priors/{preset}"] = partial(run_identify, identify)
    stages.run_all(fits, config.workers, progress)


def _train_policies(config: Demo, stages: _Stages, progress: Progress) -> None:
    """One thread per policy: threads of one search would wait for its slowest episode in every iteration."""
    robot = load_robot(config.robot)
    # the longest training first, otherwise it runs alone at the end
    longest_first = sorted(_walks(config), key=lambda walk: walk.motors.physics_dt(robot))
    works = {
        f"walk/{walk.out.name}": partial(run_walk, walk, name=f"walk on {walk.out.name}") for walk in longest_first
    }
    stages.run_all(works, config.workers, progress)


def _map_robustness(config: Demo, stages: _Stages, progress: Progress) -> None:
    """Robustness of the first policy of every condition."""
    first = [walk.out for walk in _walks(config) if walk.out.name.endswith("_0")]
    works = {
        f"robustness/{walk.name}": partial(
            run_robustness, Robustness(walk, config.out / "robustness" / walk.name, config.robot, workers=1)
        )
        for walk in first
    }
    stages.run_all(works, config.workers, progress)


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
    """Trainings of all policies, the first seed of every condition first."""
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
