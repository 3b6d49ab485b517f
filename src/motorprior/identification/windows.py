"""Training data: motor logs as stacked arrays, and random windows that never cross the end of a segment."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from motorprior.exceptions import LogError
from motorprior.identification.presets import Recipe
from motorprior.logs.motor_log import MotorLog, other_firmware
from motorprior.logs.operations import with_velocities, without_noise
from motorprior.signals import rms


@dataclass(frozen=True)
class TrainingData:
    """Logs of M motors with R rows each."""

    # (M, R, CHANNELS) float32. For a rollout, noisy joint_pos is smoothed (`smoothing`); as in a
    # semi-implicit step, velocities are those of half a period earlier and torques are averages
    # centred on the sample
    series: np.ndarray
    starts: np.ndarray  # (S,) first rows of the windows that lie inside one segment
    parts: tuple[slice, ...]  # rows of each segment
    # error_scale [rad], velocity_scale [rad/s], torque_scale and torque_limit [N·m]
    scales: dict[str, float]
    has_torque: bool  # whether the log has joint_torque
    # whether the encoders are on the rotors, which hides the gears' backlash, or on the joints
    at_rotor: bool = False
    joint_names: tuple[str, ...] = ()  # M names, or none
    joint_classes: tuple[str, ...] = ()  # M classes, or none: one class
    # steps over which changes of the joint_reading error are velocity errors; 0: velocities are
    # compared
    velocity_steps: int = 0


(
    TARGET,  # position_target
    POS,  # joint_pos
    VEL,  # joint_vel
    TORQUE,  # joint_torque, 0 if missing
    EXTERNAL,  # external_torque - load_stiffness·joint_pos
    INERTIA,  # load_inertia
    SECONDS,  # since the log began
    KP,  # logged kp, 1 if missing
    KD,  # logged kd, 1 if missing
    SUPPLY,  # supply_voltage over the recipe's, 1 if missing
    TEMPERATURE_RISE,  # motor_temperature above the recipe's [K]
    STIFFNESS,  # load_stiffness, 0 if missing
    READING,  # joint_reading
) = range(CHANNELS := 13)
VELOCITY_NOISE = 0.02  # maximum noise of differences of readings [rad/s]
PAUSE = 60.0  # time between two segments after which motors count as cold again [s]
MEANS = (VEL, TORQUE, EXTERNAL)  # channels that are averaged with the row before for a rollout


def training_data(log: MotorLog, recipe: Recipe, where: str) -> TrainingData:
    """Stack a bench log for training; a rollout needs no velocities or torques.

    Raises:
        LogError: wrong sample period, a missing channel, another firmware, or segments shorter than
            a window.
    """
    if recipe.objective == "rollout":
        log = with_velocities(without_noise(log) if log.encoder == "joint" else log)
    _require(log, recipe, where)
    if other := other_firmware(log.firmware, dict(recipe.firmware)):
        raise LogError(
            f"{other} (log and prior)", where=where, remedy="identify these logs by themselves"
        )
    zero = np.zeros_like(log.joint_pos)
    seconds = np.broadcast_to(seconds_since_cold(log)[:, None], log.joint_pos.shape)
    gains = _by_segment(log, lambda part: _gains(part, recipe, where))
    conditions = _by_segment(log, lambda part: relative_conditions(part, recipe.nominal_conditions))
    channels = (
        log.position_target,
        log.joint_pos,
        log.joint_vel,
        log.joint_torque,
        log.external_torque,
        log.load_inertia,
        seconds,
        *gains,
        *conditions,
        log.load_stiffness,
        log.readings,
    )
    series = np.stack([zero if channel is None else channel for channel in channels], axis=-1)
    series[..., EXTERNAL] -= series[..., STIFFNESS] * series[..., POS]
    parts = tuple(log.segment_slices())
    if recipe.objective == "rollout":
        # a velocity at t becomes that at t - dt/2; a torque averaged over t to t + dt becomes an
        # average centred on t
        before = series.copy()
        for part in parts:
            before[part.start + 1 : part.stop] = series[part.start : part.stop - 1]
        series[..., MEANS] = 0.5 * (series + before)[..., MEANS]
    return TrainingData(
        series=np.ascontiguousarray(series.transpose(1, 0, 2), dtype=np.float32),
        starts=window_starts(parts, recipe, where),
        parts=parts,
        scales=_scales(log, where),
        joint_names=log.joint_names,
        joint_classes=log.joint_classes,
        velocity_steps=_velocity_steps(log),
        has_torque=log.joint_torque is not None,
        at_rotor=log.encoder == "rotor",
    )


def _velocity_steps(log: MotorLog) -> int:
    noises = rms(log.readings - log.joint_pos, axis=0)
    if not noises.any():
        return 0
    noise = float(np.median(noises[noises > 0.0]))  # a static joint repeats its reading
    return max(1, math.ceil(math.sqrt(2.0) * noise / (VELOCITY_NOISE * log.period)))


def with_window_that_fits(recipe: Recipe, log: MotorLog) -> Recipe:
    """The recipe with windows no longer than the log's longest segment allows, but at least 64 steps."""
    max_rows = max(part.stop - part.start for part in log.segment_slices())
    max_window = max(64, max_rows - recipe.history - 1)
    return (
        replace(recipe, window=min(recipe.window, max_window))
        if recipe.objective == "rollout"
        else recipe
    )


def _by_segment(log: MotorLog, values: Callable[[MotorLog], np.ndarray]) -> np.ndarray:
    """(2, R, M) ``values`` (2, M) of each segment, which are constant in it."""
    return np.concatenate(
        [np.repeat(values(part)[:, None], part.num_rows, axis=1) for part in log.segments()], axis=1
    )


