"""A trot, shaped by four numbers that the policy modulates.

Policies Modulating Trajectory Generators: Iscen et al., CoRL 2018, section 3; the amplitudes are those of
jietan/puppersim (Apache-2.0), restated for a robot that walks towards +x with hip and knee about +y.
A leg with hip q₁ and knee q₂ has its foot at x = -(l₁ sin q₁ + l₂ sin(q₁+q₂)) and
z = -(l₁ cos q₁ + l₂ cos(q₁+q₂)) from the hip, so a growing hip angle carries the foot backwards: that is
stance, while the body goes forward.
"""

from __future__ import annotations

import math

import numpy as np

from motorprior.compiled import njit
from motorprior.locomotion.body import Body


@njit(cache=True)
def advance_phase(phase: float, frequency: float, control_dt: float) -> float:
    """Phase of the gait one control step later: (phase + frequency · control_dt) mod 1.

    Args:
        phase: gait phase in [0, 1).
        frequency: steps per leg and second [Hz], not negative.
        control_dt: control period [s].
    """
    advanced = phase + frequency * control_dt
    return advanced - math.floor(advanced)


@njit(cache=True)
def warp_phase(leg_phase: float, swing_stance_ratio: float) -> float:
    """Angle φ [rad] of one leg: stance is 0..π, swing is π..2π.

    Stance takes the share s = 1 / (1 + ratio) of the cycle: φ = π u / s for u < s, then
    φ = π + π (u - s) / (1 - s).
    The ratio is time in swing over time in stance; puppersim's number is the ratio of *speeds*, its inverse.

    Args:
        leg_phase: u, phase of this leg in [0, 1).
        swing_stance_ratio: time in swing over time in stance, > 0.
    """
    stance_share = 1.0 / (1.0 + swing_stance_ratio)
    if leg_phase < stance_share:
        return math.pi * leg_phase / stance_share
    return math.pi + math.pi * (leg_phase - stance_share) / (1.0 - stance_share)


@njit(cache=True)
def joint_targets(
    body: Body, phase: float, intensity: float, height: float, swing_stance_ratio: float, out: np.ndarray
) -> None:
    """Joint angles of a trot, each leg at its own phase of the cycle.

    swing = I · body.swing · cos φ, extend = h + I · A · sin φ, A = stance_extension in stance and lift_extension in
    swing, where sin φ < 0; hip = nominal - swing - extend / 2, knee = nominal + extend, every other joint nominal.

    Args:
        body: of the robot.
        phase: gait phase in [0, 1); 0 is where legs of phase 0 touch down.
        intensity: I, 0 stands still, 1 is the full stride.
        height: h [rad], added to the knee; positive stretches the legs.
        swing_stance_ratio: time in swing over time in stance, > 0.
        out: shape (joints,) [rad], overwritten.
    """
    out[:] = body.nominal_pose
    for leg in range(body.phases.shape[0]):
        ahead, hip, knee = body.phases[leg], body.legs[leg, 1], body.legs[leg, 2]
        leg_phase = phase + ahead if phase < 1.0 - ahead else phase - (1.0 - ahead)
        angle = warp_phase(leg_phase, swing_stance_ratio)
        amplitude = body.stance_extension if angle < math.pi else body.lift_extension
        swing = intensity * body.swing * math.cos(angle)
        extend = height + intensity * amplitude * math.sin(angle)
        out[hip] = body.nominal_pose[hip] - swing - 0.5 * extend
        out[knee] = body.nominal_pose[knee] + extend


def open_loop_trot(
    body: Body,
    steps: int,
    frequency: float,
    intensity: float,
    height: float,
    swing_stance_ratio: float,
    control_dt: float,
) -> np.ndarray:
    """(steps, joints) angles [rad] of a trot without modulation, from phase 0; see `joint_targets`."""
    targets, phase = np.zeros((steps, len(body.nominal_pose))), 0.0
    for row in targets:
        joint_targets(body, phase, intensity, height, swing_stance_ratio, row)
        phase = advance_phase(phase, frequency, control_dt)
    return targets
