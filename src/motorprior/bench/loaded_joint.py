"""One joint with a known load: the formula of its step, for compiled code and for JAX."""

from __future__ import annotations

from typing import Any


def next_velocity(dq: Any, torque: Any, external: Any, inertia: Any, damping: Any, dt: Any) -> Any:
    """Joint velocity [rad/s] after a step of semi-implicit Euler with implicit damping, as in MuJoCo's Euler.

        dq' = (dq + dt·(torque + external)/inertia) / (1 + dt·damping/inertia),   then q' = q + dt·dq'

    Args:
        dq: joint velocity before the step [rad/s].
        torque: torque of the motor without its damping [N·m].
        external: torque of the load [N·m].
        inertia: inertia of load and armature [kg·m²].
        damping: damping of the motor [N·m·s/rad].
        dt: time step [s].
    """
    return (dq + dt * (torque + external) / inertia) / (1.0 + dt * damping / inertia)
