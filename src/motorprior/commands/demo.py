"""The paper's experiment in minutes, from motor logs to a page on policies on held-out robots."""

import time
from dataclasses import asdict, dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from motorprior import stage
from motorprior.actuator.fleet import load_robot_fleet
from motorprior.artifacts import write_text
from motorprior.commands.quick_report import QuickReport, run_quick_report
from motorprior.evaluation.errors import WHOLE_RUN_RMSE
from motorprior.exceptions import ConfigError
from motorprior.progress import SILENT, Progress
from motorprior.results import Result, Results, write_results
from motorprior.robots.load import load_robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.simulation.scene import WalkConfig
from motorprior.simulation.training import POLICY
from motorprior.studies.compare import TrainedPolicy, robustness_map, run_walks
from motorprior.studies.environments import HARD, motors_of_walk, twin_scene, walk_seed
from motorprior.studies.statistics import WalkRow, scores, summarise
from motorprior.studies.study_settings import Study
from motorprior.studies.transfer import study_walks
from motorprior.studies.transfer_models import record_benches

if TYPE_CHECKING:
    from motorprior.report.page import Picture, Section

CONDITIONS = (
    "ideal_pd",
    "friction_pd",
    "random_pd",
    "paper",
    "sampled_prior",
    "adapted_prior",
    "oracle",
)
FILM = "film.gif"
MAPPED = ("ideal_pd", "friction_pd", "sampled_prior")  # conditions with a robustness map
FILMED = ("ideal_pd", "sampled_prior")
_ENVIRONMENTS = ("fleet", "hard")
# The study of docs/transfer.md has 0.4 and 0.5. With so wide a range of PDs, policies need more
# iterations to walk than the demo has.
_PD_RANGE = 0.1
_PRIOR_SHARE = 0.25


@dataclass(frozen=True)
class Demo:
    """Learn motors, train policies on models of them, test these on virtual robots.

    A rerun resumes.
    """

    out: Path = Path("runs/demo")
    """Run folder: all artefacts, figures.json and report.html."""
    fleet: str | None = None
    """Fleet of motors: a shipped one by name, or a .toml file; the robot's own if not given."""
    logs: Path | None = None
    """Folder with real logs, in any format of docs/logs.md: the demo begins with a comparison of
    models of their motors. Logs of the shipped robot are in jietan/puppersim,
    puppersim/data/system_id."""
    columns: str | None = None
    """Column map of tables among the logs: a shipped one by name, or your .toml file
    (docs/your-motors.md)."""
    suspended: bool = False
    """In the logs the robot is suspended with its body level, so that the loads of its motors are
    known."""
    seed: int = 0
    """Seed of everything."""
    motors: int = 16
    """Motors on the bench."""
    bench_steps: int = 5000
    """Samples per motor and excitation."""
    adam_steps: int | None = None
    """Adam steps of the paper's network; the preset's own number if not given."""
    iterations: int = 20
    """ARS iterations per policy."""
    directions: int = 14
    """Directions per iteration of ARS."""
    seeds: int = 3
    """Policies per condition (oracle: 1); each adapted policy is adapted to a robot of its own."""
    walks: int = 14
    """Walks of each policy per environment."""
    workers: int = 2
    """Independent stages that run at the same time; the result does not depend on it."""
    robot: str = DEFAULT_ROBOT
    """Robot: a shipped one by name, or the .toml file of your own (docs/your-robot.md). With logs
    of a robot that cannot walk or has no fleet, the shipped robot walks."""


