"""The paper's experiment in minutes, from motor logs to a page on policies on held-out robots."""

import time
from dataclasses import asdict, dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from motorprior import stage
from motorprior.actuator.fleet import load_robot_fleet
from motorprior.artifacts import write_text
from motorprior.commands.quick_report import QuickReport, logs_are_of, run_quick_report
from motorprior.evaluation.errors import WHOLE_RUN_RMSE
from motorprior.exceptions import ConfigError
from motorprior.progress import SILENT, Progress
from motorprior.results import Result, Results, write_results
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.scene import WalkConfig
from motorprior.simulation.training import POLICY
from motorprior.studies.compare import TrainedPolicy, robustness_map, run_walks
from motorprior.studies.environments import HARD, held_out_scene, motors_of_walk, walk_seed
from motorprior.studies.statistics import WalkRow, scores, summarise
from motorprior.studies.study_settings import Study
from motorprior.studies.transfer import study_walks
from motorprior.studies.transfer_models import record_benches

if TYPE_CHECKING:
    from motorprior.report.page import Picture, Section

CONDITIONS = ("ideal_pd", "friction_pd", "paper", "sampled_prior", "adapted_prior")
FILM = "film.gif"
MAP_CONDITIONS = ("ideal_pd", "friction_pd", "sampled_prior")  # each gets a robustness map
FILM_CONDITIONS = ("ideal_pd", "sampled_prior")  # the film compares their policies
_ENVIRONMENTS = ("fleet", "hard")
# No policy of the paper's recipe walks in its own simulation: one short training shows it.
_SHORT = ("paper",)
_PRIOR_SHARE = 0.5  # as selected by the study of docs/transfer.md


@dataclass(frozen=True)
class Demo:
    """Learn models of motors, train policies on the models, test the policies on virtual robots.

    The same command resumes an interrupted demo.
    """

    out: Path = Path("runs/demo")
    """Run folder: all artefacts, figures.json and report.html."""
    fleet: str | None = None
    """Fleet of motors: name of a shipped fleet, or a .toml file; the robot's fleet if not given."""
    logs: Path | None = None
    """Folder with real logs, in any format of docs/logs.md. If given, the demo begins with a
    comparison of models of the logged motors. The repository jietan/puppersim has logs of the
    shipped robot in puppersim/data/system_id."""
    columns: str | None = None
    """Column map for the tables among the logs: name of a shipped map, or your .toml file
    (docs/your-motors.md)."""
    suspended: bool = False
    """The robot of the logs was suspended with its body level, so that the loads of its motors are
    known."""
    seed: int = 0
    """Seed of motors, trainings and walks."""
    motors: int = 16
    """Motors on the bench."""
    bench_steps: int = 5000
    """Samples per motor and excitation."""
    adam_steps: int | None = None
    """Adam steps of the paper's network; the number of its preset if not given."""
    iterations: int = 70
    """ARS iterations per policy; the page marks policies that do not walk in their own
    simulation."""
    directions: int = 8
    """Directions per iteration of ARS."""
    seeds: int = 2
    """Policies per training condition; the paper's recipe has 1, trained for at most 40 iterations.
    Each adapted policy has another robot."""
    walks: int = 24
    """Walks of each policy per environment."""
    workers: int = 2
    """Independent stages that run at the same time; the result does not depend on it."""
    robot: str = DEFAULT_ROBOT
    """Robot: name of a shipped robot, or the .toml file of your robot (docs/your-robot.md). If logs
    are given and this robot has other joints or cannot walk, the demo ends after the report on the
    motors in the logs."""


