"""Named recipes of identification."""

from dataclasses import asdict, dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np

from motorprior.actuator.motor_prior import FROZEN, MotorPrior
from motorprior.actuator.optional_terms import (
    TERMS,
    UNLIMITED,
    constants_of,
    constants_or_name,
    terms_with,
)
from motorprior.bounds import require_count
from motorprior.exceptions import ArtifactError, ConfigError
from motorprior.logs.motor_log import (
    OPERATING_CONDITIONS,
    PHYSICAL_GAINS,
    MotorLog,
    channels,
)


class LoggedCondition(NamedTuple):
    """Values of one of OPERATING_CONDITIONS in the logs [V], [°C]."""

    name: str
    lowest: float  # minimum over the means of the segments
    nominal: float  # median of all rows
    highest: float  # maximum over the means of the segments


@dataclass(frozen=True)
class Recipe:
    """Settings of an identification, of grey boxes or of networks."""

    # ``torque``: one-step regression of the torque, the paper's; ``rollout``: closed loop
    objective: str
    # sample period of the motors [s]
    period: float
    # grey boxes: ``together``, with a Gaussian over the motors, or ``alone``; "": a network, which
    # is trained by Adam
    grey_boxes: str = ""
    # networks: ages of the history inputs [periods]
    taps: tuple[int, ...] = (0,)
    # networks: whether z also decodes to an armature for the physics engine
    has_armature: bool = False
    # networks: size of z; 0 gives one network for all motors
    num_latents: int = 4
    # networks: neurons per hidden layer
    num_neurons: int = 24
    # networks: weight of KL(N(μ, σ²) ‖ N(0, I)), sum over latents, mean over motors
    kl_weight: float = 1e-3
    # steps before a window in which the model follows the recorded joint, until its hidden state
    # converges; too few bias friction low
    warm_up: int = 0
    # steps of a rollout (1 for torque regression)
    window: int = 64
    # networks: in training, sample z from the motors' posteriors, as the paper does; otherwise use
    # the mean
    noisy: bool = True
    # windows per Adam step
    batch: int = 256
    # Adam steps
    steps: int = 3000
    # peak of a cosine schedule with warm-up
    learning_rate: float = 3e-3
    # optional terms (`optional_terms`) of the motors
    terms: tuple[str, ...] = ()
    # whether terms are selected
    tries_terms: bool = True
    # constants that the motors do not have, such as frictions; without those of GEAR, the gear is
    # rigid
    lacks: tuple[str, ...] = ()
    # unit of the logged gains, whose multiples kp and kd are; "" if no gains are logged
    gain_unit: str = ""
    # names and values [SI] of the logged registers (`MotorLog.firmware`), 0 if off; they are not
    # fitted
    firmware: tuple[tuple[str, float], ...] = ()
    # the fitted constants are about the nominal operating conditions
    operating_conditions: tuple[LoggedCondition, ...] = ()
    # after the training, make latents N(0, 1) over the motors, with Laplace posteriors
    # (`standard_posterior`)
    standardise: bool = False

    @property
    def history(self) -> int:
        """Number of steps in a window before the first free step."""
        return max(self.taps[-1], self.warm_up)

    @property
    def nominal_conditions(self) -> dict[str, float]:
        """Medians of the logged operating conditions by channel."""
        return {condition.name: condition.nominal for condition in self.operating_conditions}

    @property
    def logged_terms(self) -> tuple[str, ...]:
        """Optional terms with logged constants."""
        return terms_with(name for name, value in self.firmware if value > 0.0)

    @property
    def disabled_terms(self) -> tuple[str, ...]:
        """Optional terms whose constants are all logged as off."""
        off = {name for name, value in self.firmware if value == 0.0}
        disabled = []
        for term in TERMS:
            if off.issuperset(constants_or_name(term)):
                disabled.append(term)
        return tuple(disabled)

    @property
    def logged_values(self) -> dict[str, float]:
        """Logged values of constants; UNLIMITED for a limit that is off."""
        values = {}
        for name, value in self.firmware:
            if name in constants_of(TERMS):
                values[name] = value or UNLIMITED.get(name, 0.0)
        return values

    def as_json(self) -> dict[str, Any]:
        """Entries of the recipe as files hold them."""
        return {_FILE_NAMES.get(name, name): value for name, value in asdict(self).items()}


