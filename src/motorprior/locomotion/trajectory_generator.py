"""A trot for four legs, shaped by four numbers that the policy modulates.

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
from motorprior.robots.pupper_v2.spec import NOMINAL_POSE

SWING_AMPLITUDE = 0.5  # [rad] of the hip at intensity 1
STANCE_EXTENSION = -0.02  # [rad] of the knee at intensity 1: the leg yields a little under load
LIFT_EXTENSION = 0.9  # [rad] of the knee at intensity 1, times sin φ < 0: the leg folds in swing
NOMINAL_HIP = float(NOMINAL_POSE[1])
NOMINAL_KNEE = float(NOMINAL_POSE[2])


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
def joint_targets(phase: float, intensity: float, height: float, swing_stance_ratio: float, out: np.ndarray) -> None:
    """Joint angles of a trot, legs FR and RL half a cycle apart from FL and RR.

    swing = I · 0.5 · cos φ, extend = h + I · A · sin φ, A = -0.02 in stance and 0.9 in swing;
    abduction = 0, hip = 0.6 - swing - extend / 2, knee = -1.2 + extend.

    Args:
        phase: gait phase in [0, 1); 0 is where FR and RL touch down.
        intensity: I, 0 stands still, 1 is the full stride.
        height: h [rad], added to the knee; positive stretches the legs.
        swing_stance_ratio: time in swing over time in stance, > 0.
        out: shape (12,) [rad], FR FL RR RL × (abduction, hip, knee), overwritten.
    """
    for leg in range(4):
        leg_phase = phase
        if leg == 1 or leg == 2:
            leg_phase = phase + 0.5 if phase < 0.5 else phase - 0.5
        angle = warp_phase(leg_phase, swing_stance_ratio)
        amplitude = STANCE_EXTENSION if angle < math.pi else LIFT_EXTENSION
        swing = intensity * SWING_AMPLITUDE * math.cos(angle)
        extend = height + intensity * amplitude * math.sin(angle)
        out[3 * leg] = 0.0
        out[3 * leg + 1] = NOMINAL_HIP - swing - 0.5 * extend
        out[3 * leg + 2] = NOMINAL_KNEE + extend


def open_loop_trot(
    steps: int, frequency: float, intensity: float, height: float, swing_stance_ratio: float, control_dt: float
) -> np.ndarray:
    """(steps, 12) joint angles [rad] of a trot that nobody modulates, from phase 0; see `joint_targets`."""
    targets, phase = np.zeros((steps, len(NOMINAL_POSE))), 0.0
    for row in targets:
        joint_targets(phase, intensity, height, swing_stance_ratio, row)
        phase = advance_phase(phase, frequency, control_dt)
    return targets
