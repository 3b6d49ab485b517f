"""All explanations of a bad fit. A new one is an entry here; see `Explanation`."""

from collections.abc import Callable

import numpy as np

from motorprior.identification import windows as channel
from motorprior.identification.explanations.explanation import (
    IS_TURNED,
    LEVER,
    MASS_EXTERNAL,
    MASS_INERTIA,
    MASS_STIFFNESS,
    SLOPE,
    TURNED_EXTERNAL,
    TURNED_INERTIA,
    TURNED_POS,
    TURNED_STIFFNESS,
    Estimate,
    Explanation,
    Facts,
    has_turned_loads,
)
from motorprior.logs.loads_bodies import TURN_POWERS
from motorprior.robots.robot import GRAVITY

_MIN_OFFSET = 0.15  # of a command [rad]; the encoder zero of a motor takes up less
_MIN_ZERO = 0.03  # of a zero or a tilt [rad]
_MIN_SHIFT = 0.01  # of the time of a command [s]


def _scaled(*channels: int, parameter: int = 0) -> Callable:
    """Change that multiplies channels by the exponential of a parameter."""

    def change(rows: np.ndarray, theta: np.ndarray, period: float) -> np.ndarray:
        rows[:, channels] *= np.exp(theta[parameter])
        return rows

    return change


def _stated(facts: Facts) -> bool:
    return facts.gains is not None


def _states_kd(facts: Facts) -> bool:
    return facts.gains is not None and facts.has_kd


def _gains_text(estimate: Estimate, joint: int, facts: Facts) -> tuple[str, str]:
    assert facts.gains is not None
    factor = float(np.exp(estimate.values[0]))
    kp = factor * facts.gains[0, joint]
    names = "the stated kp and kd" if facts.has_kd else "the stated kp"
    size = f"{_ratio(estimate)} times too {'small' if factor > 1.0 else 'large'}"
    remedy = f"the drive scales them: leave them out of the column map, or state kp {kp:.3g}"
    if facts.has_kd:
        remedy += f" and kd {factor * facts.gains[1, joint]:.3g}"
    # all torques of a motor and its load can be scaled together without another motion
    remedy += f"; or the gains are right and the load is {1.0 / factor:.3g} times the stated one"
    return f"{names} are {size}" if facts.has_kd else f"{names} is {size}", remedy


def _gains_of_log_text(estimate: Estimate, joint: int, facts: Facts) -> tuple[str, str]:
    problem = f"kp and kd are {estimate.factor_text()} times those of the other logs"
    return problem, "another gain or supply voltage: state the gains of each log, or its voltage"


def _one_gain_text(row: int) -> Callable:
    name = ("kp", "kd")[row]

    def describe(estimate: Estimate, joint: int, facts: Facts) -> tuple[str, str]:
        assert facts.gains is not None
        factor = float(np.exp(estimate.values[0]))
        size = f"{_ratio(estimate)} times too {'small' if factor > 1.0 else 'large'}"
        gain = factor * facts.gains[row, joint]
        remedy = f"check its unit: leave it out of the column map, or state {name} {gain:.3g}"
        return f"the stated {name} is {size}", remedy

    return describe


def _ratio(estimate: Estimate) -> str:
    """The factor or its inverse, whichever is above 1, with its interval."""
    ends = np.array([estimate.low[0], estimate.high[0]])
    sign = 1.0 if estimate.values[0] > 0.0 else -1.0
    low, high = np.sort(np.exp(sign * ends)).tolist()
    return f"{np.exp(abs(estimate.values[0])):.3g} [{low:.3g}, {high:.3g}]"


def _scaled_load(rows: np.ndarray, theta: np.ndarray, period: float) -> np.ndarray:
    rows[:, (channel.EXTERNAL, channel.STIFFNESS)] *= np.exp(theta[0])
    rows[:, channel.INERTIA] *= np.exp(theta[1])
    return rows


def _load_text(estimate: Estimate, joint: int, facts: Facts) -> tuple[str, str]:
    problem = (
        f"the weight of the load is {estimate.factor_text(0)} times the stated one, and its "
        f"inertia {estimate.factor_text(1)} times"
    )
    return problem, "correct the masses of the robot's model, or add the tool that it carries"