# fields with another name in files
_FILE_NAMES = {"operating_conditions": "conditions"}
_RECIPE_FIELDS = {_FILE_NAMES.get(field.name, field.name): field.name for field in fields(Recipe)}


GEAR = FROZEN["gear"]
_TAPS = (0, 1, 2, 4, 6, 9, 13, 20)
# Grey boxes:
# rollout         over windows of an eighth of a second, refined on longer ones.
# long_runs       over windows of a second, for servos of real robots: a dead zone or a dry friction
#                 is barely identifiable in an eighth of a second. The warm-up is a tenth of a
#                 second, since often only the first step of a segment identifies a torque limit.
# quick           long_runs without the selection of optional terms, which takes minutes.
# rigid           quick with rigid gears and without load-dependent friction, for walking. Logs of
#                 suspended legs are replayed a little better with both, which stand in for physics
#                 that the model lacks; with soft gears the robot falls.
#
# Baselines:
# per_motor       every motor's constants by a search on its own log (as PACE, Bjelonic et al.,
#                 2025).
# pace, pace_long_runs
#                 per_motor and its long runs without optional terms but logged ones.
# coulomb_viscous, stribeck
#                 pace_long_runs with these frictions only, none that grows with the load.
# latent_network  a network gives the whole torque, z also the armature.
# one_network     latent_network without latents.
# actuator_net    the recipe of Hwangbo et al., Science Robotics 4, 2019: three taps, softsign,
#                 torque regression.
# paper_wide      the paper's loss with the data, sample period and taps of rollout: a control
#                 between paper and rollout.
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
    """Recipe of the preset ``name``, with this number of Adam steps if given.

    Raises `ConfigError` for an unknown name, or for steps of a preset that trains no network.
    """
    if name not in PRESETS:
        raise ConfigError(
            f"no identification preset {name!r}", remedy=f"use one of {', '.join(PRESETS)}"
        )
    recipe = PRESETS[name]
    if steps is None:
        return recipe

    require_count("steps", steps)
    if recipe.grey_boxes:
        networks = [preset for preset, network in PRESETS.items() if not network.grey_boxes]
        raise ConfigError(
            f"steps {steps} has no effect on preset {name!r}, which trains no network",
            remedy=f"leave it out, or use one of {', '.join(networks)}",
            argument="steps",
        )
    return replace(recipe, steps=steps)


def network_steps(name: str, steps: int | None) -> int | None:
    """``steps`` if this preset trains a network, otherwise None."""
    return None if PRESETS[name].grey_boxes else steps


def recipe_of(prior: MotorPrior) -> Recipe:
    """The recipe that a prior was trained with.

    Raises `ArtifactError` if the provenance has none, or one of another version.
    """
    try:
        entries = prior.provenance["recipe"]
        if entries.keys() != _RECIPE_FIELDS.keys():
            raise KeyError("other entries")
        values = {_RECIPE_FIELDS[name]: _hashable(value) for name, value in entries.items()}
        values["operating_conditions"] = tuple(
            LoggedCondition(*condition) for condition in values["operating_conditions"]
        )
        return Recipe(**values)
    except (KeyError, AttributeError, TypeError) as error:
        problem = f"its provenance does not hold a recipe of this version ({error})"
        raise ArtifactError(problem, remedy="identify it again") from error


def _hashable(value: Any) -> Any:
    """The value with lists, which JSON has, as tuples."""
    return tuple(map(_hashable, value)) if isinstance(value, list) else value


def with_logged_settings(recipe: Recipe, log: MotorLog) -> Recipe:
    """The recipe with gains, registers and operating conditions of a log.

    A grey box does not fit these; the recipe of a network stays as it is.
    """
    if not recipe.grey_boxes:
        return recipe
    if log.gains is not None:
        recipe = replace(recipe, gain_unit=log.gain_unit)
    if log.command_mode == "torque":
        # torques set the scale, and the gains of such motors are those that will be sent
        recipe = replace(recipe, gain_unit=PHYSICAL_GAINS)

    operating_conditions = []
    for name in sorted(OPERATING_CONDITIONS.keys() & channels(log).keys()):
        means = np.array([segment.operating_conditions[name] for segment in log.segments()])
        nominal = np.median(channels(log)[name])
        operating_conditions.append(
            LoggedCondition(name, float(means.min()), float(nominal), float(means.max()))
        )
    return replace(
        recipe,
        firmware=tuple(sorted(log.firmware.items())),
        operating_conditions=tuple(operating_conditions),
    )
