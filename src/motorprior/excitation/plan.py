"""What to play next: the windows of an excitation that shrink the posterior of a fitted motor most.

A window w of free runs adds the information Λ_w = N/T·G_w, with G the Gauss-Newton matrix of the
loss, N its runs and T the mean loss of the fit (see `motor_fit`). Windows are chosen one after the
other to maximise

    log det(I + Σ Λ_w),   greedily, which is within 1 - 1/e of the best set (the objective is submodular).
"""

from dataclasses import dataclass, replace

import numpy as np

from motorprior.actuator.grey_box import GreyBox, GreyBoxActuator
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.actuator.optional_terms import SIGNED
from motorprior.bench.dynamometer import Trial, run
from motorprior.bench.learned_excitation import SUB, UNKNOWN_LOAD, LearnedExcitation
from motorprior.bench.recording import as_log
from motorprior.evaluation.reference import WITHOUT_TORQUE
from motorprior.exceptions import ConfigError
from motorprior.identification.latents.latent_fit import latent_search
from motorprior.identification.presets import recipe_of
from motorprior.identification.windows import training_data, with_window_that_fits

NUM_CANDIDATES = 64  # windows of each class to choose from
MAX_LOG_STD = 0.1  # standard deviation of the logarithm of an identifiable constant
_NUDGE = 0.05  # difference in z for the derivatives of constants


@dataclass(frozen=True)
class Plan:
    """Plan of one joint class: seconds to play, and standard deviations of log-constants before and after."""

    joint_class: str
    seconds: float
    before: dict[str, float]
    after: dict[str, float]
    windows: np.ndarray  # (n,) indices of the candidates, the most informative first

    @property
    def made_identifiable(self) -> list[str]:
        """Constants that the seconds make identifiable."""
        return [n for n, after in self.after.items() if after < MAX_LOG_STD <= self.before[n]]

    def __str__(self) -> str:
        shrunk = ", ".join(
            f"{n} {self.before[n]:.2f} to {after:.2f}" for n, after in self.after.items()
        )
        identifiable = ", ".join(self.made_identifiable) or "nothing more"
        never = (
            ", ".join(name for name, after in self.after.items() if after >= MAX_LOG_STD) or "none"
        )
        play = f"{self.joint_class}: play {self.seconds:.1f} s; makes identifiable: {identifiable}"
        return (
            f"{play}; not identifiable with these windows: {never} (1 σ of the logarithm: {shrunk})"
        )


def check_plan(excitation: LearnedExcitation, prior: MotorPrior) -> GreyBox:
    """The model of a prior that can choose windows of an excitation.

    Raises ConfigError for a prior that is no grey box, since it has no constants, of another robot,
    or that has several joint classes but not those of the excitation, and for runs without loads.
    """
    robots = {run["robot"] for run in excitation.provenance["trained_on"]} - {""}
    if robots and prior.robot not in ("", *robots):
        problem = f"the prior is of robot {prior.robot!r}, the runs of {', '.join(sorted(robots))}"
        raise ConfigError(
            problem, remedy="give a prior of the robot of the runs", argument="plan_prior"
        )
    if not isinstance(prior.model, GreyBox):
        problem = f"the prior (preset {prior.preset}) has no physical constants"
        raise ConfigError(problem, remedy="identify one with preset rollout", argument="plan_prior")
    known = prior.classes.names
    of_class = zip(excitation.classes, prior.joint_classes(excitation.classes), strict=True)
    # a single class serves all
    unknown = [name for name, found in of_class if found not in known and len(known) > 1]
    if unknown:
        problem = f"the prior has the joint classes {', '.join(known)}, the runs also {', '.join(unknown)}"
        raise ConfigError(
            problem, remedy="give a prior of the robot of the runs", argument="plan_prior"
        )
    if np.any(excitation.load_inertia == UNKNOWN_LOAD):
        remedy = "give the robot, and suspended where it was, when the excitation is fitted"
        raise ConfigError("the loads of the runs are unknown", remedy=remedy, argument="plan_prior")
    return prior.model


