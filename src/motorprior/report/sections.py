"""Sections that several pages have, and the page of trained policies."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from motorprior.actuator.families import FAMILIES
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import read_json, write_json, write_text
from motorprior.bench.bench_folder import read_bench
from motorprior.bench.class_behaviour import LOAD, class_behaviours
from motorprior.evaluation.free_runs import Validation, error_table, errors_by_joint
from motorprior.exceptions import ConfigError
from motorprior.report import plots
from motorprior.report.film import comparison_gif
from motorprior.report.page import Picture, Section, Table, page, picture
from motorprior.report.plots_style import model_label, png_bytes
from motorprior.results import read_results, write_results
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.simulation.scene import Episode, WalkConfig
from motorprior.simulation.training import POLICY
from motorprior.stage import PAGE
from motorprior.studies.compare import DURATION_STEPS, TrainedPolicy, run_walks, straight_ahead

_NOTES = "notes.json"
_TRACES = "traces.png"


def samples(prior: MotorPrior) -> Section:
    """Behaviour of samples of each class of joints, and where their spread comes from."""
    figure = plots.draw_class_behaviours(class_behaviours(prior))
    caption = (
        f"Responses on a load of {LOAD:g} times the armature, and friction; a row per class of "
        "joints."
    )
    text = " ".join(f"{note[0].upper()}{note[1:]}." for note in prior.spread_notes())
    return Section("Samples of the prior", (text,), (picture(figure, caption),))


def write_validation(folder: Path, validation: Validation, lines: Sequence[str] = ()) -> None:
    """Write results, a picture of the traces, and notes of a validation, for `models_of_logs`."""
    write_results(folder, validation.results)
    (folder / _TRACES).write_bytes(png_bytes(plots.draw_traces(validation.traces)))

    constants = []
    if validation.constants is not None:
        constants = [validation.constants.columns, validation.constants.cells]
    notes = {"lines": [*lines, *validation.warnings], "constants": constants}
    write_json(folder / _NOTES, notes)


def models_of_logs(folder: Path, title: str, quantity: str) -> Section:
    """Models of the motors in logs, from the files that `write_validation` wrote."""
    results = read_results(folder)
    notes = read_json(folder / _NOTES)

    text = (
        "Models of the motors simulate the joints from recorded commands, without feedback from "
        "the log."
    )
    lines = [text, *notes["lines"]]
    for row in results.where(quantity="whole_run_coverage90"):
        share = f"{100 * row.value:.0f} %"
        lines.append(f"{row.model}: {share} of the recorded angles are inside the 90 % bands.")

    columns, rows = error_table(results, {quantity: "whole log"})
    tables = [Table(columns, rows, "Joint RMSE [mrad], over joints.")]
    if notes["constants"]:
        columns, rows = notes["constants"]
        tables.append(Table(columns, rows, "Constants of the motors."))

    errors = plots.draw_errors_by_joint(errors_by_joint(results, quantity))
    traces = (folder / _TRACES).read_bytes()
    pictures = (
        picture(errors, "Errors by joint."),
        Picture("The joints with the median and maximum error.", traces),
    )
    return Section(title, tuple(lines), pictures, tuple(tables))


def bench(folder: Path) -> Section:
    """Excitation and response of the first motor of a bench."""
    log, settings = read_bench(folder)
    fleet = settings.fleet
    text = (
        f"{settings.motors} physical motors of fleet {fleet.name} on a virtual dynamometer, "
        f"{settings.steps} steps each. {FAMILIES[fleet.family].motor} The motors differ."
    )

    segments = log.segment_slices()
    segment = log.rows(segments[min(3, len(segments) - 1)])
    first_motor = segment.joint(0).rows(slice(0, 700))
    figure = plots.excitation_and_response(first_motor, "Preset rollout, first motor")
    drawn = picture(figure, "Excitation and response of one motor.")
    return Section("Bench: excitation and response", (text,), (drawn,))


def learning(folders: Mapping[str, Sequence[Path]]) -> Section:
    """Learning curves of trainings: name -> a folder with curve.json per seed."""
    curves = {name: plots.read_curves(seeds) for name, seeds in folders.items()}
    figure = plots.learning_curves(curves)
    text = (
        "Augmented random search. Each return is measured in the training simulation of the "
        "policy, so returns of different motors are not comparable."
    )
    drawn = picture(figure, "Mean return of the perturbed policies per iteration.")
    return Section("Learning to walk", (text,), (drawn,))


def gaits(robot: Robot, walks: Mapping[str, Episode]) -> Section:
    """Films of the first 2.5 s of a walk of each policy in its training simulation."""
    steps = round(2.5 / robot.control_dt)
    films = []
    for name, walk in walks.items():
        label = model_label(name)
        film = comparison_gif(robot, {label: walk}, steps, lambda _: None, rate=10.0)
        films.append(Picture(f"Trained on {label}, in its training simulation.", film, "gif"))
    text = f"Robot {robot.name} in the training simulation of each policy."
    return Section("Gaits", (text,), tuple(films))


def write_training_page(run: Path, robot_name: str, command: str) -> Path:
    """Write report.html on the policies in ``run`` or one folder below it; returns its path.

    Folders with the same name except for a number, such as slow_0 and slow_1, are seeds of one
    training; the page has a film of the first seed. ``command`` makes the same page. Raises
    ConfigError if there is no policy.
    """
    trainings = _trainings(run)
    if not trainings:
        raise ConfigError(
            f"no {POLICY} in it or one folder below",
            where=run,
            remedy="give a folder that `motorprior walk` wrote",
        )
    robot = load_robot(robot_name)
    sections = []

    with_curves = {}
    for name, seeds in trainings.items():
        folders = [folder for folder in seeds if (folder / "curve.json").is_file()]
        if folders:
            with_curves[name] = folders
    if with_curves:
        sections.append(learning(with_curves))

    walks = {}
    for name, seeds in trainings.items():
        walks[name] = _walk(TrainedPolicy.load(seeds[0] / POLICY, robot))
    sections.append(gaits(robot, walks))

    settings = {"robot": robot_name, "policies": sum(map(len, trainings.values()))}
    write_text(run / PAGE, page(f"Policies of robot {robot.name}", sections, settings, command))
    return run / PAGE


def _trainings(run: Path) -> dict[str, list[Path]]:
    """Folders of policies by the name of their training, a folder per seed."""
    trainings: dict[str, list[Path]] = {}
    for policy in sorted((*run.glob(POLICY), *run.glob(f"*/{POLICY}"))):
        folder = policy.parent
        name = re.sub(r"_\d+$", "", folder.name)
        if folder == run or name == "seed":
            name = run.resolve().name
        trainings.setdefault(name, []).append(folder)
    return trainings


def _walk(trained: TrainedPolicy) -> Episode:
    """A walk straight ahead in the training simulation of a policy."""
    config = WalkConfig(
        DURATION_STEPS,
        randomization=trained.randomization,
        commands=straight_ahead(trained.robot),
    )
    (episode,) = run_walks(trained.scene(config), trained.policy.arrays, [0])
    return episode
