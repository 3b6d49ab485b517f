"""Inverse kinematics and lever arms of a leg with hip and knee."""

from __future__ import annotations

import math

from motorprior.compiled import njit

_MAX_COSINE = 0.999  # of the knee's angle; beyond it a position is out of reach and the nearest one is taken


@njit(cache=True)
def leg_angles(thigh: float, shank: float, forward: float, below: float, knee_side: float) -> tuple[float, float]:
    """Hip and knee [rad] for a position of the foot in the plane of the leg.

    With hip q₁ and knee q₂ about +y the foot is at forward = -(l₁ sin q₁ + l₂ sin(q₁ + q₂)) and
    below = l₁ cos q₁ + l₂ cos(q₁ + q₂). The law of cosines gives q₂, then q₁ is the angle between the foot and
    (l₁ + l₂ cos q₂, l₂ sin q₂). A position out of reach is replaced by the nearest.

    Args:
        thigh: l₁ [m].
        shank: l₂ [m].
        forward: of the foot's centre, from the hip axis [m].
        below: of the foot's centre, from the hip axis [m].
        knee_side: sign of the knee's angle: -1 bends it backward.
    """
    cosine = (forward * forward + below * below - thigh * thigh - shank * shank) / (2.0 * thigh * shank)
    knee = knee_side * math.acos(min(_MAX_COSINE, max(-_MAX_COSINE, cosine)))
    along, across = thigh + shank * math.cos(knee), shank * math.sin(knee)
    hip = math.atan2(-forward * along - below * across, below * along - forward * across)
    return hip, knee


@njit(cache=True)
def lever_arms(thigh: float, shank: float, hip: float, knee: float) -> tuple[float, float]:
    """∂below/∂hip and ∂below/∂knee [m]: a vertical force F on the foot needs F times these torques at the joints.

    -(l₁ sin q₁ + l₂ sin(q₁ + q₂)) and -l₂ sin(q₁ + q₂), see `leg_angles`.
    """
    by_knee = -shank * math.sin(hip + knee)
    return by_knee - thigh * math.sin(hip), by_knee
