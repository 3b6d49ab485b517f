"""A small run of everything: logs, prior, simulation, policies, transfer, report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from motorprior.actuator.registry import motor_text
from motorprior.artifacts import read_json, write_text
from motorprior.bench.fleet import load_robot_fleet
from motorprior.bench.recording import require_bench_size
from motorprior.bounds import require_count, require_seed
from motorprior.commands.bench import Bench, run_bench
from motorprior.commands.identify import Identify, run_identify
from motorprior.commands.real_motors import RealMotors, Show, is_replayed, run_real_motors
from motorprior.commands.replay import Replay, read_logs, run_replay
from motorprior.commands.robustness import Robustness, run_robustness
from motorprior.commands.transfer import Transfer, run_transfer
from motorprior.commands.validate import GAINS_FILE, TUNED, Validate, run_validate
from motorprior.commands.walk import Walk, run_walk
from motorprior.commands.walk_seeds import SEEDS_APART
from motorprior.exceptions import ConfigError
from motorprior.identification.fit_prior import PRIOR
from motorprior.locomotion.ars import ArsConfig
from motorprior.locomotion.command import Commands
from motorprior.progress import SILENT, Progress
from motorprior.results import Results
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.motors import simulated_motors
from motorprior.simulation.randomization import Randomization
from motorprior.stage import FIGURES, PAGE, RESULTS, in_parallel, locked, write_results
from motorprior.studies.robustness import MAPS, load_maps

if TYPE_CHECKING:
    from motorprior.report.page import Section

PRESETS = ("rollout", "paper", "one_network", "paper_wide")


@dataclass(frozen=True)
class Demo:
    """A small run of everything, minutes on two cores. A rerun continues where the last one stopped."""

    out: Path = Path("runs/demo")
    """Run folder: all artefacts, figures.json and report.html."""
    fleet: str | None = None
    """Fleet of motors: a shipped one by name, or a .toml file; the robot's own if not given."""
    logs: Path | None = None
    """Folder with real logs, in any format of docs/logs.md: the demo begins with a comparison of their motors. Logs of
    the shipped robot are in jietan/puppersim, puppersim/data/system_id."""
    columns: str | None = None
    """Column map of tables among the logs: a shipped one by name, or your .toml file (docs/your-motors.md)."""
    suspended: bool = False
    """In the logs the robot is suspended with its body level, so that the loads of its motors are known."""
    seed: int = 0
    """Seed of everything."""
    motors: int = 32
    """Motors on the bench."""
    bench_steps: int = 10_000
    """Samples per motor and preset."""
    adam_steps: int | None = None
    """Adam steps of each identification; the preset's own number if not given."""
    iterations: int = 50
    """ARS iterations per policy."""
    seeds: int = 2
    """Policies per condition."""
    workers: int = 2
    """Independent stages that run at the same time; the result does not depend on it."""
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md). After the comparison of logs,
    the shipped one replaces a robot that cannot walk or has no fleet."""


def run_demo(
    config: Demo, progress: Progress = SILENT, command: str = "", show: Show = lambda found, lines: None
) -> Results:
    """Run every stage that is not finished, and write the report after some stages and at the end.

    Args:
        config: settings.
        progress: reports to the user.
        command: command line that makes the same page, to print on it.
        show: called with the comparison of the motors of real logs.

    Returns:
        All measurements, also in results.json and, by name, in figures.json.

    Raises:
        MotorPriorError: a stage cannot run; finished stages remain.
    """
    from motorprior.report import chapters  # here: it imports matplotlib
    from motorprior.report.real_motors import real_motors

    given, config = config, with_walking_robot(config)
    real = RealMotors(
        given.logs, given.out / "real_motors", given.columns, given.suspended, given.seed, given.robot
    ) if given.logs is not None else None  # fmt: skip
    replayed = real is not None and is_replayed(real, config.robot)
    _require_settings(config, replayed)
    robot, out, results = load_robot(config.robot), config.out, Results()
    sections: list[Section] = []
    with locked(out):
        for name in (RESULTS, FIGURES):  # of other settings
            (out / name).unlink(missing_ok=True)
        if real is not None:
            results += run_real_motors(real, progress, show)
            sections += real_motors(out)
            page = _write_page(given, sections, command)
            progress.note(f"your motors: {page}; the next stages use a virtual {config.robot}")
        _identify_priors(config, progress)
        results += _validate(config, progress)
        sections += [chapters.bench(out / "bench" / "rollout"), *chapters.validate(out / "validate")]
        progress.note(f"first pictures: {_write_page(given, sections, command)}")
        if replayed:
            results += _replay(config, progress)
            sections.append(chapters.replay(out / "replay"))
        walks = _walks(config)
        # the longest training first, otherwise it runs alone at the end
        longest_first = sorted(walks, key=lambda walk: simulated_motors(walk.motors, robot).physics_dt)
        trainings = [partial(run_walk, walk, name=f"walk on {walk.out.name}") for walk in longest_first]
        in_parallel(trainings, config.workers, progress)
        folders: dict[str, list[Path]] = {}
        for folder in sorted(walk.out for walk in walks):
            folders.setdefault(folder.name.rsplit("_", 1)[0], []).append(folder)
        sections.append(chapters.learning(folders))
        transfer = Transfer(
            tuple(sorted(walk.out for walk in walks)), out / "transfer", config.fleet, robot=config.robot,
            workers=config.workers,
        )  # fmt: skip
        results += run_transfer(transfer, progress)
        sections.append(chapters.transfer(out / "transfer", robot))
        first = {name: out / "robustness" / seeds[0].name for name, seeds in folders.items()}
        maps = [Robustness(out / "walk" / folder.name, folder, config.robot) for folder in first.values()]
        in_parallel([partial(run_robustness, each) for each in maps], config.workers, progress)
        sections.append(chapters.robustness_section({name: load_maps(path / MAPS) for name, path in first.items()}))
        write_results(out, results)
        _write_page(given, sections, command, complete=True)
        return results


def _write_page(config: Demo, sections: Sequence[Section], command: str, complete: bool = False) -> Path:
    from motorprior.report.page import page

    title = "motorprior: motor logs, motor prior, walking policies, transfer"
    path = config.out / PAGE
    write_text(path, page(title, sections, asdict(config), command or repr(config), complete))
    return path


def with_walking_robot(config: Demo) -> Demo:
    """With logs, the shipped robot replaces one that cannot walk or has no fleet."""
    robot = load_robot(config.robot)
    walks = bool(robot.legs) and robot.base == "free" and (config.fleet is not None or bool(robot.fleets))
    return config if walks or config.logs is None else replace(config, robot=DEFAULT_ROBOT, fleet=None)


def _require_settings(config: Demo, replayed: bool) -> None:
    """Check settings before anything is written.

    Raises:
        MotorPriorError: names the setting.
    """
    for name, is_given in {"suspended": config.suspended, "columns": config.columns is not None}.items():
        if is_given and config.logs is None:
            raise ConfigError(f"{name} is given without logs", remedy="give logs too, or omit it", argument=name)
    robot = load_robot(config.robot)
    robot.require_legs()
    require_count("motors", config.motors, robot.num_joints)
    require_bench_size(config.motors, config.bench_steps, "bench_steps")
    for name in ("iterations", "seeds", "workers"):
        require_count(name, getattr(config, name))
    if config.adam_steps is not None:
        require_count("adam_steps", config.adam_steps)
    require_seed(config.seed)
    load_robot_fleet(robot, config.fleet)
    if replayed and config.logs is not None:
        read_logs(config.logs, robot)


def _identify_priors(config: Demo, progress: Progress) -> None:
    benches = {preset: config.out / "bench" / preset for preset in ("rollout", "paper")}
    for preset, out in benches.items():
        bench = Bench(out, config.fleet, preset, config.motors, config.bench_steps, config.seed, config.robot)
        run_bench(bench, progress)
    fits = []
    for preset in PRESETS:
        bench, out = benches["paper" if preset == "paper" else "rollout"], config.out / "priors" / preset
        fits.append(partial(run_identify, Identify(bench, out, preset, config.seed, config.adam_steps)))
    in_parallel(fits, config.workers, progress)


def _validate(config: Demo, progress: Progress) -> Results:
    priors = tuple(config.out / "priors" / preset / PRIOR for preset in PRESETS)
    settings = Validate(priors, config.out / "validate", config.seed, held_out=False, robot=config.robot)
    return run_validate(settings, progress)


def _replay(config: Demo, progress: Progress) -> Results:
    assert config.logs is not None
    prior = config.out / "priors" / "rollout" / PRIOR
    posture = "suspended" if config.suspended else "auto"
    replay = Replay(
        config.logs, prior, config.out / "replay", config.fleet, seed=config.seed, robot=config.robot, posture=posture
    )
    return run_replay(replay, progress)


def _walks(config: Demo) -> list[Walk]:
    """Trainings of all policies, the first seed of every condition first."""
    gains, tuned = (read_json(config.out / "validate" / name) for name in (GAINS_FILE, TUNED))
    conditions = {
        "rollout": motor_text("prior", file=config.out / "priors" / "rollout" / PRIOR),
        "oracle": motor_text("fleet", fleet=config.fleet),
        "ideal_pd": motor_text("pd", **gains),
        "tuned_pd": motor_text("pd", **tuned),
        "paper": motor_text("prior", file=config.out / "priors" / "paper" / PRIOR),
    }
    policies = config.seeds * len(conditions)
    return [
        Walk(
            config.out / "walk" / f"{name}_{seed}",
            motors,
            iterations=config.iterations,
            episode_steps=500,  # shorter than the defaults of `Walk`, as is the time between commands
            commands=Commands(hold=1.25),
            randomization=Randomization(),  # only the motors differ between conditions
            search=ArsConfig(seed=SEEDS_APART * config.seed + seed),
            workers=max(1, config.workers // policies),  # more than one where cores are left over
            robot=config.robot,
        )
        for seed in range(config.seeds)
        for name, motors in conditions.items()
    ]