def _gains(log: MotorLog, recipe: Recipe, where: str) -> np.ndarray:
    if not recipe.gain_unit:
        return np.ones((2, log.num_joints))
    gains = log.gains
    if gains is None or log.gain_unit != recipe.gain_unit:
        has = "no logged_kp" if gains is None else f"gains in {log.gain_unit}"
        raise LogError(
            f"{has}; the prior's motors have logged gains [{recipe.gain_unit}]",
            where=where,
            remedy="give kp and kd of every joint in the column map or as options of the import",
        )
    return gains


def relative_conditions(part: MotorLog, nominal: Mapping[str, float]) -> np.ndarray:
    """(2, M) mean supply voltage over the nominal one [-], motor temperature above it [K]; 1 and 0 if missing."""
    supply = np.ones(part.num_joints)
    temperature_rise = np.zeros(part.num_joints)
    logged = {name: means for name, means in part.operating_conditions.items() if name in nominal}
    if "supply_voltage" in logged:
        supply = logged["supply_voltage"] / nominal["supply_voltage"]
    if "motor_temperature" in logged:
        temperature_rise = logged["motor_temperature"] - nominal["motor_temperature"]
    return np.stack([supply, temperature_rise])


def seconds_since_cold(log: MotorLog) -> np.ndarray:
    """(R,) time since the motors were cold [s]: at the start, after a PAUSE, and where the clock restarts."""
    seconds = np.empty_like(log.time)
    start = log.time[0]
    before = log.time[0]
    for part in log.segment_slices():
        first = log.time[part.start]
        start = start if before <= first <= before + PAUSE else first
        seconds[part] = log.time[part] - start
        before = log.time[part.stop - 1]
    return seconds


def _require(log: MotorLog, recipe: Recipe, where: str) -> None:
    wanted = {
        "rollout": ("load_inertia", "external_torque"),
        "torque": ("joint_vel", "joint_torque"),
    }
    for channel in wanted[recipe.objective]:
        if getattr(log, channel) is None:
            raise LogError(
                f"no {channel}, which the {recipe.objective} objective needs",
                where=where,
                remedy="record the loads; or let mp.load_log or `motorprior logs import` compute them (`suspended`, "
                "also for a fixed base); or fit them with mp.with_fitted_loads or `motorprior logs import --fit-load`"
                if recipe.objective == "rollout"
                else "record the channel, or use preset rollout, which learns from positions",
            )
    period = next(log.segments()).period
    if abs(period - recipe.period) > 0.01 * recipe.period:
        raise LogError(
            f"sample period {period:g} s, the recipe's is {recipe.period:g} s",
            where=where,
            remedy=f"load a robot's log with mp.load_log or `motorprior logs import` and period {recipe.period:g}; "
            "record a bench's with the bench preset of the same name",
        )


def window_starts(parts: Sequence[slice], recipe: Recipe, where: str) -> np.ndarray:
    """(S,) first rows of windows inside one of the ``parts``; raises `LogError` if all are shorter than a window."""
    # and the row it leads to
    length = recipe.history + recipe.window + (recipe.objective == "rollout")
    every = np.concatenate([np.arange(part.start, part.stop - length + 1) for part in parts])
    if len(every) == 0:
        max_rows = max(part.stop - part.start for part in parts)
        raise LogError(
            f"its longest segment has {max_rows} rows, a window {length} ({length * recipe.period:g} s)",
            where=where,
            remedy="use more of the log, or record longer segments",
        )
    return every


def _scales(log: MotorLog, where: str) -> dict[str, float]:
    assert log.joint_vel is not None
    scales = {
        "error_scale": np.std(log.position_target - log.joint_pos),
        "velocity_scale": np.std(log.joint_vel),
    }
    scales |= {"torque_scale": 1.0, "torque_limit": 3.0}
    if log.joint_torque is not None:
        limit = 1.2 * np.quantile(np.abs(log.joint_torque), 0.9995)
        scales |= {"torque_scale": np.std(log.joint_torque), "torque_limit": limit}
    for name, value in scales.items():
        if not value > 0:
            remedy = "record with an excitation that moves the motors"
            raise LogError(
                f"{name} is {value}: the channel is constant", where=where, remedy=remedy
            )
    return {name: float(value) for name, value in scales.items()}


def subsampled(data: TrainingData, recipe: Recipe, rows: int) -> TrainingData:
    """About ``rows`` rows of the data, in parts of two to eight windows spread evenly over the long segments."""
    windows = max(2, min(8, (rows // 8 - recipe.history) // recipe.window))
    length = recipe.history + windows * recipe.window + 1
    if sum(part.stop - part.start for part in data.parts) <= rows:
        return data
    starts = [
        first for part in data.parts for first in range(part.start, part.stop - length + 1, length)
    ]
    parts = [slice(first, first + length) for first in starts] or list(data.parts)
    size = parts[0].stop - parts[0].start
    chosen = np.unique(
        np.linspace(0, len(parts) - 1, max(2, min(len(parts), rows // size))).astype(int)
    )
    return replace(data, parts=tuple(parts[index] for index in chosen))


def used_seconds_text(data: TrainingData, recipe: Recipe) -> str:
    """Text with the seconds of log in windows; warm-ups and remainders shorter than a window are not used."""
    total = sum(part.stop - part.start for part in data.parts)
    free = [
        part.stop - part.start - recipe.history - (recipe.objective == "rollout")
        for part in data.parts
    ]
    step = recipe.window if recipe.grey_boxes else 1  # windows then lie end to end
    used = sum(rows // step * step for rows in free if rows >= recipe.window)
    return f"fitted to {used * recipe.period:.1f} s of {total * recipe.period:.1f} s of log"
