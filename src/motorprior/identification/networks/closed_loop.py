"""Differentiable closed-loop simulation of a loaded joint with a learned motor, over windows of a log.

The simulation starts from the recorded state and advances as on the dynamometer (`bench.loaded_joint`); the torque
depends on the simulated history, not the recorded one. During the warm-up before the start the model follows the
recorded joint, so that its history and a grey box's hidden state (rotor, backlash, delayed commands) match the log.

If the log's encoders are on the rotors, the rotor follows the recording during the warm-up, with the joint attached to
it by the gear, and afterwards rotor angles are compared. All angles are then encoder angles, so that encoder_zero has
no effect, and the backlash is fixed at that of the central motor: an encoder on the rotor measures it so weakly that a
fit would absorb errors of the loads in it (on virtual robots the log of the backlash was 0.58 off, at an estimated
standard deviation of 0.08). Such a log identifies neither. Only a grey box has a rotor; a network takes the reading as
the joint's angle.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from motorprior.actuator.geared_motor_constants import LONGEST_DELAY, with_logged_gains
from motorprior.actuator.geared_motor_step import MotorState
from motorprior.actuator.latent import scaled_torque
from motorprior.bench.dynamometer import next_velocity
from motorprior.identification.networks.motor_dynamics import Constants, advance, at_rest, decode, delayed
from motorprior.identification.networks.network import Parameters, armature, decoder_latents, motor_bias
from motorprior.identification.presets import Preset
from motorprior.identification.training_data.windows import (
    CHANNELS,
    EXTERNAL,
    INERTIA,
    KD,
    KP,
    POS,
    SECONDS,
    STIFFNESS,
    SUPPLY,
    TARGET,
    TORQUE,
    VEL,
    WARMER,
)

Rollout = Callable[[Parameters, jnp.ndarray, jnp.ndarray], tuple[jnp.ndarray, jnp.ndarray, jnp.ndarray]]


class _Memory(NamedTuple):
    """History (B, K), newest first, of scaled errors, scaled velocities and commands [rad]; state of the grey box."""

    errors: jnp.ndarray
    velocities: jnp.ndarray
    commands: jnp.ndarray
    motor: MotorState


def _push(row: jnp.ndarray, history: jnp.ndarray) -> jnp.ndarray:
    return jnp.concatenate([row[:, None], history[:, :-1]], axis=1)


def _fill(row: jnp.ndarray, length: int) -> jnp.ndarray:
    return jnp.broadcast_to(row[:, None], (row.shape[0], length))


def closed_loop(preset: Preset, scales: dict[str, float], bounded: bool, at_rotor: bool = False) -> Rollout:
    """Build the function (parameters, windows (B, rows, channels), z (B, Z)) -> position, velocity and torque errors.

    The errors are simulated minus recorded, each (steps, B) [rad], [rad/s], [N·m], over the free rows: positions and
    velocities of all rows but the first, and the torques that lead to them. ``bounded`` limits the gradient of each
    window (for training, in reverse mode). ``at_rotor`` marks windows whose positions and velocities are the rotors'.
    """
    taps, dt, terms = np.asarray(preset.taps), preset.period, preset.terms
    limit = scales["torque_limit"] / scales["torque_scale"]
    at_rotor = at_rotor and preset.grey_box
    kept = max(preset.taps[-1], round(LONGEST_DELAY / dt) + 1) + 1

    def start(first: jnp.ndarray) -> _Memory:
        error = _fill((first[:, TARGET] - first[:, POS]) / scales["error_scale"], kept)
        velocity = _fill(first[:, VEL] / scales["velocity_scale"], kept)
        state = at_rest(first[:, TARGET], first[:, POS], first[:, VEL], terms)
        return _Memory(error, velocity, _fill(first[:, TARGET], kept), state)

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
            state, gear, damping = advance(motor, state, wanted, q, dq, dt, terms)
            torque = torque + gear
        return _Memory(errors, velocities, commands, state), torque, damping

    def rollout(
        parameters: Parameters, windows: jnp.ndarray, z: jnp.ndarray
    ) -> tuple[jnp.ndarray, jnp.ndarray, jnp.ndarray]:
        assert windows.shape[-1] == CHANNELS, "JAX reads another channel where one is missing"
        own = decoder_latents(parameters, z)
        rows = jnp.swapaxes(windows, 0, 1)
        past, free = rows[: preset.history], rows[preset.history :]
        under = (free[0, :, channel] for channel in (SECONDS, SUPPLY, WARMER))
        motor = decode(parameters, own, bounded, terms, *under) if preset.grey_box else {}
        if preset.gain_unit:
            motor = with_logged_gains(motor, free[0, :, KP], free[0, :, KD])
        bias = motor_bias(parameters, own)
        inertia = free[0, :, INERTIA]
        if preset.has_armature:
            inertia = inertia + armature(parameters, own)
        if at_rotor:
            central = decode(parameters, decoder_latents(parameters, jnp.zeros_like(z)), bounded, terms)
            motor |= {"backlash": jax.lax.stop_gradient(central["backlash"]), "encoder_zero": jnp.zeros_like(inertia)}

        def step(state, row):
            q, dq, memory = state
            memory, torque, damping = actuate(parameters, bias, motor, memory, row[:, TARGET], q, dq)
            external = row[:, EXTERNAL] + row[:, STIFFNESS] * q
            dq = next_velocity(dq, torque, external, inertia, damping, dt)
            q = q + dt * dq
            measured = (memory.motor.rotor_pos, memory.motor.rotor_vel) if at_rotor else (q, dq)
            return (q, dq, memory), (*measured, torque - damping * dq)

        def follow(state, rows):
            row, following = rows
            (q, dq, memory), _ = step(state, row)
            if at_rotor:
                rotor = memory.motor._replace(rotor_pos=following[:, POS], rotor_vel=following[:, VEL])
                return (q, dq, memory._replace(motor=rotor)), None
            return (following[:, POS], following[:, VEL], memory), None

        begin = (rows[0, :, POS], rows[0, :, VEL], start(rows[0]))
        settled, _ = jax.lax.scan(follow, begin, (past, rows[1 : preset.history + 1]))
        _, (pos, vel, torque) = jax.lax.scan(step, jax.lax.stop_gradient(settled), free[:-1])
        return pos - free[1:, :, POS], vel - free[1:, :, VEL], torque - free[:-1, :, TORQUE]

    return rollout