def _weighted(rows: np.ndarray, theta: np.ndarray, period: float) -> np.ndarray:
    rows[:, (channel.EXTERNAL, channel.STIFFNESS)] *= 1.0 - theta[0]
    return rows


def _weight_text(estimate: Estimate, joint: int, facts: Facts) -> tuple[str, str]:
    share = f"{estimate.text(factor=100.0)} %"
    if estimate.values[0] < 0.0:
        more = Estimate(-estimate.values, estimate.half_widths)
        problem = f"the load weighs {more.text(factor=100.0)} % more than stated"
        return problem, "correct the masses of the robot's model, or add the tool that it carries"
    problem = f"{share} of the load's weight does not reach the motor's control law"
    remedy = (
        "the controller compensates gravity (a torque feed-forward): log this torque, or record "
        "without it; or the model's masses are too large"
    )
    return problem, remedy


def _scaled_command(rows: np.ndarray, theta: np.ndarray, period: float) -> np.ndarray:
    rows[:, channel.TARGET] = np.exp(theta[0]) * rows[:, channel.TARGET] + theta[1]
    return rows


def _command_guess(rows: np.ndarray) -> np.ndarray:
    """(M, 2) logarithm of the slope, and offset, of a regression of angles on commands."""
    target = rows[:, channel.TARGET]
    angle = rows[:, channel.POS]
    centred = target - target.mean(axis=0)
    variance = np.maximum(np.mean(centred**2, axis=0), 1e-12)
    slope = np.mean(centred * angle, axis=0) / variance
    slope = np.maximum(slope, 1e-3)
    return np.stack([np.log(slope), angle.mean(axis=0) - slope * target.mean(axis=0)], axis=1)


def _angle_guess(rows: np.ndarray) -> np.ndarray:
    """(M, 1) negative logarithm of this slope."""
    return -_command_guess(rows)[:, :1]


def _command_text(estimate: Estimate, joint: int, facts: Facts) -> tuple[str, str]:
    scale = float(np.exp(estimate.values[0]))
    name = facts.joint_names[joint]
    has_offset = abs(estimate.values[1]) > _MIN_OFFSET
    offset = f", plus {estimate.text(1)} rad" if has_offset else ""
    setting = "this scale and zero" if has_offset else f"scale = {scale:.3g}"
    problem = f"the motors follow {estimate.factor_text()} times the command{offset}"
    remedy = f"scaled actions, or another unit: set {setting} in [joints.{name}.position_target]"
    return problem, f"{remedy} of the column map"


def _scaled_angle(rows: np.ndarray, theta: np.ndarray, period: float) -> np.ndarray:
    rows[:, channel.TARGET] /= _scale_of_joint(rows, theta)
    return _scaled_joint(rows, theta, period)


