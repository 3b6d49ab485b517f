"""Closed-loop fidelity of the priors of a bench, compared with the physical motors that they learned from."""

from collections.abc import Sequence
from pathlib import Path

from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.ideal_pd import IdealPd
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.bench_folder import BenchSettings, bench_from_json
from motorprior.bench.fleet import nominal_pd
from motorprior.bench.recording import bench_preset, record
from motorprior.bounds import require_number, require_seed
from motorprior.evaluation.bench_truth import ModelOfMotors
from motorprior.exceptions import ConfigError
from motorprior.identification.baselines.pd_fit import RESTARTS, WITH_ROTOR, fit_pd
from motorprior.priors.held_out import (
    adapt_all,
    adaptation,
    adapted_models,
    distribution,
    held_out_motors,
)
from motorprior.priors.prior_file import load_prior
from motorprior.progress import SILENT, Progress
from motorprior.results import Results, read_results, write_results
from motorprior.robots.load import load_robot
from motorprior.robots.robot import Robot
from motorprior.robots.shipped import DEFAULT_ROBOT
from motorprior.stage import description, is_finished, working
from motorprior.studies.robot_fidelity import FIDELITY_METRICS, fidelity

ADAPT_SECONDS = (2.0, 5.0, 10.0, 30.0)


def validate_on_bench(
    priors: Sequence[Path],
    out: Path,
    *,
    seed: int = 0,
    adapt_seconds: Sequence[float] = ADAPT_SECONDS,
    robot: str = DEFAULT_ROBOT,
    progress: Progress = SILENT,
) -> Results:
    """Compare priors with the physical motors of their bench, and with held-out motors of its fleet.

    Args:
        priors: prior files of different presets, all from benches of the same motors.
        out: folder for results.json and figures.json; a repeated call reads them.
        seed: of the held-out excitation.
        adapt_seconds: lengths of log [s] to which the prior with physics is adapted for held-out
            motors.
        robot: a name, or the path of a .toml file.
        progress: where to report to.

    Returns:
        `FIDELITY_METRICS` of priors, of the robot's nominal PD (ideal_pd) and of one PD tuned to
        the bench log (tuned_pd), on the motors of the bench (train) and on held-out motors
        (held_out), to 10 s of whose logs the priors are adapted; `held_out.adaptation` and
        `held_out.distribution` of the prior of preset rollout, or of the first one with physics if
        there is none.

    Raises:
        ConfigError: a number out of range, or priors that do not fit together or to the robot.
        ArtifactError: a prior or a robot that cannot be read, or ``out`` that cannot be written.
    """
    require_seed(seed)
    for seconds in adapt_seconds:
        require_number("adapt_seconds", seconds, 1.0, 600.0)
    loaded_robot = load_robot(robot)
    loaded, bench = _load_priors(loaded_robot, priors)
    settings = {"priors": priors, "seed": seed, "adapt_seconds": adapt_seconds, "robot": robot}
    wanted = description("validate", settings, [*priors, *loaded_robot.files])
    if not is_finished(out, wanted):
        with working(out, wanted):
            write_results(out, _measure(loaded_robot, loaded, bench, seed, adapt_seconds, progress))
    return read_results(out)


def _load_priors(
    robot: Robot, paths: Sequence[Path]
) -> tuple[dict[str, MotorPrior], BenchSettings]:
    """The priors by preset, and the bench whose motors they learned; ConfigError if they do not fit together."""
    priors: dict[str, MotorPrior] = {}
    benches: list[BenchSettings] = []
    for path in paths:
        prior = load_prior(path, robot)
        if prior.preset in priors:
            raise ConfigError(
                f"two priors of preset {prior.preset!r}", where=path, remedy="give one of each"
            )
        priors[prior.preset] = prior
        benches.append(bench_from_json(prior.provenance.get("bench"), str(path)))
        first = benches[0]
        own = benches[-1]
        if (own.fleet, own.motors, own.seed) != (first.fleet, first.motors, first.seed):
            problem = f"its bench is not that of {paths[0]}"
            remedy = "give priors of the same motors"
            raise ConfigError(problem, where=path, remedy=remedy)
    if robot.legs and benches[0].motors < robot.num_joints:
        problem = f"its bench has {benches[0].motors} motors, the robot needs {robot.num_joints}"
        raise ConfigError(
            problem, where=paths[0], remedy="record a bench of as many motors or more"
        )
    return priors, benches[0]


def _measure(
    robot: Robot,
    priors: dict[str, MotorPrior],
    bench: BenchSettings,
    seed: int,
    adapt_seconds: Sequence[float],
    progress: Progress,
) -> Results:
    motors = bench.physical_motors()
    with progress.start("tune a PD on the bench log", RESTARTS) as task:
        log = record(
            motors, bench_preset("rollout").for_robot(robot), bench.steps, bench.seed, bench.fleet
        )
        tuned = fit_pd(log, WITH_ROTOR, report=task.advance).constants
    baselines: dict[str, ModelOfMotors] = {
        "ideal_pd": lambda index: nominal_pd(bench.fleet, len(index)),
        "tuned_pd": lambda index: IdealPd.uniform(len(index), **tuned),
    }
    models = baselines | {name: prior.training_motors for name, prior in priors.items()}
    with progress.start("validate: bench, standing robot, suspended robot", 4) as task:
        results = fidelity(robot, motors, models, "train", seed, task)
        task.advance()
    title = "held-out motors: adapt, bench, standing robot, suspended robot"
    with progress.start(title, 4 + len(adapt_seconds)) as task:
        motors = held_out_motors(bench)
        adapted = adapt_all(robot, priors, bench)
        models = baselines | adapted_models(priors, adapted, len(motors))
        task.advance()
        results += fidelity(robot, motors, models, "held_out", seed, task).where(
            quantity=FIDELITY_METRICS
        )
        of_physics = [
            name
            for name, prior in priors.items()
            if name in adapted and isinstance(prior.model, GreyBox)
        ]
        if of_physics:
            name = "rollout" if "rollout" in of_physics else of_physics[0]
            prior = priors[name]
            posterior = adapted[name]
            results += adaptation(
                robot, prior, bench, tuple(adapt_seconds), posterior, seed, task.advance
            )
            results += distribution(prior, bench)
    return results
