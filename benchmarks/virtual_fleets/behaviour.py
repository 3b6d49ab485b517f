"""Behaviour features of motors on a standard bench, the same for physical and learned motors.

Every trial runs on the virtual dynamometer (`dynamometer.run`) with the sample period PERIOD. By
default the load is LOAD_INERTIA with an external torque of -PRELOAD, which presses the gear to one
side: motion within the backlash is chaotic, so models could not be compared.

A motor that fails a trial gets the limit value of that trial, never NaN. Values are rounded to
RESOLUTION, that of a good physical bench, so that a two-sample test does not separate an overshoot
of 0 from one of 0.0003.
"""

import numpy as np

from motorprior.actuator.actuator import Actuator
from motorprior.bench.dynamometer import Response, response_of_all

PERIOD = 0.002  # sample period of all trials [s]
# inertia of a leg, and of one that carries the robot [kg·m²]
LOAD_INERTIA = 0.003
HEAVY_INERTIA = 0.03
PRELOAD = 0.05  # torque that presses the gear to one side, below the friction of most motors [N·m]
# of sines [Hz], [rad]; SINE_WINDOW contains whole cycles
FREQUENCIES = (1, 2, 4, 8)
AMPLITUDE = 0.15
# time of a sine before and in the evaluation [s]
SINE_SETTLE = 1.0
SINE_WINDOW = 1.0
UNMOVED_GAIN = 1e-3  # gain below which the phase is undefined [-]
# height of the step [rad], time before and after it [s]
STEP = 0.3
STEP_SETTLE = 0.3
STEP_DURATION = 1.2
STEP_FINAL = 0.1  # final displacement: mean over this time at the end of a step [s]
# triangular target: speed [rad/s], amplitude [rad], evaluated at |target| < CREEP_WINDOW [rad]
CREEP_SPEED = 0.04
CREEP_REACH = 0.2
CREEP_WINDOW = 0.03
BREAKAWAY_ANGLE = 0.01  # displacement that counts as breakaway [rad]
# torque ramp: time before [s], slope [N·m/s], end [N·m]
RAMP_SETTLE = 0.5
RAMP_RATE = 0.2
RAMP_TOP = 1.5
# position error [rad], inertia that blocks the joint [kg·m²]
STALL_ERROR = 0.6
STALL_INERTIA = 1e5
# times of motion, of holding, and of the evaluation [s]
STALL_LEAD = 1.5
STALL_HOLD = 0.3
STALL_FINAL = 0.1
# peak speed: height of the step [rad], inertia of a nearly bare joint [kg·m²], time after the step,
# averaging time [s]
FAST_STEP = 1.2
FAST_INERTIA = 3e-4
FAST_DURATION = 0.8
SPEED_WINDOW = 0.02
# values are rounded to these, in the unit of the feature
RESOLUTION = {
    "gain": 1e-3, "lag": 2e-4, "rise time": 1e-3, "overshoot": 5e-3,
    "dead band": 2e-4, "breakaway": 2e-3, "stall torque": 2e-3, "peak speed": 0.02,
}  # fmt: skip


def behaviours(actuator: Actuator) -> np.ndarray:
    """(n, F) features of n motors, finite multiples of RESOLUTION.

    The functions below state formulas and units. The features are gains and lags at FREQUENCIES,
    rise time, overshoot, dead band, breakaway, stall torque, peak speed. Deterministic; 52 s of
    bench time, 1 to 4 s for 256 physical motors.
    """
    gains, lags = zip(
        *(frequency_response(actuator, frequency) for frequency in FREQUENCIES), strict=True
    )
    features = {
        "gain": gains,
        "lag": lags,
        "rise time": [rise_time(actuator)],
        "overshoot": [overshoot(actuator)],
        "dead band": [dead_band(actuator)],
        "breakaway": [breakaway(actuator)],
        "stall torque": [stall_torque(actuator)],
        "peak speed": [peak_speed(actuator)],
    }
    columns = []
    for name, group in features.items():
        for values in group:
            columns.append(np.round(values / RESOLUTION[name]) * RESOLUTION[name])
    return np.stack(columns, axis=1)