def run_demo(config: Demo, progress: Progress = SILENT, command: str = "") -> Results:
    """Run every stage that is not finished, and write the report after some stages and at the end.

    The page names the ``command`` that makes it. All measurements are returned and written to
    results.json (rows) and figures.json (values by name); ``seconds`` is the time of this run.
    Raises MotorPriorError if a stage cannot run; the results of finished stages stay.
    """
    from motorprior.report import demo_page, transfer_page  # here: they import matplotlib
    from motorprior.report import sections as page_sections

    _require_logs(config)
    started = time.monotonic()
    out = config.out
    if is_about_logs(config):
        return _demo_of_logs(config, _DemoPage(config, {}, command), progress)

    study = study_of(config)
    study.require_valid()
    page = _DemoPage(config, {"speed": study.commanded}, command)
    results = Results()

    with stage.locked(out):
        for name in (stage.RESULTS, stage.FIGURES):  # results of other settings
            (out / name).unlink(missing_ok=True)
        if config.logs is not None:
            results += _report_on_logs(config, page, progress)
            progress.note(
                f"Report on your motors: {page.write([])}. The next stages use a virtual "
                f"{config.robot}; stop here if you do not need them"
            )

        bench_study = study.of_benches()[0]  # the demo has one bench
        record_benches(bench_study, progress)
        motors_section = page_sections.bench(bench_study.out / "bench" / "rollout")
        progress.note(f"first picture: {page.write([motors_section])}")

        walks = study_walks(study, progress).walks
        statistics = summarise(walks)
        film = _film(bench_study, walks, progress)
        (out / FILM).write_bytes(film.data)
        policy_folders = {name: _folders(bench_study, name) for name in CONDITIONS}
        sections = [
            demo_page.results_section(statistics, study.commanded, film),
            transfer_page.own_simulations(statistics),
            demo_page.robustness(_maps(bench_study, progress)),
            demo_page.steps_section(statistics),
            motors_section,
            page_sections.learning(policy_folders),
        ]

        results += statistics.as_results()
        results += Results([Result("seconds", "s", time.monotonic() - started)])
        write_results(out, results)
        page.write(sections, complete=True)
        progress.note(demo_page.headline(statistics))
        return results


def _require_logs(config: Demo) -> None:
    """Raise ConfigError if settings of logs are given without logs."""
    for name in ("suspended", "columns"):
        if config.logs is None and getattr(config, name):
            raise ConfigError(
                f"{name} is given without logs", remedy="give logs too, or omit it", argument=name
            )


@dataclass
class _DemoPage:
    """The report of the demo, which is written again when there are more sections."""

    config: Demo
    study_settings: dict[str, float]  # shown next to the options; empty without a study
    command: str
    sections_on_logs: "list[Section]" = field(default_factory=list)

    def write(self, sections: "list[Section]", complete: bool = False) -> Path:
        """Write the page: the sections on the logs, then ``sections``; returns its path."""
        from motorprior.report.page import page  # here: it imports matplotlib

        title = "motorprior: your motors"
        if self.study_settings:
            title = "motorprior: do policies walk on robots they have never seen?"
        settings = asdict(self.config) | self.study_settings
        all_sections = [*self.sections_on_logs, *sections]
        path = self.config.out / stage.PAGE
        write_text(path, page(title, all_sections, settings, self.command, complete))
        return path


def _demo_of_logs(config: Demo, page: _DemoPage, progress: Progress) -> Results:
    """The demo that ends after the models of the user's motors, with a page about them."""
    with stage.locked(config.out):
        results = _report_on_logs(config, page, progress)
        write_results(config.out, results)
        progress.note(f"Report on your motors: {page.write([], complete=True)}")
    return results


def _report_on_logs(config: Demo, page: _DemoPage, progress: Progress) -> Results:
    """Compare models of the motors in the user's logs, and add the comparison to the page."""
    from motorprior.report.sections import models_of_logs  # here: it imports matplotlib

    settings = _quick_report(config)
    results = run_quick_report(settings, progress)
    page.sections_on_logs.append(models_of_logs(settings.out, "Your motors", WHOLE_RUN_RMSE))
    return results


def _quick_report(config: Demo) -> QuickReport:
    """Settings of the report on the user's logs."""
    assert config.logs is not None
    folder = config.out / "real_motors"
    return QuickReport(
        config.logs, folder, config.columns, config.suspended, config.seed, config.robot
    )


