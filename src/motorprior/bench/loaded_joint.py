"""One joint with a known load: the formula of its step, for compiled code and for JAX."""

from __future__ import annotations

from typing import Any


def next_velocity(dq: Any, torque: Any, external: Any, inertia: Any, damping: Any, dt: Any) -> Any:
    """Joint velocity [rad/s] after a step of semi-implicit Euler, the damping implicit as in MuJoCo's Euler.

        dq' = (dq + dt·(torque + external)/inertia) / (1 + dt·damping/inertia),   then q' = q + dt·dq'

    Args:
        dq: before the step [rad/s].
        torque: the motor's, without its damping [N·m].
        external: the load's [N·m].
        inertia: load and armature [kg·m²].
        damping: the motor's [N·m·s/rad].
        dt: [s].
    """
    return (dq + dt * (torque + external) / inertia) / (1.0 + dt * damping / inertia)
