"""Checks of commands: a rate below the sender's, a feed-forward torque that is none, torque off."""

from collections.abc import Iterator

import numpy as np

from motorprior.logs.command_modes import commands_angles, gain_factors, gains_change
from motorprior.logs.doctor.findings import IN_MAP, Finding
from motorprior.logs.motor_log import MotorLog
from motorprior.logs.operations import excited_joints, with_velocities
from motorprior.signals import rms, runs_of_true

MIN_CHANGES = 10  # minimum number of changes of a command that `command_rate` checks
MIN_HELD_ROWS = 3  # median number of rows between changes of a command that is logged slowly
MAX_DELAY = 0.08  # maximum delay of a command that `command_rate` tries [s]
# share of the unexplained acceleration that straight lines between commands must leave
MAX_REMAINING = 0.7
# minimum ratio of a step to the changes of the command before and after it
MIN_STEP_RATIO = 3.0
FULL_FRICTION_SPEED = 0.1  # [rad/s]
MIN_LAW_SHARE = 0.98  # share of a feed-forward torque that the control law explains
BLOCK = 0.5  # duration of the blocks of `torque_off` [s]
MIN_BLOCKS = 3
MIN_ERROR = 0.15  # minimum error of a joint whose torque is off [rad]
ERROR_RATIO = 6.0  # minimum error of such a block over the lower quartile of all blocks
MAX_CROSSING = 4  # blocks in which the command may cross the angle of a joint without torque
MIN_FALL = 0.4  # share of that error at which a joint that falls slowly counts as without torque
ACCELERATION_TIME = 0.02  # over which `torque_off` takes accelerations [s]
# share of the unexplained acceleration that commands must leave if the torque is on
MAX_PASSIVE = 0.8
MIN_CORRELATION = 0.5  # minimum correlation of an angle with its command if the torque is on