def plan_excitation(
    excitation: LearnedExcitation,
    prior: MotorPrior,
    seed: int = 0,
    candidates: int = NUM_CANDIDATES,
) -> tuple[LearnedExcitation, list[Plan]]:
    """The chosen windows of every class, played by themselves, and the plans.

    Raises as `check_plan`.
    """
    model = check_plan(excitation, prior)
    rng = np.random.default_rng([seed, 59])
    frames = excitation.windows.shape[1]
    plans = []
    kept = []
    for index, name in enumerate(excitation.classes):
        target, torque = excitation.frames(rng, frames, np.full(candidates, index))
        inertia = np.exp(rng.uniform(*np.log(excitation.load_inertia[index]), size=candidates))
        trial = Trial(np.repeat(target, SUB, axis=0), torque, inertia, excitation.period / SUB)
        plans.append(
            _plan(name, model, information(prior, trial, name), frames * excitation.period)
        )
        windows = np.concatenate(
            [target.T[..., None], torque.T.reshape(candidates, frames, SUB)], axis=2
        )
        kept.append(windows[plans[-1].windows])
    chosen = np.concatenate(kept)
    of_class = np.repeat(np.arange(len(kept)), [len(windows) for windows in kept])
    rest = np.zeros(len(chosen))
    origin = {**excitation.provenance, "plan_of_prior_sha256": prior.sha256()}
    made = replace(
        excitation,
        method="recorded",
        windows=chosen,
        window_class=of_class,
        commands=rest,
        frequency=rest,
        weights={},
        provenance=origin,
    )
    return made, plans


def information(prior: MotorPrior, trial: Trial, joint_class: str) -> np.ndarray:
    """(n, K, K) information about z of the mean motor of a class of joints from each joint of a bench trial."""
    motors = prior.sample((joint_class,) * len(trial.load_inertia), 0, spread=0.0)
    assert isinstance(motors, GreyBoxActuator)
    log = as_log([(trial, run(motors, trial))], prior.motor, "candidates")
    if f"loss_mean{WITHOUT_TORQUE}" not in prior.metrics:  # the robot's logs have no torques
        log = replace(log, joint_torque=None)
    if motors.gains is not None:
        kp, kd = np.repeat(motors.gains[:, None], log.num_rows, axis=1)
        log = replace(log, logged_kp=kp, logged_kd=kd, gain_unit=prior.model.gain_unit)
    preset = with_window_that_fits(recipe_of(prior), log)
    search = latent_search(prior.model, training_data(log, preset, log.source), preset)
    return search.problem.observations / prior.metrics["final_loss"] * search.curvatures(motors.z)


def _plan(name: str, model: GreyBox, added: np.ndarray, seconds: float) -> Plan:
    """The windows that identify every constant that all windows identify, given their information (n, K, K)."""
    slopes = _slopes(model)
    alone = np.eye(added.shape[1])

    def deviations(total: np.ndarray) -> dict[str, float]:
        return {
            key: float(np.sqrt(slope @ np.linalg.solve(total, slope)))
            for key, slope in slopes.items()
        }

    reachable = [
        key for key, value in deviations(alone + added.sum(axis=0)).items() if value < MAX_LOG_STD
    ]
    total = alone
    chosen = []
    after = deviations(alone)
    while not chosen or (
        len(chosen) < len(added) and any(after[key] >= MAX_LOG_STD for key in reachable)
    ):
        gains = np.linalg.slogdet(total + added)[1]
        gains[chosen] = -np.inf
        chosen.append(int(np.argmax(gains)))
        total = total + added[chosen[-1]]
        after = deviations(total)
    return Plan(name, len(chosen) * seconds, deviations(alone), after, np.array(chosen))


def _slopes(model: GreyBox) -> dict[str, np.ndarray]:
    """Derivatives of the logarithm of each positive constant of the central motor that is not fixed by z."""
    nudges = _NUDGE * np.concatenate([np.eye(model.num_latents), -np.eye(model.num_latents)])
    values = {name: np.asarray(value) for name, value in model.constants(nudges).items()}
    logs = {
        n: np.log(value) for n, value in values.items() if n not in SIGNED and np.ptp(value) > 0.0
    }
    return {
        n: (value[: len(value) // 2] - value[len(value) // 2 :]) / (2 * _NUDGE)
        for n, value in logs.items()
    }
