"""Sections of the pages, from the files of their stages, and the page of trained policies."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from motorprior.actuator.motor_prior import MotorPrior
from motorprior.artifacts import read_json, write_json, write_text
from motorprior.bench.bench_folder import read_bench
from motorprior.bench.class_behaviour import LOAD, class_behaviours
from motorprior.bench.families import FAMILIES
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
    caption = f"Responses on a load of {LOAD:g} times the armature, and friction; a row per class of joints."
    text = " ".join(f"{line[0].upper()}{line[1:]}." for line in prior.spread_notes())
    return Section("Samples of the prior", (text,), (picture(figure, caption),))


def write_validation(folder: Path, found: Validation, lines: Sequence[str] = ()) -> None:
    """Write results, a picture of the traces, and notes of a validation, for `models_of_logs`."""
    write_results(folder, found.results)
    (folder / _TRACES).write_bytes(png_bytes(plots.draw_traces(found.traces)))
    constants = [] if found.constants is None else [found.constants.columns, found.constants.cells]
    write_json(folder / _NOTES, {"lines": [*lines, *found.warnings], "constants": constants})


def models_of_logs(folder: Path, title: str, quantity: str) -> Section:
    """Models of the motors in logs, from the files of the quick report or of `motorprior validate`."""
    results = read_results(folder)
    notes = read_json(folder / _NOTES)
    tables = [
        Table(*error_table(results, {quantity: "whole log"}), "Joint RMSE [mrad], over joints.")
    ]
    if notes["constants"]:
        tables.append(Table(*notes["constants"], caption="Constants of the motors."))
    for row in results.where(quantity="whole_run_coverage90"):
        notes["lines"].append(
            f"{row.model}: {100 * row.value:.0f} % of the recorded angles are inside the 90 % bands."
        )
    pictures = (
        picture(plots.draw_errors_by_joint(errors_by_joint(results, quantity)), "Errors by joint."),
        Picture("The joints with the median and maximum error.", (folder / _TRACES).read_bytes()),
    )
    text = "Models of the motors simulate the joints from recorded commands, without feedback from the log."
    return Section(title, (text, *notes["lines"]), pictures, tuple(tables))


def bench(folder: Path) -> Section:
    """Excitation and response of the first motor."""
    log, settings = read_bench(folder)
    segments = log.segment_slices()
    part = log.rows(segments[min(3, len(segments) - 1)]).joint(0).rows(slice(0, 700))
    text = (
        f"{settings.motors} physical motors of fleet {settings.fleet.name} on a virtual dynamometer, {settings.steps} "
        f"steps each. {FAMILIES[settings.fleet.family].motor} The motors differ."
    )
    figure = plots.excitation_and_response(part, "Preset rollout, first motor")
    drawn = picture(figure, "Excitation and response of one motor.")
    return Section("Bench: excitation and response", (text,), (drawn,))


def learning(folders: Mapping[str, Sequence[Path]]) -> Section:
    """Learning curves of trainings: name -> a folder with curve.json per seed."""
    figure = plots.learning_curves(
        {name: plots.read_curves(seeds) for name, seeds in folders.items()}
    )
    text = (
        "Augmented random search. Each return is measured in the training simulation of the policy, so returns of "
        "different motors are not comparable."
    )
    drawn = picture(figure, "Mean return of the perturbed policies per iteration.")
    return Section("Learning to walk", (text,), (drawn,))


def gaits(robot: Robot, walks: Mapping[str, Episode]) -> Section:
    """Films of the first 2.5 s of a walk of each policy in its training simulation, 10 pictures per second."""
    steps = round(2.5 / robot.control_dt)
    films = []
    for label, walk in ((model_label(name), walk) for name, walk in walks.items()):
        film = comparison_gif(robot, {label: walk}, steps, lambda _: None, rate=10.0)
        films.append(Picture(f"Trained on {label}, in its training simulation.", film, "gif"))
    return Section(
        "Gaits", (f"Robot {robot.name} in the training simulation of each policy.",), tuple(films)
    )


def write_training_page(run: Path, robot_name: str, command: str) -> Path:
    """Write report.html on the policies in ``run`` or one folder below it; returns its path.

    Folders with the same name except for a number, such as slow_0 and slow_1, are seeds of one
    training; the page has a film of the first seed. ``command`` makes the same page. ConfigError if
    there is no policy.
    """
    trainings: dict[str, list[Path]] = {}
    for policy in sorted((*run.glob(POLICY), *run.glob(f"*/{POLICY}"))):
        trainings.setdefault(_training(run, policy.parent), []).append(policy.parent)
    if not trainings:
        remedy = "give a folder that `motorprior walk` wrote"
        raise ConfigError(f"no {POLICY} in it or one folder below", where=run, remedy=remedy)
    robot = load_robot(robot_name)
    walks = {}
    learned = {}
    for name, seeds in trainings.items():
        trained = TrainedPolicy.load(seeds[0] / POLICY, robot)
        walk = WalkConfig(
            DURATION_STEPS,
            randomization=trained.randomization,
            commands=straight_ahead(trained.robot),
        )
        (walks[name],) = run_walks(trained.scene(walk), trained.policy.arrays, [0])
        if with_curve := [folder for folder in seeds if (folder / "curve.json").is_file()]:
            learned[name] = with_curve
    sections = [*([learning(learned)] if learned else []), gaits(robot, walks)]
    settings = {"robot": robot_name, "policies": sum(map(len, trainings.values()))}
    write_text(run / PAGE, page(f"Policies of robot {robot.name}", sections, settings, command))
    return run / PAGE


def _training(run: Path, folder: Path) -> str:
    stem = re.sub(r"_\d+$", "", folder.name)
    return run.resolve().name if folder == run or stem == "seed" else stem
