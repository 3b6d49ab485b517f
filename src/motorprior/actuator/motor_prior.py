"""The motor prior: a distribution of motors, saved as a file.

Training motor i has the latents z = μ_i. A new motor has z ~ N(m, I), where m is the mean of its
class of joints (`class_latents`), 0 for a prior with one class.
"""

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from motorprior.actuator import prior_tables
from motorprior.actuator.actuator import ConstantFactors
from motorprior.actuator.class_latents import ClassLatents
from motorprior.actuator.constants import (
    NUM_SAMPLES,
    PER_LOGGED_GAIN,
    UNITS,
    Constants,
    named_constants,
)
from motorprior.actuator.copula import SCORES, Copula
from motorprior.actuator.estimates import Estimates
from motorprior.actuator.fit_metrics import FitMetrics
from motorprior.actuator.gains import checked_gains
from motorprior.actuator.geared_motor_step import parameters_of
from motorprior.actuator.grey_box import GreyBox, GreyBoxActuator
from motorprior.actuator.optional_terms import TERMS
from motorprior.artifacts import tensors_as_bytes, write_tensors
from motorprior.bounds import (
    BOOLEAN,
    TABLE,
    TEXT,
    exactly,
    generator_of,
    many,
    number,
    one_of,
    require_count,
    require_number,
)
from motorprior.exceptions import ArtifactError, ConfigError, listed
from motorprior.logs.motor_log import GAIN_UNITS, PHYSICAL_GAINS, MotorLog
from motorprior.robots.joint_classes import classes_among, unknown_class
from motorprior.schema import Header, Tensor, check_tensors
from motorprior.texts import Overview, Printable

if TYPE_CHECKING:
    from motorprior.actuator.latent import LatentNetwork, NetworkActuator
    from motorprior.robots.robot import Robot

_UNITS = {"position": "rad", "velocity": "rad/s", "torque": "N·m", "armature": "kg·m²", "time": "s"}
SIGN = "error = position_target - joint_pos; a positive torque accelerates the joint upwards"
_REMEDY = "identify it again with this version"
# assumed standard deviation of z about the training motor of the same joint: its friction varies by
# 13 to 17 %
SAME_JOINT_STD = 0.3
# factor on the standard deviations of an adaptation: most of its error is model error, the same in
# all windows
MODEL_ERROR = 1.5
COMMAND_MODE = "command_mode"  # entry of the provenance, for another mode than position
FROZEN = {  # constants by group, for `MotorPrior.with_frozen`
    "friction": ("coulomb", "stribeck_torque", "viscous_damping", "load_friction"),
    "delay": ("delay", "velocity_filter"),
    "armature": ("armature",),
    "gear": ("gear_stiffness", "backlash", "gear_damping"),
}
_HEADER = Header(
    "motor prior",
    9,
    {
        "units": exactly(_UNITS),
        "sign": exactly(SIGN),
        "motor_parameters": many(TEXT),
        "motor_terms": many(one_of(*TERMS)),
        "period": number(above=0.0),
        "network": TABLE,
        **dict.fromkeys(("grey_box", "standardised"), BOOLEAN),
        **dict.fromkeys(("preset", "robot", "motor"), TEXT),
        **dict.fromkeys(("joint_names", "classes", "joint_classes"), many(TEXT)),
        "gain_unit": one_of("", *GAIN_UNITS),
        **dict.fromkeys(("provenance", "metrics"), TABLE),
    },
    _REMEDY,
    "prior.safetensors",
    "identify",
)
SCHEMA_VERSION = _HEADER.version
# shipped motor cards
LIBRARY = files("motorprior") / "exports" / "library"
CARD_PRIOR = "prior.safetensors"
_MOTORS = {
    "mean": Tensor(("motors", "latents")),
    "log_var": Tensor(("motors", "latents")),
    "misfit": Tensor(("motors",), above=0.0),
    "class_mean": Tensor(("classes", "latents")),
    "unseen_std": Tensor(("latents",), above=0.0),
}
_GAINS = {"gains": Tensor((2, "motors"))}
_GREY_BOX = {
    "motor_center": Tensor(("constants",)),
    "motor_slope": Tensor(("latents", "constants")),
}
_ESTIMATES = {
    "estimate_covariance": Tensor(("motors", "constants", "constants")),
    "estimate_scale": Tensor(("motors", "constants")),
}
_COPULA = {"mixing": Tensor(("latents", "latents")), "quantiles": Tensor((len(SCORES), "latents"))}