def _count(duration: float) -> int:
    return round(duration / PERIOD)


def respond(
    actuator: Actuator,
    target: np.ndarray,
    inertia: float = LOAD_INERTIA,
    external: np.ndarray | float = -PRELOAD,
) -> Response:
    """Response of all motors to one target (steps,) [rad] and one external torque [N·m].

    The torque is (steps,) or constant.
    """
    return response_of_all(actuator, target, inertia, external, PERIOD)


def frequency_response(actuator: Actuator, frequency: float) -> tuple[np.ndarray, np.ndarray]:
    """Gain [-] and lag [s] at ``frequency`` [Hz], both (n,).

    joint_pos = c + a·sin(ωt) + b·cos(ωt) by least squares over whole cycles, after SINE_SETTLE;
    gain = √(a² + b²) / AMPLITUDE, lag = atan2(-b, a) / ω in [-1/4, 3/4) of a cycle. A joint that
    does not move (gain below UNMOVED_GAIN) gets the maximum lag, 3/4 of a cycle.
    """
    settled = _count(SINE_SETTLE)
    angle = 2 * np.pi * frequency * (np.arange(_count(SINE_SETTLE + SINE_WINDOW)) * PERIOD)
    joint_pos = respond(actuator, AMPLITUDE * np.sin(angle)).joint_pos[settled:]
    late = angle[settled:]
    basis = np.stack([np.ones_like(late), np.sin(late), np.cos(late)], axis=1)
    _, a, b = np.linalg.lstsq(basis, joint_pos, rcond=None)[0]
    gain = np.hypot(a, b) / AMPLITUDE
    cycle = np.mod(np.arctan2(-b, a) / (2 * np.pi) + 0.25, 1.0) - 0.25
    return gain, np.where(gain < UNMOVED_GAIN, 0.75, cycle) / frequency


def _step(
    actuator: Actuator, inertia: float, low: float, high: float, duration: float
) -> np.ndarray:
    """(steps, n) joint_pos [rad] in a step of the target from low to high [rad].

    It begins with the last sample before the step, and lasts ``duration`` [s].
    """
    rows_before_step = _count(STEP_SETTLE)
    target = np.full(rows_before_step + _count(duration), high)
    target[:rows_before_step] = low
    return respond(actuator, target, inertia).joint_pos[rows_before_step:]


def rise_time(actuator: Actuator) -> np.ndarray:
    """(n,) time between the first crossings of 10 % and 90 % of the final displacement [s].

    It is interpolated between samples. It is STEP_DURATION if the final displacement is below 10 %
    of STEP.
    """
    joint_pos = _step(actuator, LOAD_INERTIA, 0.0, STEP, STEP_DURATION)
    moved = joint_pos[-_count(STEP_FINAL) :].mean(axis=0) - joint_pos[0]
    responded = moved > 0.1 * STEP
    progress = (joint_pos - joint_pos[0]) / np.where(responded, moved, 1.0)
    return np.where(
        responded, _crossing_time(progress, 0.9) - _crossing_time(progress, 0.1), STEP_DURATION
    )


def overshoot(actuator: Actuator) -> np.ndarray:
    """(n,) overshoot over STEP [-], at least 0.

    It is the maximum joint_pos before the last STEP_FINAL minus the mean over the last STEP_FINAL.
    """
    joint_pos = _step(actuator, HEAVY_INERTIA, 0.0, STEP, STEP_DURATION)
    late = _count(STEP_FINAL)
    return np.maximum(joint_pos[:-late].max(axis=0) - joint_pos[-late:].mean(axis=0), 0.0) / STEP


def _crossing_time(signal: np.ndarray, level: float) -> np.ndarray:
    """(n,) time at which ``signal`` (steps, n) first reaches ``level`` [s].

    The duration of the signal if it never does.
    """
    reached = signal >= level
    index = np.argmax(reached, axis=0)
    motors = np.arange(signal.shape[1])
    above = signal[index, motors]
    below = signal[np.maximum(index - 1, 0), motors]
    back = np.where(
        above > below, (above - level) / np.where(above > below, above - below, 1.0), 0.0
    )
    return np.where(reached.any(axis=0), index - back, len(signal)) * PERIOD