def is_about_logs(config: Demo) -> bool:
    """Whether the demo ends after the models of the user's motors.

    It does if their robot cannot walk here: the logs are of other joints than the robot's, or the
    robot has no legs.
    """
    if config.logs is None:
        return False
    robot = load_robot(config.robot)
    can_walk = bool(robot.legs) and robot.base == "free"
    return not (can_walk and logs_are_of(robot, _quick_report(config)))


def study_of(config: Demo) -> Study:
    """The small transfer study of the demo: one bench, the environments fleet and hard."""
    study_settings = {setting.name for setting in fields(Study)}
    shared = {
        setting.name: getattr(config, setting.name)
        for setting in fields(config)
        if setting.name in study_settings
    }
    return Study(
        **shared,
        environments=_ENVIRONMENTS,
        conditions=CONDITIONS,
        short=_SHORT,
        benches=1,
        prior_share=_PRIOR_SHARE,
    )


def _folders(bench: Study, name: str) -> list[Path]:
    """Folders of the policies of a training condition."""
    return [bench.out / "policies" / f"{name}_{seed}" for seed in bench.seeds_of(name)]


def _policies(bench: Study, name: str) -> list[TrainedPolicy]:
    """The policies of a training condition."""
    robot = load_robot(bench.robot)
    return [TrainedPolicy.load(folder / POLICY, robot) for folder in _folders(bench, name)]


def _maps(bench: Study, progress: Progress) -> dict[str, np.ndarray]:
    """Robustness map of the policies of each condition in MAP_CONDITIONS."""
    maps = {}
    with progress.start("robustness on held-out robots", len(MAP_CONDITIONS)) as task:
        fleet = load_robot_fleet(load_robot(bench.robot), bench.fleet)
        for name in MAP_CONDITIONS:
            policies = _policies(bench, name)
            maps[name] = robustness_map(policies, fleet, bench.commands, bench.seed)
            task.advance(1, name)
    return maps


def _film(bench: Study, walks: list[WalkRow], progress: Progress) -> "Picture":
    """Film of one robot in the environment hard, which walks with a policy of each FILM_CONDITIONS.

    The robot and the seed of the policies are those of `_typical_walk`.
    """
    from motorprior.report.film import comparison_gif
    from motorprior.report.page import Picture
    from motorprior.report.plots_style import model_label

    seed, number = _typical_walk(walks)
    robot = load_robot(bench.robot)
    steps = round(bench.seconds / robot.control_dt)
    fleet = load_robot_fleet(robot, bench.fleet)
    motors = partial(motors_of_walk, robot, fleet, bench.seed, None)
    seed_of_walk = partial(walk_seed, bench.seed)
    walk = WalkConfig(steps, commands=bench.commands, randomization=HARD)
    episodes = {}
    for name in FILM_CONDITIONS:
        trained = _policies(bench, name)[seed]
        scene = held_out_scene(trained.robot, fleet, walk)
        (episode,) = run_walks(scene, trained.policy.arrays, [number], seed_of_walk, motors)
        episodes[f"trained on: {model_label(name)}"] = episode
    caption = (
        f"The same held-out robot, floor and pushes for both policies: robot {number} in the "
        f"environment hard, policies of seed {seed}. Of all walks, in this one the times upright "
        "of the two policies are closest to the means of their conditions."
    )
    return Picture(caption, comparison_gif(robot, episodes, steps, progress.note), "gif")


def _typical_walk(walks: list[WalkRow]) -> tuple[int, int]:
    """Seed of the policies and number of the walk for the film.

    The walk has the smallest sum over FILM_CONDITIONS of |time upright - mean time upright of the
    condition|.
    """
    hard_walks = [walk for walk in walks if walk["environment"] == "hard"]
    distances = []  # (seeds, walks) per condition
    for name in FILM_CONDITIONS:
        walks_of_condition = [walk for walk in hard_walks if walk["condition"] == name]
        upright_of_benches = scores(walks_of_condition, "upright")
        upright = upright_of_benches[0]  # the demo has one bench
        distances.append(np.abs(upright - upright.mean()))

    total_distance = sum(distances)
    closest = int(np.argmin(total_distance))
    seed, number = np.unravel_index(closest, distances[0].shape)
    return int(seed), int(number)