Decoder: TypeAlias = "GreyBox | LatentNetwork"
"""From latents to motors."""


class Prediction(NamedTuple):
    """Distribution of the motors of J joints, without using their logs."""

    mean: np.ndarray  # (J, Z) of z
    std: np.ndarray  # (J, Z)
    misfit: np.ndarray  # (J,) factor on the residuals


@dataclass(frozen=True, repr=False)
class MotorPrior(Printable):
    """A learned distribution of motors, with M training motors and Z latents."""

    model: Decoder
    mean: np.ndarray  # (M, Z) posterior means of the training motors
    log_var: np.ndarray  # (M, Z) their log-variances
    preset: str  # name of the recipe
    robot: str
    motor: str  # motor model
    # source of the logs (for a bench, its fleet with all distributions), recipe, seed
    provenance: dict[str, Any]
    metrics: FitMetrics = field(default_factory=FitMetrics)  # of the fit
    joint_names: tuple[str, ...] = ()  # names of the training motors' joints; none for a bench
    # (2, M) logged kp and kd of the training motors, None if ``gain_unit`` is ""
    gains: np.ndarray | None = None
    given_classes: ClassLatents | None = None  # `classes`; None: one class
    # (M,) residual of each training motor relative to all motors at its speeds
    # (`reference.residual_scale`) [-]; empty: 1
    misfit: np.ndarray = field(default_factory=lambda: np.ones(0))
    # uncertainty of the constants of the training motors, from their logs alone; None for a network
    estimates: Estimates | None = None

    @property
    def command_mode(self) -> str:
        """Command mode of the training logs, position, mit, velocity or torque."""
        return self.model.command_mode if isinstance(self.model, GreyBox) else "position"

    @property
    def classes(self) -> ClassLatents:
        """Classes of joints."""
        return self.given_classes or ClassLatents.with_one_class(
            len(self.mean), self.model.num_latents
        )

    def joint_classes(self, joints: "MotorLog | Robot | Sequence[str]") -> tuple[str, ...]:
        """The class of each joint of a log or a robot, or of joints of these names.

        `classes_among` states how it is found in the description, the training motor of the same
        name and the joint's name.
        """
        names = joints if isinstance(joints, Sequence) else joints.joint_names
        described = () if isinstance(joints, Sequence) else joints.given_classes
        class_of_training_motor = dict(zip(self.joint_names, self.classes.of_motors, strict=False))
        return classes_among(self.classes.names, names, described, class_of_training_motor)

    def sample(
        self,
        joints: "int | Robot | Sequence[str]",
        seed: int | np.random.Generator,
        gains: np.ndarray | None = None,
        spread: float = 1.0,
    ) -> "GreyBoxActuator | NetworkActuator":
        """Sample new motors, one for each joint, z ~ N(mean of the joint's class, spread²·I).

        A joint of a robot whose torque limit no log identifies gets the limit of the robot's
        description, or the largest torque in the logs if that is larger.

        Args:
            joints: the robot, whose joints have classes; a class or a joint's name per motor; or a
                number of motors. As many motors as the training motors have the classes of these,
                in order. Another number is allowed for priors with one class.
            seed: seed, or a generator to continue.
            gains: (2, count) kp and kd in the model's ``gain_unit``, ignored if that is "". The
                default is the gains of the robot; without these, the gains of the training motors
                if there are as many, and otherwise the medians of the classes. Without a robot and
                gains, motors of logs with velocity or torque commands obey such commands.
            spread: factor on the standard deviation of z [-]; 0 gives the mean motors of the
                classes.

        Raises:
            ConfigError: an argument out of range, a name that is neither a class nor a joint of the
                prior, or a number of motors whose classes are unknown.
        """
        rng = generator_of(seed)
        robot = None if isinstance(joints, int | np.integer | Iterable) else joints
        if robot is not None and gains is None:
            gains = robot_gains(self, robot)
        classes = self._sampled_classes(joints)
        require_number("spread", spread)
        mean, std = self.classes.mean_and_std(classes)
        z = mean + spread * std * rng.standard_normal(mean.shape)
        motors = self.model.motors(z, gains=self.sampled_gains(classes, gains))
        if gains is None:
            motors = with_command_mode(motors)
        if robot is None or not isinstance(motors, GreyBoxActuator):
            return motors
        return self._with_described_limits(motors, classes, robot)

    def _with_described_limits(
        self, motors: GreyBoxActuator, classes: Sequence[str], robot: "Robot"
    ) -> GreyBoxActuator:
        """The motors of a robot, with the torque limits that `sample` states."""
        max_logged_of_class = prior_tables.unreached_torque_limits(self)
        if len(self.classes.names) == 1:  # it is the class of all joints
            classes = self.classes.names * len(classes)
        limit = motors.constants()["torque_limit"]
        factor = np.ones(len(limit))
        for index, (name, joint) in enumerate(zip(classes, robot.joints, strict=True)):
            max_logged = max_logged_of_class.get(name)
            if max_logged is not None:
                factor[index] = max(joint.torque_limit, max_logged) / limit[index]
        if np.all(factor == 1.0):
            return motors
        one = np.ones(len(limit))
        return motors.with_factors(ConstantFactors(one, one, factor, one))

    def with_frozen(self, group: str) -> "MotorPrior":
        """The prior with one group of constants fixed at the values of the mean motor.

        The groups are friction, delay, armature and gear.

        Raises:
            ConfigError: an unknown group, or a prior without physical constants.
        """
        model = self.model
        if group not in FROZEN or not isinstance(model, GreyBox):
            raise ConfigError(
                f"no constants {group!r} to freeze",
                remedy=f"a prior of preset rollout has {', '.join(FROZEN)}",
                argument="frozen",
            )
        is_frozen = np.array([name in FROZEN[group] for name in parameters_of(model.terms)])
        latents_of_mean_motor = model.decoder_latents(np.zeros((1, model.num_latents)))[0]
        mean_motor = model.center + latents_of_mean_motor @ model.slope
        center = np.where(is_frozen, mean_motor, model.center)
        slope = np.where(is_frozen, 0.0, model.slope)
        return replace(self, model=replace(model, center=center, slope=slope))

    def _sampled_classes(self, joints: "int | Robot | Sequence[str]") -> tuple[str, ...]:
        if isinstance(joints, str):
            return self.classes_named((joints,))
        if isinstance(joints, Iterable):
            return self.classes_named(tuple(joints))
        if not isinstance(joints, int | np.integer):
            return self.joint_classes(joints)

        require_count("count", joints)
        training_classes = self.classes.of_motors
        if joints == len(training_classes):
            return training_classes
        names = self.classes.names
        if len(names) > 1:
            problem = f"{joints} motors of a prior with the classes {listed(names, 8)}"
            remedy = f"give the robot, or a class per motor, such as ({names[0]!r},) * {joints}"
            raise ConfigError(problem, remedy=remedy, argument="joints")
        return (training_classes[0],) * joints

    def classes_named(self, names: Sequence[str]) -> tuple[str, ...]:
        """The class of each name, which is the name of a class or of a joint.

        Raises `ConfigError` for other names, unless the prior has a single class.
        """
        classes = []
        for name, class_of_joint in zip(names, self.joint_classes(names), strict=True):
            joint_class = name if name in self.classes.names else class_of_joint
            if len(self.classes.names) > 1 and joint_class not in self.classes.names:
                raise unknown_class(name, self.classes.names, self.joint_names)
            classes.append(joint_class)
        return tuple(classes)

    def sampled_gains(
        self, classes: Sequence[str], gains: np.ndarray | None = None
    ) -> np.ndarray | None:
        """(2, n) gains of new motors of these classes: ``gains``, or those of training motors."""
        if self.gains is None:
            return None
        if gains is not None:
            return checked_gains(gains, len(classes))
        if tuple(classes) == self.classes.of_motors:
            return self.gains

        medians = []
        for name in classes:
            gains_of_class = self.gains[:, self.classes.rows_of(name)]
            medians.append(np.median(gains_of_class, axis=1))
        return np.stack(medians, axis=1)

    def training_motors(self, index: np.ndarray) -> "GreyBoxActuator | NetworkActuator":
        """The training motors at ``index``, at their posterior means."""
        gains = None if self.gains is None else self.gains[:, index]
        return with_command_mode(self.model.motors(self.mean[index], gains=gains))

    def predicted(self, joints: MotorLog | Sequence[str]) -> Prediction:
        """Prediction of the motors of a log, without using its rows, or of joints of these names.

        A joint is predicted to have the training motor of the same name, with a standard deviation
        of 0.3 of that between motors, or else a new motor of its class. With several classes the
        standard deviation is always that between motors, since the log may be from another robot.
        """
        joint_names = joints if isinstance(joints, Sequence) else joints.joint_names
        classes = self.joint_classes(joints)
        mean, std = self.classes.mean_and_std(classes)
        training_misfit = self.misfit if len(self.misfit) else np.ones(len(self.mean))
        misfit = np.zeros(len(classes))
        for joint, name in enumerate(classes):
            misfit_of_class = training_misfit[self.classes.rows_of(name)]
            misfit[joint] = np.sqrt(np.mean(misfit_of_class**2))

        row_of_joint = dict(zip(self.joint_names, range(len(self.mean)), strict=False))
        for joint, name in enumerate(joint_names):
            if name in row_of_joint:
                row = row_of_joint[name]
                mean[joint] = self.mean[row]
                misfit[joint] = training_misfit[row]
                std[joint] = SAME_JOINT_STD if len(self.classes.names) == 1 else 1.0
        return Prediction(mean, std, misfit)

    def intervals(self, level: float = 90.0) -> dict[str, np.ndarray]:
        """(2, M) ends of the central ``level`` % interval of each training motor's constants.

        They are by name, from the joint uncertainty of all constants given the motor's log alone
        (`actuator.estimates`). Constants that were not fitted are left out, and a prior without
        estimates has none.
        """
        return prior_tables.intervals(self, level)

    def spread_facts(self) -> dict[str, str]:
        """Texts on the spread between units, by name: what is measured, pooled and assumed."""
        return prior_tables.spread_facts(self)

    def spread_notes(self) -> list[str]:
        """The `spread_facts` as lines."""
        return [f"{name}: {text}" for name, text in self.spread_facts().items()]

    def constants(self, joint_class: str | None = None) -> Constants:
        """Constants: estimates from the logs, and ranges of new motors at median logged gains.

        New motors are of the class ``joint_class``, or of the class of the joint of this name;
        without one, they have the classes of the training motors, in their proportions. The
        estimates are those of the joint, or medians over the training motors of the class. Raises
        `ConfigError` for another name.
        """
        joint_name = joint_class
        if joint_class is not None:
            is_joint = joint_class in self.joint_names
            if (
                not is_joint
                and joint_class not in self.classes.names
                and len(self.classes.names) < 2
            ):
                raise unknown_class(joint_class, self.classes.names, self.joint_names)
            (joint_class,) = self.classes_named((joint_class,))
        rng = np.random.default_rng(0)
        rows = rng.integers(len(self.mean), size=NUM_SAMPLES)
        classes = [
            self.classes.of_motors[row] if joint_class is None else joint_class for row in rows
        ]
        mean, std = self.classes.mean_and_std(classes)
        latents = mean + std * rng.standard_normal(mean.shape)
        values = named_constants(self.model, latents, self.sampled_gains(classes))
        if self.estimates is None:
            identified = {
                name: self.metrics.identified.get(name.removesuffix(PER_LOGGED_GAIN))
                for name in values
            }
            return Constants.of(values, UNITS, identified)
        motors = prior_tables.motors_of(self, joint_name, joint_class)
        estimates = prior_tables.estimates(self, motors)
        identified = {name: estimate.is_identified for name, estimate in estimates.items()}
        origin = prior_tables.spread_origin(self)
        return Constants.of(values, UNITS, identified, estimates, origin)

    def overview(self) -> Overview:
        """For people: origin, errors, estimates and constants."""
        return prior_tables.overview(self)

    def for_robot(self, robot: str) -> "MotorPrior":
        """The prior for another robot with such motors: each of its joints has a new motor."""
        return replace(self, robot=robot, joint_names=())

    def require(self, robot: str, physics_dt: float) -> None:
        """Raise `ConfigError` for another robot, or a physics step the motors cannot run at."""
        if self.robot not in (robot, ""):
            problem = f"the prior belongs to robot {self.robot!r}, not {robot!r}"
            remedy = (
                f"identify one from logs of {robot}; if {robot} has such motors, add "
                f"of_robot={self.robot} to the text of the motors, "
                f"prior:FILE,of_robot={self.robot}, or use prior.for_robot({robot!r})"
            )
            raise ConfigError(problem, remedy=remedy)
        self.training_motors(np.array([0])).arrays(physics_dt)

    def save(self, path: str | Path) -> None:
        """Write one safetensors file, atomically."""
        write_tensors(Path(path), *self._contents())

    def sha256(self) -> str:
        """Digest of the file that `save` writes; posteriors refer to their prior by it."""
        return hashlib.sha256(tensors_as_bytes(*self._contents())).hexdigest()

    def _contents(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        model = self.model
        terms: tuple[str, ...] = ()
        network: dict[str, Any] = {}
        if isinstance(model, GreyBox):
            tensors = {"motor_center": model.center, "motor_slope": model.slope}
            terms = model.terms
        else:
            tensors, network = model.contents()
        if model.copula is not None:
            tensors["mixing"] = model.copula.mixing
            tensors["quantiles"] = model.copula.quantiles

        header = _HEADER.make(
            units=_UNITS,
            sign=SIGN,
            motor_parameters=list(parameters_of(terms)),
            motor_terms=list(terms),
            period=model.period,
            network=network,
            grey_box=isinstance(model, GreyBox),
            standardised=model.copula is not None,
            preset=self.preset,
            robot=self.robot,
            motor=self.motor,
            provenance=self.provenance,
            metrics=self.metrics.as_json(),
            joint_names=list(self.joint_names),
            gain_unit=model.gain_unit,
            classes=list(self.classes.names),
            joint_classes=list(self.classes.of_motors),
        )
        if self.gains is not None:
            tensors["gains"] = self.gains
        if self.estimates is not None:
            tensors["estimate_covariance"] = self.estimates.covariance
            tensors["estimate_scale"] = self.estimates.scale
        tensors["misfit"] = self.misfit if len(self.misfit) else np.ones(len(self.mean))
        tensors["class_mean"] = self.classes.mean
        tensors["unseen_std"] = self.classes.unseen_std
        tensors["mean"] = self.mean
        tensors["log_var"] = self.log_var
        return tensors, header

    @classmethod
    def load(cls, path: str | Path) -> "MotorPrior":
        """Read a prior, or that of a shipped motor card by name.

        Raises:
            ArtifactError: not a motor prior, another schema, unknown or missing keys, or wrong
                shapes.
        """
        path = prior_path(path)
        tensors, header = _HEADER.read(path)
        _check(tensors, header, path)
        copula = Copula(tensors["mixing"], tensors["quantiles"]) if header["standardised"] else None
        period = float(header["period"])
        if header["grey_box"]:
            center = tensors["motor_center"]
            slope = tensors["motor_slope"]
            terms = tuple(header["motor_terms"])
            command_mode = header["provenance"].get(COMMAND_MODE, "position")
            model = GreyBox(center, slope, period, terms, copula, header["gain_unit"], command_mode)
        else:
            from motorprior.actuator.latent import LatentNetwork  # here: few priors are networks

            model = LatentNetwork.of(tensors, header["network"], period, copula)

        estimates = None
        if "estimate_scale" in tensors:
            estimates = Estimates(tensors["estimate_covariance"], tensors["estimate_scale"])
        classes = ClassLatents(
            names=tuple(header["classes"]),
            of_motors=tuple(header["joint_classes"]),
            mean=tensors["class_mean"],
            unseen_std=tensors["unseen_std"],
        )
        return cls(
            model=model,
            mean=tensors["mean"],
            log_var=tensors["log_var"],
            preset=header["preset"],
            robot=header["robot"],
            motor=header["motor"],
            provenance=header["provenance"],
            metrics=FitMetrics.from_json(header["metrics"], path),
            joint_names=tuple(header["joint_names"]),
            gains=tensors.get("gains"),
            given_classes=classes,
            misfit=tensors["misfit"],
            estimates=estimates,
        )


def shipped_cards() -> tuple[str, ...]:
    """Names of the motor cards in the package."""
    return tuple(sorted(card.name for card in LIBRARY.iterdir() if (card / CARD_PRIOR).is_file()))


def prior_path(path: str | Path) -> Path:
    """The file of a prior, or of a shipped motor card by name."""
    return card_file(str(path)) or Path(path)


def card_file(name: str) -> Path | None:
    """The prior of a shipped motor card; None for other names."""
    return Path(str(LIBRARY / name / CARD_PRIOR)) if name in shipped_cards() else None


def robot_gains(prior: MotorPrior, robot: "Robot") -> np.ndarray | None:
    """(2, joints) kp and kd of the robot's description.

    None if the prior's motors do not scale with gains in SI units, or the description has no
    gains.
    """
    return robot.gains if prior.model.gain_unit == PHYSICAL_GAINS else None


def with_command_mode(
    motors: "GreyBoxActuator | NetworkActuator",
) -> "GreyBoxActuator | NetworkActuator":
    """The motors without the gains that logs of velocity or torque commands lack."""
    if not isinstance(motors, GreyBoxActuator):
        return motors
    return replace(motors, command_mode=motors.model.command_mode)


def limit_text(name: str, value: float) -> str:
    """For example "torque limit of 20 N·m"."""
    unit = {"torque_limit": "N·m", "profile_acceleration": "rad/s²"}.get(name, "rad/s")
    return f"{name.replace('_', ' ')} of {value:.3g} {unit}"


def with_model_error(posterior: np.ndarray, prior: np.ndarray | float) -> np.ndarray:
    """Precision of a posterior whose likelihood has MODEL_ERROR.

    The arguments are the precisions of posterior and prior.
    """
    return prior + (posterior - prior) / MODEL_ERROR**2


def _check(tensors: dict[str, np.ndarray], header: dict[str, Any], path: Path) -> None:
    declared = dict(_MOTORS)
    if header["standardised"]:
        declared |= _COPULA
    if header["gain_unit"]:
        declared |= _GAINS

    names = parameters_of(tuple(header["motor_terms"]))
    network = header["network"]
    if header["grey_box"]:
        declared |= _GREY_BOX
        if "estimate_scale" in tensors:
            declared |= _ESTIMATES
        sizes = {"constants": len(names)}
        is_consistent = not network
    else:
        from motorprior.actuator.latent import WEIGHTS, network_schema

        network_schema(_REMEDY).check(network, path)
        declared |= WEIGHTS
        sizes = {"inputs": 2 * len(network["taps"])}
        is_consistent = network["taps"] == sorted(network["taps"])

    sizes |= {"classes": len(header["classes"]), "motors": len(header["joint_classes"])}
    sizes = check_tensors(tensors, declared, path, _REMEDY, sizes)
    if header["motor_parameters"] != list(names):
        is_consistent = False
    if not {*header["joint_classes"]} <= {*header["classes"]}:
        is_consistent = False
    if sizes["motors"] == 0 or not is_consistent:
        problem = f"{sizes['motors']} motors, network or motor_parameters are inconsistent"
        raise ArtifactError(problem, where=path, remedy=_REMEDY)