def dead_band(actuator: Actuator) -> np.ndarray:
    """(n,) half-width of the position hysteresis [rad].

    The target moves from -CREEP_REACH to +CREEP_REACH and back against an external torque of
    -PRELOAD·sign(target velocity), so the joint lags by friction/kp + PRELOAD/kp + half the
    backlash. The feature is (mean joint_pos on the way down - mean on the way up)/2 for |target| <
    CREEP_WINDOW, at most CREEP_REACH, which is also the value of a joint that moves less than
    CREEP_WINDOW.
    """
    leg = _count(2 * CREEP_REACH / CREEP_SPEED)
    up = np.linspace(-CREEP_REACH, CREEP_REACH, leg)
    target = np.concatenate([up, up[::-1]])
    brake = np.repeat([-PRELOAD, PRELOAD], leg)
    joint_pos = respond(actuator, target, external=brake).joint_pos
    read = np.abs(up) < CREEP_WINDOW
    half = 0.5 * (joint_pos[leg:][read].mean(axis=0) - joint_pos[:leg][read].mean(axis=0))
    follows = np.ptp(joint_pos, axis=0) >= CREEP_WINDOW
    return np.where(follows, np.clip(half, -CREEP_REACH, CREEP_REACH), CREEP_REACH)


def breakaway(actuator: Actuator) -> np.ndarray:
    """(n,) external torque that moves a joint with target 0 by BREAKAWAY_ANGLE [N·m].

    It is the mean of both directions. After RAMP_SETTLE under PRELOAD, which takes up the backlash,
    the external torque rises from PRELOAD to RAMP_TOP at RAMP_RATE. For a stiff gear the feature is
    (coulomb + stribeck_torque + kp·BREAKAWAY_ANGLE) / (1 - load_friction). A joint that does not
    move by BREAKAWAY_ANGLE gets RAMP_TOP.
    """
    still = _count(RAMP_SETTLE)
    read = []
    external = np.concatenate(
        [np.full(still, PRELOAD), np.arange(PRELOAD, RAMP_TOP, RAMP_RATE * PERIOD)]
    )
    for sign in (1.0, -1.0):
        joint_pos = respond(actuator, np.zeros(len(external)), external=sign * external).joint_pos[
            still:
        ]
        read.append(
            PRELOAD + RAMP_RATE * _crossing_time(sign * (joint_pos - joint_pos[0]), BREAKAWAY_ANGLE)
        )
    return np.minimum(np.mean(read, axis=0), RAMP_TOP)


def stall_torque(actuator: Actuator) -> np.ndarray:
    """(n,) mean joint_torque of the last STALL_FINAL on a joint blocked by STALL_INERTIA [N·m].

    The target moves to STALL_ERROR within STALL_LEAD and stays there, since a step would wind up
    the gear. For a physical motor the feature is (torque_limit - coulomb - stribeck_torque) / (1 +
    load_friction).
    """
    lead = np.linspace(0.0, STALL_ERROR, _count(STALL_LEAD))
    target = np.concatenate([lead, np.full(_count(STALL_HOLD), STALL_ERROR)])
    return (
        respond(actuator, target, STALL_INERTIA, 0.0)
        .joint_torque[-_count(STALL_FINAL) :]
        .mean(axis=0)
    )


def peak_speed(actuator: Actuator) -> np.ndarray:
    """(n,) maximum mean speed over SPEED_WINDOW [rad/s] in a step from -FAST_STEP/2 to FAST_STEP/2.

    The mean over a window excludes the speeds of a light joint that bounces in its backlash.
    """
    width = _count(SPEED_WINDOW)
    joint_pos = _step(actuator, FAST_INERTIA, -0.5 * FAST_STEP, 0.5 * FAST_STEP, FAST_DURATION)
    return (joint_pos[width:] - joint_pos[:-width]).max(axis=0) / SPEED_WINDOW