def command_rate(window: MotorLog) -> Iterator[Finding]:
    """Commands that change every few rows, while the angle answers a line between them.

    Both commands, held and linear between their changes, explain the acceleration of the angle by
    linear regression,

        q̈ = a·command(t - delay) - k·q - b·q̇ - c·sign q̇ + d·sin q + e·cos q + f.

    In MIT mode there is a term of each command. Gains that change are factors of the terms.
    """
    commands = list(_commands(window).values())
    if not commands:
        return
    held = np.stack([command for command, _ in commands], axis=1)
    factors = np.stack([factor for _, factor in commands], axis=1)
    held_rows = float(np.median(np.diff(np.flatnonzero(np.diff(held[:, 0])))))
    if held_rows < MIN_HELD_ROWS:
        return

    rows = round(held_rows)
    linear = np.stack([_lines(column, rows) for column in held.T], axis=1)
    # the true time of a step is unknown by the time between commands
    near_step = np.ones(1 + 4 * rows)
    is_far = ~np.any([np.convolve(_steps(x), near_step, "same") > 0.0 for x in held.T], axis=0)
    if np.count_nonzero(is_far) < MIN_CHANGES * rows:
        return

    half_width = max(1, int(held_rows // 4))
    held_error, _ = explained_by(window, factors * held, half_width, is_far)
    linear_error, _ = explained_by(window, factors * linear, half_width, is_far)
    if not linear_error < MAX_REMAINING * held_error:
        return
    joint = window.joint_names[0]
    milliseconds = 1e3 * held_rows * window.period
    message = (
        f"the command of {joint} changes every {milliseconds:.3g} ms, but the angle follows a "
        f"line between the commands: {100 * linear_error:.0f} % of its acceleration is unexplained "
        f"by the line, {100 * held_error:.0f} % by held commands"
    )
    remedy = (
        "commands were sent between the logged ones: log every command that is sent; the constants "
        "of this joint are not identifiable"
    )
    yield Finding("warning", "command_rate", milliseconds, message, remedy, joint)


def _lines(command: np.ndarray, held_rows: int) -> np.ndarray:
    """(T,) lines to each change of a command, over the ``held_rows`` rows before it."""
    rows = 1 + np.flatnonzero(np.diff(command))
    # a command that was constant for longer begins to change later
    starts = np.maximum(rows - held_rows, np.append(0, rows[:-1]))
    knots = np.column_stack([starts, rows]).ravel()
    values = np.column_stack([command[rows - 1], command[rows]]).ravel()
    return np.interp(np.arange(len(command)), knots, values)


def _steps(command: np.ndarray) -> np.ndarray:
    """(T,) whether a command changes by MIN_STEP_RATIO times more than before and after."""
    rows = 1 + np.flatnonzero(np.diff(command))
    size = np.abs(command[rows] - command[rows - 1])
    around = np.maximum(np.append(0.0, size[:-1]), np.append(size[1:], 0.0))
    is_step = np.zeros(len(command), dtype=bool)
    is_step[rows] = size > MIN_STEP_RATIO * around
    return is_step


def _commands(window: MotorLog) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Commands (T,) of one joint that change, each with the factors (T,) of its gain in force.

    The main command of the mode is first.
    """
    kp, kd = gain_factors(window)[..., 0]
    factors = {"velocity_target": kd, "torque_feedforward": np.ones_like(kp)}
    if commands_angles(window)[0]:
        factors = {"position_target": kp} | factors

    commands = {}
    for name, factor in factors.items():
        channel = getattr(window, name)
        if channel is not None and np.count_nonzero(np.diff(channel[:, 0])) >= MIN_CHANGES:
            commands[name] = (channel[:, 0], factor)
    return commands


def commands_of(window: MotorLog) -> tuple[list[str], np.ndarray]:
    """Names and values (T, C) of the commands of one joint that change, at their gains in force."""
    commands = _commands(window)
    values = [command * factor for command, factor in commands.values()]
    return list(commands), np.reshape(values, (len(values), window.num_rows)).T


def explained_by(
    window: MotorLog, commands: np.ndarray, half_width: int, rows: np.ndarray | None = None
) -> tuple[float, np.ndarray]:
    """Regression of the acceleration on commands (T, C), see `command_rate`.

    Returns the share of its variance that is unexplained [-], and the coefficients (C,) of the
    commands. Only ``rows`` (T,), a mask, count.

    The acceleration is a second difference over ``half_width`` rows, which is a triangular mean of
    the acceleration; the other terms have the same mean.
    """
    angle = window.joint_pos[:, 0]
    rising = np.arange(1, half_width + 1)
    triangle = np.concatenate([rising, rising[-2::-1]]) / half_width**2

    def mean(values: np.ndarray) -> np.ndarray:
        return np.convolve(values, triangle, "same")

    before = np.roll(angle, half_width)
    after = np.roll(angle, -half_width)
    acceleration = (after - 2.0 * angle + before) / (half_width * window.period) ** 2
    velocity = mean(np.gradient(angle, window.period))
    friction = np.tanh(velocity / FULL_FRICTION_SPEED)
    motion = [mean(angle), velocity, friction, np.sin(angle), np.cos(angle), np.ones_like(angle)]
    if gains_change(window):
        kp, kd = gain_factors(window)[..., 0]
        motion += [mean(kp * angle), mean(kd) * velocity]
    inside = np.ones(len(angle), dtype=bool) if rows is None else rows.copy()
    inside[: 3 * half_width] = False
    inside[-3 * half_width :] = False
    variance = np.var(acceleration[inside])

    fits = []
    for delay in range(max(1, min(int(MAX_DELAY / window.period), len(angle) // 2))):
        first = np.repeat(commands[:1], delay, axis=0)
        delayed = np.concatenate([first, commands[: len(commands) - delay]])
        table = np.column_stack([*map(mean, delayed.T), *motion])[inside]
        coefficients = np.linalg.lstsq(table, acceleration[inside], rcond=None)[0]
        error = float(np.mean((acceleration[inside] - table @ coefficients) ** 2))
        fits.append((error, coefficients[: commands.shape[1]]))
    error, coefficients = min(fits, key=lambda fit: fit[0])
    return error / max(variance, 1e-300), coefficients


def whole_torque(log: MotorLog) -> Iterator[Finding]:
    """Feed-forward torques that are the torque of the control law, kp·error + kd·velocity error."""
    if log.torque_feedforward is None or log.command_mode != "mit":
        return
    velocity = with_velocities(log).joint_vel
    assert velocity is not None
    for column, joint in enumerate(log.joint_names):
        feedforward = log.torque_feedforward[:, column]
        error = log.position_target[:, column] - log.joint_pos[:, column]
        variance = np.var(feedforward)
        if variance < 1e-12:
            continue
        table = np.column_stack([error, velocity[:, column], np.ones_like(error)])
        coefficients = np.linalg.lstsq(table, feedforward, rcond=None)[0]
        share = 1.0 - np.var(feedforward - table @ coefficients) / variance
        kp = coefficients[0]
        negative_kd = coefficients[1]
        if share < MIN_LAW_SHARE or kp <= 0.0:
            continue
        message = (
            f"torque_feedforward/{joint} is {kp:.3g}·(position_target - joint_pos) "
            f"{negative_kd:+.3g}·joint_vel: the torque of the control law, not a feed-forward"
        )
        remedy = f"leave torque_feedforward out {IN_MAP}"
        yield Finding("error", "feedforward", float(share), message, remedy, joint)


def torque_off(log: MotorLog) -> Iterator[Finding]:
    """Joints that stop following their command for seconds, as after an overload."""
    rows = max(2, round(BLOCK / log.period))
    for column in np.intersect1d(excited_joints(log), np.flatnonzero(commands_angles(log))):
        error = log.joint_pos[:, column] - log.position_target[:, column]
        num_blocks = len(error) // rows
        if num_blocks < 2 * MIN_BLOCKS:
            continue
        blocks = rms(error[: num_blocks * rows].reshape(num_blocks, rows), axis=1)
        limit = max(MIN_ERROR, ERROR_RATIO * float(np.quantile(blocks, 0.25)))
        is_far = blocks > limit
        for first, after in runs_of_true(~is_far).tolist():
            if first and after < num_blocks and after - first <= MAX_CROSSING:
                is_far[first:after] = True
        for first, after in runs_of_true(is_far).tolist():
            while first and blocks[first - 1] > MIN_FALL * limit:
                first -= 1
            stretch = slice(first * rows, after * rows)
            if after - first < MIN_BLOCKS or _follows(log, column, stretch):
                continue
            row = stretch.start
            seconds = (after - first) * BLOCK
            joint = log.joint_names[column]
            message = (
                f"{joint} does not follow its command from row {row} on ({log.time[row]:.4g} s), "
                f"for {seconds:.3g} s: is its torque off?"
            )
            remedy = "delete these rows, or record again"
            yield Finding("warning", "torque_off", seconds, message, remedy, joint, row)


def _follows(log: MotorLog, column: int, stretch: slice) -> bool:
    """Whether the angle correlates with its command, at the best delay up to 0.25 s.

    In MIT mode, commands that explain the acceleration count, too: gains may be small.
    """
    if log.command_mode == "mit":
        window = log.joint(column).rows(stretch)
        _, commands = commands_of(window)
        half_width = max(1, round(ACCELERATION_TIME / window.period))
        passive_error, _ = explained_by(window, commands[:, :0], half_width)
        error, _ = explained_by(window, commands, half_width)
        if error < MAX_PASSIVE * passive_error:
            return True

    command = log.position_target[stretch, column]
    angle = log.joint_pos[stretch, column]
    best = 0.0
    for delay in range(0, max(1, min(int(0.25 / log.period), len(angle) // 2))):
        motion = angle[delay:] - angle[delay:].mean()
        commanded = command[: len(command) - delay]
        commanded = commanded - commanded.mean()
        norm = np.sqrt((motion @ motion) * (commanded @ commanded))
        best = max(best, float(motion @ commanded) / max(norm, 1e-300))
    return best >= MIN_CORRELATION


CHECKS = (whole_torque, torque_off)
