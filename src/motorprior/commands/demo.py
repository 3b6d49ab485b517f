"""A small run of everything: logs, prior, simulation, policies, transfer, report."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from motorprior import stage
from motorprior.actuator.registry import motor_text
from motorprior.artifacts import read_json, write_text
from motorprior.bounds import require_count
from motorprior.commands.bench import Bench, run_bench
from motorprior.commands.identify import Identify, run_identify
from motorprior.commands.real_motors import RealMotors, run_real_motors
from motorprior.commands.transfer import Transfer, run_transfer
from motorprior.commands.validate import GAINS_FILE, TUNED, Validate, run_validate
from motorprior.commands.walk import SEEDS_APART, Walk, run_walk
from motorprior.exceptions import ConfigError
from motorprior.identification.fit_prior import PRIOR
from motorprior.identification.presets import network_steps
from motorprior.locomotion.ars import ArsConfig
from motorprior.locomotion.command import Commands
from motorprior.progress import SILENT, Progress, in_parallel
from motorprior.results import Results
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.motors import simulated_motors
from motorprior.simulation.randomization import Randomization

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


def run_demo(config: Demo, progress: Progress = SILENT, command: str = "") -> Results:
    """Run every stage that is not finished, and write the report after some stages and at the end.

    Args:
        config: settings.
        progress: reports to the user.
        command: command line that makes the same page, to print on it.

    Returns:
        All measurements, also in results.json and, by name, in figures.json.

    Raises:
        MotorPriorError: a stage cannot run; finished stages remain.
    """
    from motorprior.report import chapters  # here: it imports matplotlib
    from motorprior.report.page import page

    if config.logs is None and (config.suspended or config.columns is not None):
        name = "suspended" if config.suspended else "columns"
        raise ConfigError(f"{name} is given without logs", remedy="give logs too, or omit it", argument=name)
    given, config = config, with_walking_robot(config)
    robot, out, results = load_robot(config.robot), config.out, Results()
    sections: list[Section] = []
    robot.require_legs()
    require_count("motors", config.motors, robot.num_joints)
    for name in ("iterations", "seeds", "workers"):
        require_count(name, getattr(config, name))

    def write_page(complete: bool = False) -> Path:
        title = "motorprior: motor logs, motor prior, walking policies, transfer"
        write_text(out / stage.PAGE, page(title, sections, asdict(given), command or repr(given), complete))
        return out / stage.PAGE

    with stage.locked(out):
        for name in (stage.RESULTS, stage.FIGURES):  # of other settings
            (out / name).unlink(missing_ok=True)
        if given.logs is not None:
            real = RealMotors(given.logs, out / "real_motors", given.columns, given.suspended, given.seed, given.robot)
            results += run_real_motors(real, progress)
            sections.append(chapters.real_motors(out / "real_motors"))
            progress.note(f"your motors: {write_page()}; the next stages use a virtual {config.robot}")
        priors = _identify_priors(config, progress)
        validate = Validate(tuple(priors.values()), out / "validate", config.seed, held_out=False, robot=config.robot)
        results += run_validate(validate, progress)
        sections += [chapters.bench(out / "bench" / "rollout"), *chapters.validate(out / "validate")]
        progress.note(f"first pictures: {write_page()}")
        folders = _train(config, priors, robot, progress)
        sections.append(chapters.learning(folders))
        walks = tuple(folder for seeds in folders.values() for folder in seeds)
        transfer = Transfer(walks, out / "transfer", config.fleet, robot=config.robot, workers=config.workers)
        results += run_transfer(transfer, progress)
        sections.append(chapters.transfer(out / "transfer", robot))
        stage.write_results(out, results)
        write_page(complete=True)
        return results


def with_walking_robot(config: Demo) -> Demo:
    """With logs, the shipped robot replaces one that cannot walk or has no fleet."""
    robot = load_robot(config.robot)
    walks = bool(robot.legs) and robot.base == "free" and (config.fleet is not None or bool(robot.fleets))
    return config if walks or config.logs is None else replace(config, robot=DEFAULT_ROBOT, fleet=None)


def _identify_priors(config: Demo, progress: Progress) -> dict[str, Path]:
    """Preset -> file of its prior, from two benches."""
    benches = {preset: config.out / "bench" / preset for preset in ("rollout", "paper")}
    for preset, out in benches.items():
        bench = Bench(out, config.fleet, preset, config.motors, config.bench_steps, config.seed, config.robot)
        run_bench(bench, progress)
    folders = {preset: config.out / "priors" / preset for preset in PRESETS}
    works = []
    for preset, out in folders.items():
        bench, steps = benches.get(preset, benches["rollout"]), network_steps(preset, config.adam_steps)
        works.append(partial(run_identify, Identify(bench, out, preset, config.seed, steps)))
    in_parallel(works, config.workers, progress)
    return {preset: out / PRIOR for preset, out in folders.items()}


def _train(config: Demo, priors: dict[str, Path], robot: Robot, progress: Progress) -> dict[str, list[Path]]:
    """Condition -> folders of its policies, one per seed."""
    gains, tuned = (read_json(config.out / "validate" / name) for name in (GAINS_FILE, TUNED))
    conditions = {
        "rollout": motor_text("prior", file=priors["rollout"]),
        "oracle": motor_text("fleet", fleet=config.fleet),
        "ideal_pd": motor_text("pd", **gains),
        "tuned_pd": motor_text("pd", **tuned),
        "paper": motor_text("prior", file=priors["paper"]),
    }
    walks = [
        Walk(
            out=config.out / "walk" / f"{name}_{seed}",
            motors=motors,
            iterations=config.iterations,
            episode_steps=500,  # shorter than the defaults of `Walk`, as is the time between commands
            commands=Commands(hold=1.25),
            randomization=Randomization(),  # only the motors differ between conditions
            search=ArsConfig(seed=SEEDS_APART * config.seed + seed),
            workers=max(1, config.workers // (config.seeds * len(conditions))),  # more where cores are left over
            robot=config.robot,
        )
        for seed in range(config.seeds)
        for name, motors in conditions.items()
    ]
    # the longest training first, otherwise it runs alone at the end
    longest_first = sorted(walks, key=lambda walk: simulated_motors(walk.motors, robot).physics_dt)
    trainings = [partial(run_walk, walk, name=f"walk on {walk.out.name}") for walk in longest_first]
    in_parallel(trainings, config.workers, progress)
    seeds = range(config.seeds)
    return {name: [config.out / "walk" / f"{name}_{seed}" for seed in seeds] for name in sorted(conditions)}