def _scale_of_joint(rows: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Scale exp(θ) of the joint that is turned; 1 for other joints."""
    is_turned = rows[:, IS_TURNED] if has_turned_loads(rows) else 1.0
    return np.exp(theta[0] * is_turned)


def _angle_text(estimate: Estimate, joint: int, facts: Facts) -> tuple[str, str]:
    scale = float(np.exp(estimate.values[0]))
    problem = f"the angles{{of}} are {estimate.factor_text(0)} times the logged ones"
    remedy = f"wrong ticks, unit or gear ratio: scale = {scale:.3g} in [joints.{{joint}}.joint_pos]"
    return problem, f"{remedy} of the column map"


def _scaled_joint(rows: np.ndarray, theta: np.ndarray, period: float) -> np.ndarray:
    """Angles that are exp(θ) times the logged ones, in logged units.

    With s = exp(θ), J·s·q̈ = kp·s·(u - q) + τ(s·q) for an external torque τ; τ/s is the external
    torque in logged units. Loads were computed at the logged angles.
    """
    angle = rows[:, TURNED_POS] if has_turned_loads(rows) else rows[:, channel.POS]
    rows = _turned(rows, np.expm1(theta[0]) * angle)
    scale = _scale_of_joint(rows, theta)
    external = rows[:, channel.EXTERNAL] + rows[:, channel.STIFFNESS] * rows[:, channel.POS]
    rows[:, channel.EXTERNAL] = external / scale - rows[:, channel.STIFFNESS] * rows[:, channel.POS]
    rows[:, channel.TORQUE] /= scale
    return rows


def _joint_text(estimate: Estimate, joint: int, facts: Facts) -> tuple[str, str]:
    scale = float(np.exp(estimate.values[0]))
    problem = f"commands and angles{{of}} are {estimate.factor_text(0)} times the logged ones"
    remedy = f"wrong gear ratio, ticks or unit: scale = {scale:.3g} for both columns"
    return problem, f"{remedy} in the column map"


def _moved_angle(rows: np.ndarray, theta: np.ndarray, period: float) -> np.ndarray:
    """The command less by θ, which moves the angle by θ; the loads stay."""
    rows[:, channel.TARGET] -= theta[0]
    return rows


def _moved_angle_text(estimate: Estimate, joint: int, facts: Facts) -> tuple[str, str]:
    name = facts.joint_names[joint]
    problem = f"the angle is {estimate.text()} rad more than logged, against its command"
    remedy = f"zero = {estimate.values[0]:.3g} in [joints.{name}.joint_pos] of the column map"
    return problem, remedy


def _gravity_change(rows: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    """Rows with another acceleration of gravity (T or 1, 3, L) [m/s²]."""
    level = np.array([0.0, 0.0, -GRAVITY])[:, None]
    change = gravity - level
    torque = np.einsum("tdl,tdl->tl", rows[:, LEVER], np.broadcast_to(change, rows[:, LEVER].shape))
    slope = np.einsum("tdl,tdl->tl", rows[:, SLOPE], np.broadcast_to(change, rows[:, SLOPE].shape))
    rows[:, channel.EXTERNAL] += torque - slope * rows[:, channel.POS]
    rows[:, channel.STIFFNESS] += slope
    return rows


def _tilted(rows: np.ndarray, theta: np.ndarray, period: float) -> np.ndarray:
    roll, pitch = theta
    direction = np.stack(
        [np.sin(pitch), -np.sin(roll) * np.cos(pitch), -np.cos(roll) * np.cos(pitch)]
    )
    return _gravity_change(rows, GRAVITY * direction[None])


def _tilt_text(estimate: Estimate, joint: int, facts: Facts) -> tuple[str, str]:
    degrees = 180.0 / np.pi
    roll, pitch = estimate.values
    tilt = degrees * np.arccos(np.cos(roll) * np.cos(pitch))
    problem = (
        f"the base is tilted by {tilt:.3g}° (roll {estimate.text(0, degrees)}°, "
        f"pitch {estimate.text(1, degrees)}°)"
    )
    return problem, "level the base, or turn the base of the robot's model by these angles"


def _moved_zero(rows: np.ndarray, theta: np.ndarray, period: float) -> np.ndarray:
    """The true angle is the logged one plus θ."""
    return _turned(rows, np.broadcast_to(theta[0], rows[:, channel.POS].shape))


def _turned(rows: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """A joint is turned by an angle (T, L) [rad], with all that it carries."""
    if has_turned_loads(rows):
        powers = angle[:, None] ** np.arange(1, 1 + TURN_POWERS)[:, None]  # (T, powers, L)
        stiffness = np.sum(rows[:, TURNED_STIFFNESS] * powers, axis=1)
        external = np.sum(rows[:, TURNED_EXTERNAL] * powers, axis=1)
        rows[:, channel.INERTIA] += np.sum(rows[:, TURNED_INERTIA] * powers, axis=1)
        rows[:, channel.EXTERNAL] += external - stiffness * rows[:, channel.POS]
        rows[:, channel.STIFFNESS] += stiffness
        return rows

    # without bodies: all of the external torque is that of one weight
    stiffness = rows[:, channel.STIFFNESS].copy()
    external = rows[:, channel.EXTERNAL] + stiffness * rows[:, channel.POS]
    cosine = np.cos(angle)
    sine = np.sin(angle)
    rows[:, channel.STIFFNESS] = cosine * stiffness - sine * external
    torque = cosine * external + sine * stiffness
    rows[:, channel.EXTERNAL] = torque - rows[:, channel.STIFFNESS] * rows[:, channel.POS]
    return rows


def _zero_text(estimate: Estimate, joint: int, facts: Facts) -> tuple[str, str]:
    moved = Estimate(-estimate.values, estimate.half_widths)
    problem = f"gravity fits with the zero of {{joint}} moved by {moved.text()} rad"
    remedy = "command and angle have another zero than the model: home the joint again, or state"
    return problem, f"{remedy} zero = {estimate.values[0]:.3g} for both columns in the column map"


def _with_mass(rows: np.ndarray, theta: np.ndarray, period: float) -> np.ndarray:
    """The loads of a mass on a link are added, by the formula of `LinkMass`.

    The parameters are the moment μ·d and log d: weight tells the one, inertia the other.
    """
    moment = theta[0]
    distance = np.exp(theta[1])
    weights = moment * np.stack([1.0 / distance, np.ones_like(distance), distance])
    inertia = np.einsum("tpl,pl->tl", rows[:, MASS_INERTIA], weights)
    external = np.einsum("tpl,pl->tl", rows[:, MASS_EXTERNAL], weights)
    stiffness = np.einsum("tpl,pl->tl", rows[:, MASS_STIFFNESS], weights)
    rows[:, channel.INERTIA] += inertia
    rows[:, channel.EXTERNAL] += external - stiffness * rows[:, channel.POS]
    rows[:, channel.STIFFNESS] += stiffness
    return rows


def _mass_text(estimate: Estimate, joint: int, facts: Facts) -> tuple[str, str]:
    size = Estimate(np.abs(estimate.values), estimate.half_widths)
    moment_unit = float(facts.link_mass[joint] * facts.link_reach[joint])
    moment = f"{size.text(0, moment_unit)} kg·m about {facts.joint_names[joint]}"
    distance = float(facts.link_reach[joint] * np.exp(estimate.values[1]))
    mass = moment_unit * float(size.values[0]) / distance
    example = f"such as {mass:.2g} kg at {distance:.2g} m"
    if estimate.values[0] < 0.0:
        problem = f"the model of the load has {moment} too much, {example}"
        return problem, "correct the robot's model"
    remedy = "add this part (a tool, a cable, the next motor) to the robot's model"
    return f"the model of the load lacks {moment}, {example}", remedy


def _led(rows: np.ndarray, theta: np.ndarray, period: float) -> np.ndarray:
    rows[:, channel.TARGET] += theta[0] * np.gradient(rows[:, channel.TARGET], period, axis=0)
    return rows


def _lead_text(estimate: Estimate, joint: int, facts: Facts) -> tuple[str, str]:
    milliseconds = estimate.text(factor=1e3)
    share = estimate.values[0] / facts.kd_over_kp[joint]
    problem = (
        f"the control law adds {milliseconds} ms times the rate of the command, which is "
        f"{share:.2g} times kd/kp"
    )
    remedy = "it also gets a velocity target (velocity feed-forward): log it with the position"
    return problem, remedy


def _multiplied_command(column: int) -> Callable:
    """Change that multiplies a command by 1 + θ, which may be negative."""

    def change(rows: np.ndarray, theta: np.ndarray, period: float) -> np.ndarray:
        rows[:, column] *= 1.0 + theta[0]
        return rows

    return change


def _command_factor_text(name: str) -> Callable:
    def describe(estimate: Estimate, joint: int, facts: Facts) -> tuple[str, str]:
        factor = Estimate(1.0 + estimate.values, estimate.half_widths)
        problem = f"{name} acts {factor.text()} times as strongly as logged"
        return problem, f"correct its sign or unit in the column map: [joints.….{name}]"

    return describe


def _has_command(name: str) -> Callable[[Facts], bool]:
    return lambda facts: name in facts.commands


def _shifted(rows: np.ndarray, theta: np.ndarray, period: float) -> np.ndarray:
    """The command later by θ [s]."""
    count = len(rows)
    times = np.clip(np.arange(count)[:, None] - theta[0] / period, 0.0, count - 1.0)
    earlier = np.minimum(times.astype(int), count - 2)
    share = times - earlier
    target = rows[:, channel.TARGET]
    first = np.take_along_axis(target, earlier, axis=0)
    second = np.take_along_axis(target, earlier + 1, axis=0)
    rows[:, channel.TARGET] = (1.0 - share) * first + share * second
    return rows


def _delay_text(estimate: Estimate, joint: int, facts: Facts) -> tuple[str, str]:
    later = estimate.values[0] > 0.0
    size = Estimate(np.abs(estimate.values), estimate.half_widths)
    problem = (
        f"the command acts {size.text(factor=1e3)} ms {'later' if later else 'earlier'} than logged"
    )
    return problem, "command and angle have different clocks: shift the time of one of them"


def _torque_text(estimate: Estimate, joint: int, facts: Facts) -> tuple[str, str]:
    problem = f"the torque of the joint is {estimate.factor_text()} times the torque column"
    return problem, "correct its scale in the column map, or leave the column out"


EXPLANATIONS = (
    Explanation(
        "stated_gains",
        _scaled(channel.KP, channel.KD),
        _gains_text,
        applies=_stated,
        scales_torques=True,
        smallest=(0.1,),
    ),
    Explanation(
        "stated_kp", _scaled(channel.KP), _one_gain_text(0), smallest=(0.1,), applies=_states_kd
    ),
    Explanation(
        "stated_kd", _scaled(channel.KD), _one_gain_text(1), smallest=(0.2,), applies=_states_kd
    ),
    Explanation(
        "gains_of_log",
        _scaled(channel.KP, channel.KD),
        _gains_of_log_text,
        per_log=True,
        only_per_log=True,
    ),
    Explanation("load", _scaled_load, _load_text, units=(1.0, 1.0), smallest=(0.1, 0.2)),
    Explanation("weight", _weighted, _weight_text, smallest=(0.1,)),
    Explanation(
        "command_scale",
        _scaled_command,
        _command_text,
        units=(1.0, 1.0),
        smallest=(0.05, _MIN_OFFSET),
        guess=_command_guess,
        replaces=("encoder_zero",),
    ),
    Explanation("angle_scale", _scaled_angle, _angle_text, guess=_angle_guess, turns=True),
    Explanation("joint_scale", _scaled_joint, _joint_text, turns=True),
    Explanation(
        "angle_zero",
        _moved_angle,
        _moved_angle_text,
        units=(0.5,),
        smallest=(_MIN_ZERO,),
        per_log=True,
        only_per_log=True,
    ),
    Explanation(
        "zero", _moved_zero, _zero_text, (0.5,), smallest=(_MIN_ZERO,), per_log=True, turns=True
    ),
    Explanation(
        "tilt",
        _tilted,
        _tilt_text,
        units=(0.5, 0.5),
        smallest=(_MIN_ZERO, _MIN_ZERO),
        applies=lambda facts: facts.has_gravity,
        per_log=True,
        is_shared=True,
        is_even=True,
    ),
    Explanation(
        "mass_of_link",
        _with_mass,
        _mass_text,
        units=(0.15, 0.5),
        smallest=(0.03, np.inf),
        applies=lambda facts: facts.has_gravity,
        adds_mass=True,
    ),
    Explanation(
        "velocity_target",
        _led,
        _lead_text,
        units=(0.1,),
        smallest=(0.005,),
        applies=lambda facts: "velocity_target" not in facts.commands,
    ),
    Explanation(
        "velocity_target_scale",
        _multiplied_command(channel.VELOCITY_TARGET),
        _command_factor_text("velocity_target"),
        smallest=(0.2,),
        applies=_has_command("velocity_target"),
    ),
    Explanation(
        "feedforward_scale",
        _multiplied_command(channel.FEEDFORWARD),
        _command_factor_text("torque_feedforward"),
        smallest=(0.1,),
        applies=_has_command("torque_feedforward"),
    ),
    Explanation(
        "delay", _shifted, _delay_text, units=(0.05,), smallest=(_MIN_SHIFT,), held=("delay",)
    ),
    Explanation(
        "delay_of_log",
        _shifted,
        _delay_text,
        units=(0.05,),
        smallest=(0.5 * _MIN_SHIFT,),
        per_log=True,
        only_per_log=True,
    ),
    Explanation(
        "torque_scale",
        _scaled(channel.TORQUE),
        _torque_text,
        applies=lambda facts: facts.has_torque,
    ),
)
