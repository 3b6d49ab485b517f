"""The loaded joint simulated with a learned motor over windows of a log, differentiable.

From the recorded state at the window's start, per step of the semi-implicit Euler with the motor's torque, damping d
and armature a, as the dynamometer and the robot's engine take them,

    dq' = (dq + dt·(torque + external_torque)/(J + a)) / (1 + dt·d/(J + a)),   q' = q + dt·dq'

with torque from the model's own history. Before the start the model follows the recorded joint, so that its history
and the hidden state of a grey box (rotor, play, delayed commands) are those of the log.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motorprior.actuator.geared_motor import LONGEST_DELAY
from motorprior.identification.motor_dynamics import Constants, MotorState, advance, at_rest, decode, delayed
from motorprior.identification.network import Parameters, armature, decoder_latents, motor_bias, scaled_torque
from motorprior.identification.presets import Preset
from motorprior.identification.windows import EXTERNAL, INERTIA, POS, TARGET, TORQUE, VEL

Rollout = Callable[[Parameters, jnp.ndarray, jnp.ndarray], tuple[jnp.ndarray, jnp.ndarray, jnp.ndarray]]


class _Memory(NamedTuple):
    """Newest first: (B, K) scaled errors and velocities, commands [rad]; and the grey box's state."""

    errors: jnp.ndarray
    velocities: jnp.ndarray
    commands: jnp.ndarray
    motor: MotorState


def _push(row: jnp.ndarray, history: jnp.ndarray) -> jnp.ndarray:
    return jnp.concatenate([row[:, None], history[:, :-1]], axis=1)


def _fill(row: jnp.ndarray, length: int) -> jnp.ndarray:
    return jnp.broadcast_to(row[:, None], (row.shape[0], length))


def closed_loop(preset: Preset, scales: dict[str, float], bounded: bool) -> Rollout:
    """A function (parameters, windows (B, rows, channels), z (B, Z)) -> errors of position, velocity and torque.

    All (steps, B), simulated less recorded [rad], [rad/s], [N·m], over the free rows: positions and velocities of all
    but the first, the torques that lead there. ``bounded`` limits what each window adds to a gradient (for training, in
    reverse mode).
    """
    taps, dt = np.asarray(preset.taps), preset.period
    limit = scales["torque_limit"] / scales["torque_scale"]
    kept = max(preset.taps[-1], round(LONGEST_DELAY / dt) + 1) + 1

    def start(first: jnp.ndarray) -> _Memory:
        error = _fill((first[:, TARGET] - first[:, POS]) / scales["error_scale"], kept)
        velocity = _fill(first[:, VEL] / scales["velocity_scale"], kept)
        return _Memory(error, velocity, _fill(first[:, TARGET], kept), at_rest(first[:, POS], first[:, VEL]))

    def actuate(
        parameters: Parameters, bias: jnp.ndarray, motor: Constants, memory: _Memory, target: Any, q: Any, dq: Any
    ):
        errors = _push((target - q) / scales["error_scale"], memory.errors)
        velocities = _push(dq / scales["velocity_scale"], memory.velocities)
        commands, state = _push(target, memory.commands), memory.motor
        inputs = jnp.concatenate([errors[:, taps], velocities[:, taps]], axis=1)
        torque = scales["torque_scale"] * jnp.clip(scaled_torque(parameters, inputs, bias), -limit, limit)
        damping = jnp.zeros_like(q)
        if preset.grey_box:
            wanted = delayed(commands, motor["delay"] + 0.5 * dt, dt)
            state, gear, damping = advance(motor, state, wanted, q, dq, dt)
            torque = torque + gear
        return _Memory(errors, velocities, commands, state), torque, damping

    def rollout(
        parameters: Parameters, windows: jnp.ndarray, z: jnp.ndarray
    ) -> tuple[jnp.ndarray, jnp.ndarray, jnp.ndarray]:
        z = decoder_latents(parameters, z)
        bias, motor = motor_bias(parameters, z), decode(parameters, z, bounded) if preset.grey_box else {}
        rows = jnp.swapaxes(windows, 0, 1)
        past, free = rows[: preset.history], rows[preset.history :]
        inertia = free[0, :, INERTIA]
        if preset.has_armature:
            inertia = inertia + armature(parameters, z)

        def follow(memory: _Memory, row: jnp.ndarray):
            return actuate(parameters, bias, motor, memory, row[:, TARGET], row[:, POS], row[:, VEL])[0], None

        def step(state, row):
            q, dq, memory = state
            memory, torque, damping = actuate(parameters, bias, motor, memory, row[:, TARGET], q, dq)
            dq = (dq + dt * (torque + row[:, EXTERNAL]) / inertia) / (1.0 + dt * damping / inertia)
            q = q + dt * dq
            return (q, dq, memory), (q, dq, torque - damping * dq)

        memory, _ = jax.lax.scan(follow, start(rows[0]), past)
        memory = jax.lax.stop_gradient(memory)
        _, (q, dq, torque) = jax.lax.scan(step, (free[0, :, POS], free[0, :, VEL], memory), free[:-1])
        return q - free[1:, :, POS], dq - free[1:, :, VEL], torque - free[:-1, :, TORQUE]

    return rollout
