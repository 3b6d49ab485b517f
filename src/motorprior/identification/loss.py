"""The rollout loss: what simulated positions, velocities and torques cost, for compiled code and for JAX."""

from __future__ import annotations

from typing import Any

POSITION_SCALE = 0.01  # Position error at which the rollout loss turns from quadratic to linear [rad]
VELOCITY_SCALE = 0.3  # Velocity error at which the rollout loss turns from quadratic to linear [rad/s]
TORQUE_SCALE = 0.3  # Torque error at which the rollout loss turns from quadratic to linear [N·m]
SCALES = (POSITION_SCALE, VELOCITY_SCALE, TORQUE_SCALE)


def huber(x: Any) -> Any:
    """Pseudo-Huber loss √(1 + x²) - 1: linear for large |x|, so that one diverged window does not dominate a batch."""
    return (1.0 + x * x) ** 0.5 - 1.0


def huber_weight(x: Any) -> Any:
    """Derivative of `huber` over x, (1 + x²)^(-1/2)."""
    return (1.0 + x * x) ** -0.5


def huber_curvature(x: Any) -> Any:
    """Second derivative of `huber`, (1 + x²)^(-3/2)."""
    return (1.0 + x * x) ** -1.5
