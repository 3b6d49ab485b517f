"""Named recipes of identification."""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from motorprior.actuator.motor_prior import FROZEN, MotorPrior
from motorprior.actuator.optional_terms import TERMS, UNLIMITED, constants_of, terms_with
from motorprior.bounds import require_count
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.logs.motor_log import OPERATING_CONDITIONS, MotorLog, channels


@dataclass(frozen=True)
class Recipe:
    """Recipe of an identification, of grey boxes or of networks."""

    objective: str  # ``torque`` (one-step regression, the paper's) or ``rollout`` (closed loop)
    period: float  # sample period of the motors [s]
    # ``together``, with a Gaussian over the motors, or ``alone``; "": a network, trained by Adam
    grey_boxes: str = ""
    taps: tuple[int, ...] = (0,)  # networks: ages of the history inputs [periods]
    has_armature: bool = False  # networks: decode an armature from z for the engine
    num_latents: int = 4  # networks: size of z; 0 gives one network for all motors
    num_neurons: int = 24  # neurons per hidden layer
    kl_weight: float = 1e-3  # weight of KL(N(μ, σ²) ‖ N(0, I)), sum over latents, mean over motors
    # steps before a window that follow the recorded joint until the hidden state converges; too few
    # bias friction low
    warm_up: int = 0
    window: int = 64  # steps of a rollout (1 for torque regression)
    # sample z from the motors' posteriors in training, as the paper does; otherwise use the mean
    noisy: bool = True
    batch: int = 256  # windows per Adam step
    steps: int = 3000  # Adam steps
    learning_rate: float = 3e-3  # peak of a cosine schedule with warm-up
    terms: tuple[str, ...] = ()  # optional terms (`optional_terms`) of the motors
    tries_terms: bool = True  # whether terms are selected
    # constants that the motors do not have, such as frictions; without those of GEAR, the gear is
    # rigid
    lacks: tuple[str, ...] = ()
    gain_unit: str = ""  # of the logged gains that kp and kd are multiples of; "" if there are none
    # names and values [SI] of the logged registers (`MotorLog.firmware`), 0 if off; they are not
    # fitted
    firmware: tuple[tuple[str, float], ...] = ()
    # logged OPERATING_CONDITIONS, each with its minimum over segment means, its median and its
    # maximum [V], [°C]; constants are those at the medians
    conditions: tuple[tuple[str, float, float, float], ...] = ()
    # after the training, make latents N(0, 1) over the motors, with Laplace posteriors
    # (`standard_posterior`)
    standardise: bool = False

    @property
    def history(self) -> int:
        """Number of steps in a window before the first free step."""
        return max(self.taps[-1], self.warm_up)

    @property
    def nominal_conditions(self) -> dict[str, float]:
        """Medians by channel."""
        return {name: nominal for name, _, nominal, _ in self.conditions}

    @property
    def logged_terms(self) -> tuple[str, ...]:
        """Optional terms with logged constants."""
        return terms_with(name for name, value in self.firmware if value > 0.0)

    @property
    def disabled_terms(self) -> tuple[str, ...]:
        """Optional terms whose constants are all logged as off."""
        off = {name for name, value in self.firmware if value == 0.0}
        return tuple(
            name for name in TERMS if (own := constants_of((name,))) and off.issuperset(own)
        )

    @property
    def logged_values(self) -> dict[str, float]:
        """Logged values of constants; UNLIMITED of a limit that is off."""
        return {name: value or UNLIMITED.get(name, 0.0) for name, value in self.firmware}


