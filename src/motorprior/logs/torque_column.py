"""What a torque column measures, by the known load of its joint.

The torque of the motor on a joint with known load is τ = J·q̈ - external torque. A torque from the
motor's current is that in front of rotor and gear friction. The regression

    column(t + lag) = k·(τ + I·q̈ + f·sign q̇ + d·q̇) + zero

tells both apart: I and f are near 0 for the torque on the joint, and k is 1 for a column in N·m.
"""

from dataclasses import dataclass

import numpy as np

from motorprior.logs.motor_log import MotorLog

_SMOOTHING = 0.04  # window of the derivatives [s]
_MAX_LAG = 0.03  # [s]
_SLOW = 0.05  # speed below which friction changes its sign gradually [rad/s]
_MIN_ROWS = 50  # of a segment
MIN_EXPLAINED = 0.7  # share of the column's variance that the load must explain
# A lag that is at least this long is not an error of the regression [s]. Right columns of simulated
# arms, with rows every 2 to 20 ms, have up to 4 ms.
_MIN_LAG = 0.006


@dataclass(frozen=True)
class TorqueColumn:
    """Result of the regression for one joint."""

    factor: float  # k [-]
    lag: float  # [s]; positive: the column is late
    rotor_inertia: float  # I [kg·m²]
    friction: float  # f [N·m]
    explained: float  # share of the column's variance [-]

    @property
    def contradicts_load(self) -> bool:
        """Whether the column has the sign of the load reversed, or is late or early."""
        is_shifted = abs(self.lag) >= _MIN_LAG
        return self.explained >= MIN_EXPLAINED and (self.factor < 0.0 or is_shifted)

    def __str__(self) -> str:
        place = ""
        if self.rotor_inertia > 0.0 or self.friction > 0.0:
            place = (
                f" with a rotor of {max(self.rotor_inertia, 0.0):.2g} kg·m² and "
                f"{max(self.friction, 0.0):.2g} N·m of friction between both"
            )
        lag = ""
        if abs(self.lag) >= 0.004:
            direction = "late" if self.lag > 0.0 else "early"
            lag = f", {1e3 * abs(self.lag):.0f} ms {direction}"
        return f"{self.factor:.3g} times the torque on the joint{place}{lag}"


def torque_column(log: MotorLog, joint: int) -> TorqueColumn | None:
    """Compare a torque column with the known load; None without load, or without motion."""
    from scipy.signal import savgol_filter  # here: it takes long to import

    if log.joint_torque is None or log.load_inertia is None or log.external_torque is None:
        return None
    period = log.period
    window = max(5, 2 * round(0.5 * _SMOOTHING / period) + 1)
    lags = range(-round(_MAX_LAG / period), round(_MAX_LAG / period) + 1)

    segments = []
    for segment in log.segment_slices():
        if segment.stop - segment.start < max(_MIN_ROWS, 3 * window):
            continue
        angle = log.joint_pos[segment, joint]

        def smooth(values: np.ndarray, derivative: int = 0) -> np.ndarray:
            smoothed = savgol_filter(values, window, 3, deriv=derivative, delta=period)
            return np.asarray(smoothed)

        speed = smooth(angle, 1)
        acceleration = smooth(angle, 2)
        inertia = log.load_inertia[segment, joint]
        torque = inertia * acceleration - smooth(log.external_torque[segment, joint])
        ones = np.ones_like(torque)
        terms = np.stack([torque, acceleration, np.tanh(speed / _SLOW), speed, ones], axis=1)
        segments.append((terms, smooth(log.joint_torque[segment, joint])))
    if not segments:
        return None

    best = None
    min_error = np.inf
    edge = max(abs(lags.start), abs(lags.stop), 1) + window
    for lag in lags:
        matrix = np.concatenate([terms[edge:-edge] for terms, _ in segments])
        shifted = [np.roll(column, -lag)[edge:-edge] for _, column in segments]
        column = np.concatenate(shifted)
        solution, *_ = np.linalg.lstsq(matrix, column, rcond=None)
        error = float(np.mean((column - matrix @ solution) ** 2))
        if error < min_error:
            min_error = error
            variance = max(float(np.var(column)), 1e-300)
            best = (solution, lag * period, 1.0 - error / variance)
    if best is None:
        return None
    solution, lag_seconds, explained = best
    factor = float(solution[0])
    if abs(factor) < 1e-9:
        return None
    return TorqueColumn(
        factor=factor,
        lag=lag_seconds,
        rotor_inertia=float(solution[1]) / factor,
        friction=float(solution[2]) / factor,
        explained=explained,
    )
