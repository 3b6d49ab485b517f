"""Models of the closed loop that need neither torque nor inertia: from the command to the motion of one joint.

    pure_delay     q(t) = u(t - delay)
    second_order   q̈ = rate²·(u(t - delay) + offset - q) - 2·damping·rate·q̇
    servo_limits   e = gain·u(t - delay) + offset + compliance·τ + sine·sin q + cosine·cos q - q
                   q̈ = rate²·(e less the dead band) - 2·damping·rate·q̇,   |q̈| <= acceleration,  |q̇| <= speed

u [rad] is the command, linear in time between two rows. "e less the dead band" is sign(e)·max(0, |e| - band). τ [N·m]
is the log's external torque; ``compliance`` [rad/(N·m)] is that of a proportional law. If a log has no load, ``sine``
and ``cosine`` [rad] of the joint's own angle replace it. The models hold for these gains and this load only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motorprior.compiled import njit
from motorprior.identification.physics.window_runs import WindowRuns
from motorprior.identification.training_data.windows import EXTERNAL, POS, STIFFNESS, TARGET, VEL

INFINITE_RATE = 1e9  # rate from which the joint follows without lag
# constants in SI units with their neutral values
CONSTANTS = {
    "delay": 0.0, "rate": INFINITE_RATE, "damping": 1.0, "speed": 1e9, "acceleration": 1e12, "band": 0.0, "gain": 1.0,
    "offset": 0.0, "compliance": 0.0, "sine": 0.0, "cosine": 0.0,
}  # fmt: skip
# constants of each model; servo_limits also has those of one of GRAVITY
MODELS = {
    "pure_delay": ("delay",),
    "second_order": ("delay", "rate", "damping", "offset"),
    "servo_limits": ("delay", "rate", "damping", "speed", "acceleration", "band", "gain", "offset"),
}
# model of gravity: by the log's external torque, or by the joint's angle
GRAVITY = {"torque": ("compliance",), "angle": ("sine", "cosine")}


@njit(cache=True, nogil=True)
def _respond(target, external, starts, pos, vel, constants, dt, out):
    """Fill out (runs, steps) with one joint's angles [rad] at the end of every step.

    target [rad] and external [N·m] are (rows,); runs start at rows ``starts`` (runs,) from ``pos`` [rad] and ``vel``,
    half a period before [rad/s]; constants are in the order of CONSTANTS, dt [s].
    """
    delay, rate, damping, speed, acceleration, band, gain, offset, compliance, sine, cosine = constants
    late, at_once, turned = delay / dt, rate >= INFINITE_RATE, sine != 0.0 or cosine != 0.0
    for run in range(out.shape[0]):
        q, dq = pos[run], vel[run]
        for step in range(out.shape[1]):
            row = starts[run] + step
            age = max(0.0, row + at_once - late)  # without lag, the end of the step has the command of that time
            before = min(int(age), target.shape[0] - 2)
            command = target[before] + (age - before) * (target[before + 1] - target[before])
            aim = gain * command + offset + compliance * external[row]
            if turned:
                aim += sine * np.sin(q) + cosine * np.cos(q)
            if at_once:
                q = aim
            else:
                missing = max(0.0, abs(aim - q) - band)
                push = rate * rate * (missing if aim > q else -missing)
                change = (dq + dt * push) / (1.0 + 2.0 * damping * rate * dt) - dq  # damping implicit: always stable
                change = min(dt * acceleration, max(-dt * acceleration, change))
                dq = min(speed, max(-speed, dq + change))
                q += dt * dq
            out[run, step] = q


@dataclass(frozen=True)
class ResponseMotors:
    """One response model per joint."""

    name: str  # of MODELS
    constants: np.ndarray  # (M, constants) in the order of CONSTANTS

    def errors(self, runs: WindowRuns) -> np.ndarray:
        """(M, N, W) simulated minus recorded angles [rad] of the same free runs as for other models."""
        joints = zip(range(runs.num_motors), self.constants, strict=True)
        return np.stack([JointRuns(runs, joint).errors(constants) for joint, constants in joints])


class JointRuns:
    """Free runs of one joint of a log."""

    def __init__(self, runs: WindowRuns, joint: int):
        first, self._window, self._dt, self._segments = runs.preset.history, runs.preset.window, runs.preset.period, []
        for segment in runs.segments:
            target, rest, stiffness, pos, vel = (
                np.ascontiguousarray(segment.rows[:, channel, joint])
                for channel in (TARGET, EXTERNAL, STIFFNESS, POS, VEL)
            )
            external = rest + stiffness * pos
            starts = first + self._window * np.arange(segment.windows)
            recorded = pos[first + 1 : first + 1 + segment.windows * self._window].reshape(-1, self._window)
            self._segments.append((target, external, starts, pos[starts], vel[starts], recorded))

    def errors(self, constants: np.ndarray) -> np.ndarray:
        """(N, W) simulated minus recorded angles [rad] with these ``constants``."""
        found = []
        for target, external, starts, pos, vel, recorded in self._segments:
            simulated = np.empty(recorded.shape)
            _respond(target, external, starts, pos, vel, constants, self._dt, simulated)
            found.append(simulated - recorded)
        return np.concatenate(found)