def run_demo(config: Demo, progress: Progress = SILENT, command: str = "") -> Results:
    """Run every stage that is not finished, and write the report after some stages and at the end.

    The page names the ``command`` that makes it. Returns all measurements, also in results.json
    and, by name, in figures.json; ``seconds`` is the time of this run. Raises MotorPriorError if a
    stage cannot run; finished ones stay.
    """
    from motorprior.report import demo_page, transfer_page  # here: they import matplotlib
    from motorprior.report import sections as page_sections

    _require_logs(config)
    started = time.monotonic()
    out = config.out
    walking = with_walking_robot(config)
    study = study_of(walking)
    study.require_valid()
    page = _DemoPage(config, study.commanded, command or repr(config))
    results = Results()

    with stage.locked(out):
        for name in (stage.RESULTS, stage.FIGURES):  # results of other settings
            (out / name).unlink(missing_ok=True)
        if config.logs is not None:
            results += _report_on_logs(config, walking.robot, page, progress)

        bench = study.of_benches()[0]
        record_benches(bench, progress)
        motors = page_sections.bench(bench.out / "bench" / "rollout")
        progress.note(f"first picture: {page.write([motors])}")

        walks = study_walks(study, progress)
        statistics = summarise(walks)
        film = _film(bench, walks, progress)
        (out / FILM).write_bytes(film.data)
        sections = [
            demo_page.results_section(statistics, study.commanded, film),
            demo_page.robustness(_maps(bench, progress)),
            transfer_page.own_simulations(statistics),
            motors,
            page_sections.learning({name: _folders(bench, name) for name in CONDITIONS}),
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
    speed: float  # commanded speed of the study [m/s]
    command: str
    sections_on_logs: "list[Section]" = field(default_factory=list)

    def write(self, sections: "list[Section]", complete: bool = False) -> Path:
        """Write the page of the logs and of these sections; returns its path."""
        from motorprior.report.page import page  # here: it imports matplotlib

        title = "motorprior: do policies walk on robots they have never seen?"
        settings = asdict(self.config) | {"speed": self.speed}
        all_sections = [*self.sections_on_logs, *sections]
        path = self.config.out / stage.PAGE
        write_text(path, page(title, all_sections, settings, self.command, complete))
        return path


def _report_on_logs(
    config: Demo, walking_robot: str, page: _DemoPage, progress: Progress
) -> Results:
    """Compare models of the motors in the user's logs, and write this section of the page."""
    from motorprior.report.sections import models_of_logs  # here: it imports matplotlib

    assert config.logs is not None
    folder = config.out / "real_motors"
    settings = QuickReport(
        config.logs, folder, config.columns, config.suspended, config.seed, config.robot
    )
    results = run_quick_report(settings, progress)
    page.sections_on_logs.append(models_of_logs(folder, "Your motors", WHOLE_RUN_RMSE))
    progress.note(
        f"Report on your motors: {page.write([])}. The next stages use a virtual {walking_robot}; "
        "stop here if you do not need them"
    )
    return results


def with_walking_robot(config: Demo) -> Demo:
    """With logs, the shipped robot replaces one that cannot walk or has no fleet."""
    robot = load_robot(config.robot)
    has_fleet = config.fleet is not None or bool(robot.fleets)
    can_walk = bool(robot.legs) and robot.base == "free"
    if config.logs is None or (can_walk and has_fleet):
        return config
    return replace(config, robot=DEFAULT_ROBOT, fleet=None)


def study_of(config: Demo) -> Study:
    """The transfer study, small: one bench, the environments fleet and hard."""
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
        benches=1,
        oracle_seeds=1,
        pd_range=_PD_RANGE,
        prior_share=_PRIOR_SHARE,
    )


def _folders(bench: Study, name: str) -> list[Path]:
    return [bench.out / "policies" / f"{name}_{seed}" for seed in bench.seeds_of(name)]


def _policies(bench: Study, name: str) -> list[TrainedPolicy]:
    robot = load_robot(bench.robot)
    return [TrainedPolicy.load(folder / POLICY, robot) for folder in _folders(bench, name)]


def _maps(bench: Study, progress: Progress) -> dict[str, np.ndarray]:
    """Robustness map of the policies of each condition in MAPPED."""
    maps = {}
    with progress.start("robustness on held-out robots", len(MAPPED)) as task:
        fleet = load_robot_fleet(load_robot(bench.robot), bench.fleet)
        for name in MAPPED:
            policies = _policies(bench, name)
            maps[name] = robustness_map(policies, fleet, bench.commands, bench.seed)
            task.advance(1, name)
    return maps


def _film(bench: Study, walks: list[WalkRow], progress: Progress) -> "Picture":
    """A film of one robot of the environment hard on policies of FILMED."""
    from motorprior.report.film import comparison_gif
    from motorprior.report.page import Picture
    from motorprior.report.plots_style import model_label

    seed, number = _typical_walk(walks)
    robot = load_robot(bench.robot)
    steps = round(bench.seconds / robot.control_dt)
    fleet = load_robot_fleet(robot, bench.out_of_family)
    motors = partial(motors_of_walk, robot, fleet, bench.seed, None)
    episodes = {}
    for name in FILMED:
        trained = _policies(bench, name)[seed]
        walk = WalkConfig(steps, commands=bench.commands, randomization=HARD)
        scene = twin_scene(trained.robot, fleet, walk)
        (episode,) = run_walks(
            scene, trained.policy.arrays, [number], partial(walk_seed, bench.seed), motors
        )
        episodes[f"trained on: {model_label(name)}"] = episode
    caption = (
        f"One held-out robot in the environment hard, on both policies: walk {number} of seed "
        f"{seed}, whose times upright are the closest to the means of both."
    )
    return Picture(caption, comparison_gif(robot, episodes, steps, progress.note), "gif")


def _typical_walk(walks: list[WalkRow]) -> tuple[int, int]:
    """Seed and number of the walk whose times upright are closest to the means of both policies."""
    hard_walks = [walk for walk in walks if walk["environment"] == "hard"]
    distances = []
    for name in FILMED:
        walks_of_condition = [walk for walk in hard_walks if walk["condition"] == name]
        upright, *_ = scores(walks_of_condition, "upright")
        distances.append(np.abs(upright - upright.mean()))
    distance = sum(distances)
    seed, number = np.unravel_index(int(np.argmin(distance)), distances[0].shape)
    return int(seed), int(number)