GEAR = FROZEN["gear"]
_TAPS = (0, 1, 2, 4, 6, 9, 13, 20)
# rollout: grey boxes over windows of an eighth of a second, refined on longer ones.
# long_runs: over windows of a second, for servos of real robots: a dead zone or a dry friction is
# barely identifiable     in an eighth of a second. The warm-up is a tenth of a second, since often
# only the first step of a segment     identifies a torque limit.
# quick: long_runs without the selection of optional terms, which takes minutes.
# rigid: quick with rigid gears and without load-dependent friction, for walking. Logs of suspended
# legs are replayed a     little better with both, which stand in for physics that the model lacks;
# with soft gears the robot falls. Baselines:
# per_motor: every motor's constants by a search on its own log (as PACE, Bjelonic et al., 2025).
# pace, pace_long_runs: per_motor and its long runs without optional terms but logged ones.
# coulomb_viscous, stribeck: pace_long_runs with these frictions only, none that grows with the
# load. latent_network: a network gives the whole torque, z also the armature.
# one_network: latent_network without latents.
# actuator_net: the recipe of Hwangbo et al., Science Robotics 4, 2019: three taps, softsign, torque
# regression. paper_wide: the paper's loss on the data, sample period and taps of rollout, a control
# between paper and rollout.
_ROLLOUT = Recipe("rollout", 0.002, "together", warm_up=120, standardise=True)
_LONG_RUNS = replace(_ROLLOUT, window=500, warm_up=50)
_PER_MOTOR = replace(_ROLLOUT, grey_boxes="alone")
_PACE_LONG_RUNS = replace(_LONG_RUNS, grey_boxes="alone", tries_terms=False)
_NETWORK = Recipe("rollout", 0.002, taps=_TAPS, has_armature=True)
PRESETS = {
    "paper": Recipe("torque", 0.01, taps=(0, 1, 2, 3, 4), window=1, batch=1024, steps=4000),
    "rollout": _ROLLOUT,
    "long_runs": _LONG_RUNS,
    "quick": replace(_LONG_RUNS, tries_terms=False),
    "rigid": replace(_LONG_RUNS, tries_terms=False, lacks=(*GEAR, "load_friction")),
    "per_motor": _PER_MOTOR,
    "pace": replace(_PER_MOTOR, tries_terms=False),
    "pace_long_runs": _PACE_LONG_RUNS,
    "coulomb_viscous": replace(_PACE_LONG_RUNS, lacks=("load_friction", "stribeck_torque")),
    "stribeck": replace(_PACE_LONG_RUNS, lacks=("load_friction",)),
    "latent_network": replace(_NETWORK, standardise=True),
    "one_network": replace(_NETWORK, num_latents=0),
    "actuator_net": Recipe(
        "torque",
        0.002,
        taps=(0, 5, 10),
        num_latents=0,
        num_neurons=32,
        window=1,
        batch=1024,
        steps=4000,
    ),
    "paper_wide": Recipe("torque", 0.002, taps=_TAPS, window=1, batch=1024, steps=4000),
}


def identification_preset(name: str, steps: int | None = None) -> Recipe:
    """The preset of that name, with this number of Adam steps if given; ConfigError if it trains no network."""
    if name not in PRESETS:
        raise ConfigError(
            f"no identification preset {name!r}", remedy=f"use one of {', '.join(PRESETS)}"
        )
    if steps is None:
        return PRESETS[name]
    require_count("steps", steps)
    if PRESETS[name].grey_boxes:
        others = ", ".join(name for name, other in PRESETS.items() if not other.grey_boxes)
        problem = f"steps {steps} has no effect on preset {name!r}, which trains no network"
        raise ConfigError(problem, remedy=f"leave it out, or use one of {others}", argument="steps")
    return replace(PRESETS[name], steps=steps)


def network_steps(name: str, steps: int | None) -> int | None:
    """``steps`` if this preset trains a network, otherwise None."""
    return None if PRESETS[name].grey_boxes else steps


def recipe_of(prior: MotorPrior) -> Recipe:
    """The recipe that a prior was trained with; raises `ArtifactError` if it is missing, or of another version."""
    try:
        recipe = prior.provenance["recipe"]
        if recipe.keys() != {field.name for field in fields(Recipe)}:
            raise KeyError("other entries")
        return Recipe(**{name: _hashable(value) for name, value in recipe.items()})
    except (KeyError, AttributeError, TypeError) as error:
        problem = f"its provenance does not hold a recipe of this version ({error})"
        raise ArtifactError(problem, remedy="identify it again") from error


def _hashable(value: Any) -> Any:
    return tuple(map(_hashable, value)) if isinstance(value, list) else value


def with_logged_settings(recipe: Recipe, log: MotorLog) -> Recipe:
    """The recipe with the gains, registers and conditions of a log, which a grey box does not fit."""
    if not recipe.grey_boxes:
        return recipe
    if log.logged_kp is not None:
        recipe = replace(recipe, gain_unit=log.gain_unit)
    conditions = []
    for name in sorted(OPERATING_CONDITIONS.keys() & channels(log).keys()):
        means = np.array([part.operating_conditions[name] for part in log.segments()])
        nominal = np.median(channels(log)[name])
        conditions.append((name, float(means.min()), float(nominal), float(means.max())))
    return replace(
        recipe, firmware=tuple(sorted(log.firmware.items())), conditions=tuple(conditions)
    )
