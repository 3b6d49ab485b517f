"""Alternatives to the grey box, as decoders and as ways of training, on the same data with the same budget.

    python benchmarks/alternatives.py --out runs/alternatives

Black boxes with 8 latents per motor, 16 neurons, trained in closed loop like preset latent_network (armature decoded
from z), and with one thing changed:
    taps               eight taps of error and velocity: preset latent_network itself, more latents
    signs_and_play     besides, the smoothed signs of the velocities, and a backlash of 10 mrad driven by the joint
    recurrent          a gated recurrent unit of 16 neurons in place of the taps
    implicit_damping   besides, a damping decoded from z, taken implicitly by the joint
    curriculum         windows of 16, 32, 64, then 128 steps
    robot_loads        a bench whose load inertias are those that the joints of the walking robot see
    grey_box           preset rollout
Figures: RMSE of the joint over free runs of 0.4 s under other excitations of the same motors, started from the recorded
state, median over motors [mrad]; results.json, figures.json, alternatives.md.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

os.environ.setdefault("JAX_PLATFORMS", "cpu")

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import optax
import tyro

from motorprior.artifacts import write_text
from motorprior.bench.facts import training_motors
from motorprior.bench.fleet import load_fleet
from motorprior.bench.recording import PRESETS as BENCHES
from motorprior.bench.recording import record
from motorprior.identification.loss import POSITION_SCALE, VELOCITY_SCALE, huber
from motorprior.identification.networks.closed_loop import closed_loop
from motorprior.identification.networks.network import Parameters
from motorprior.identification.presets import PRESETS, Preset
from motorprior.identification.train import identify
from motorprior.identification.training_data.windows import (
    EXTERNAL,
    INERTIA,
    POS,
    TARGET,
    VEL,
    TrainingData,
    draw,
    training_data,
)
from motorprior.pipeline.stage import write_results
from motorprior.results import Result, Results
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.signals import rms
from motorprior.simulation.playback import replay
from motorprior.simulation.world import World
from motorprior.simulation.world_config import WorldConfig
from motorprior.transfer.robot_fidelity import STEPS, trot_targets

TAPS = (0, 1, 2, 4, 6, 9, 13, 20)
LATENTS, NEURONS, WARM_UP, FREE_STEPS, MOTORS, ROWS = 8, 16, 60, 200, 32, 10_000
PLAY = 0.01
"""Width of the backlash operator [rad]."""
SIGN_SPEED = 0.1
"""Speed at which a smoothed sign is half turned [rad/s]."""
RECIPE = replace(PRESETS["latent_network"], num_latents=LATENTS, warm_up=WARM_UP, steps=2000)


@dataclass(frozen=True)
class Settings:
    """Train every alternative and compare."""

    out: Path
    """Run folder."""
    fleet: str = "mixed"
    """Population of motors."""
    steps: int = 2000
    """Adam steps of each."""


@dataclass(frozen=True)
class BlackBox:
    """A black-box decoder: its inputs, and whether it has a hidden state or a damping."""

    signs_and_play: bool = False
    recurrent: bool = False
    implicit_damping: bool = False

    def initial(self, rng: np.random.Generator) -> Parameters:
        """Glorot-scaled weights."""

        def dense(rows: int, columns: int) -> jnp.ndarray:
            return jnp.asarray(rng.standard_normal((rows, columns)) / np.sqrt(rows), jnp.float32)

        inputs = 2 if self.recurrent else len(TAPS) * (3 if self.signs_and_play else 2) + self.signs_and_play
        body = {
            "gates": dense(inputs + NEURONS + LATENTS, 2 * NEURONS),
            "fresh": dense(inputs + NEURONS + LATENTS, NEURONS),
        }
        layers = {"w1": dense(inputs, NEURONS), "v1": dense(LATENTS, NEURONS), "b1": jnp.zeros(NEURONS)}
        last = {"w2": dense(NEURONS, NEURONS), "b2": jnp.zeros(NEURONS), "w3": dense(NEURONS, 1)[:, 0]}
        constants = {"armature": jnp.log(jnp.asarray([0.002])), "armature_slope": jnp.zeros(LATENTS)}
        constants |= {"damping": jnp.log(jnp.asarray([0.1])), "damping_slope": jnp.zeros(LATENTS)}
        return (body if self.recurrent else layers) | last | constants

    def start(self, row: jnp.ndarray) -> tuple[jnp.ndarray, ...]:
        """Histories of error and velocity, newest first, state of the backlash operator, hidden state."""
        count = row.shape[0]
        error = jnp.broadcast_to((row[:, TARGET] - row[:, POS])[:, None], (count, TAPS[-1] + 1))
        velocity = jnp.broadcast_to(row[:, VEL][:, None], (count, TAPS[-1] + 1))
        return error, velocity, row[:, POS], jnp.zeros((count, NEURONS))

    def step(self, p: Parameters, z: Any, memory: Any, target: Any, q: Any, dq: Any, scales: dict[str, float]):
        """New memory and the torque [N·m]."""
        errors, velocities, play, hidden = memory
        errors = jnp.concatenate([(target - q)[:, None], errors[:, :-1]], axis=1)
        velocities = jnp.concatenate([dq[:, None], velocities[:, :-1]], axis=1)
        play = jnp.clip(play, q - 0.5 * PLAY, q + 0.5 * PLAY)
        taps = np.asarray(TAPS)
        e, v = errors[:, taps] / scales["error_scale"], velocities[:, taps] / scales["velocity_scale"]
        if self.recurrent:
            seen = jnp.concatenate([e[:, :1], v[:, :1], hidden, z], axis=1)
            update, reset = jnp.split(jax.nn.sigmoid(seen @ p["gates"]), 2, axis=1)
            fresh = jnp.tanh(jnp.concatenate([e[:, :1], v[:, :1], reset * hidden, z], axis=1) @ p["fresh"])
            hidden = (1.0 - update) * hidden + update * fresh
            first = hidden
        else:
            inputs = [e, v]
            if self.signs_and_play:
                inputs += [jnp.tanh(velocities[:, taps] / SIGN_SPEED), ((play - q) / (0.5 * PLAY))[:, None]]
            first = jax.nn.soft_sign(jnp.concatenate(inputs, axis=1) @ p["w1"] + p["b1"] + z @ p["v1"])
        second = jax.nn.soft_sign(first @ p["w2"] + p["b2"])
        limit = scales["torque_limit"]
        return (errors, velocities, play, hidden), jnp.clip(scales["torque_scale"] * (second @ p["w3"]), -limit, limit)

    def rollout(self, preset: Preset, scales: dict[str, float]) -> Callable:
        """(parameters, windows, z) -> errors of position and velocity, (steps, B), as `closed_loop` gives them."""
        dt = preset.period

        def run(p: Parameters, windows: jnp.ndarray, z: jnp.ndarray) -> tuple[jnp.ndarray, jnp.ndarray]:
            rows = jnp.swapaxes(windows, 0, 1)
            past, free = rows[: preset.history], rows[preset.history :]
            inertia = free[0, :, INERTIA] + jnp.exp(p["armature"] + z @ p["armature_slope"])
            damping = jnp.exp(p["damping"] + z @ p["damping_slope"]) if self.implicit_damping else 0.0

            def follow(memory, row):
                return self.step(p, z, memory, row[:, TARGET], row[:, POS], row[:, VEL], scales)[0], None

            def advance(state, row):
                q, dq, memory = state
                memory, torque = self.step(p, z, memory, row[:, TARGET], q, dq, scales)
                dq = (dq + dt * (torque + row[:, EXTERNAL]) / inertia) / (1.0 + dt * damping / inertia)
                return (q + dt * dq, dq, memory), (q + dt * dq, dq)

            memory = jax.lax.stop_gradient(jax.lax.scan(follow, self.start(rows[0]), past)[0])
            _, (q, dq) = jax.lax.scan(advance, (free[0, :, POS], free[0, :, VEL], memory), free[:-1])
            return q - free[1:, :, POS], dq - free[1:, :, VEL]

        return run


def train(box: BlackBox, data: TrainingData, lengths: tuple[int, ...], steps: int) -> tuple[Parameters, jnp.ndarray]:
    """Parameters and latents (M, Z); ``lengths`` are the windows' of equal parts of the training."""
    rng = np.random.default_rng(0)
    state = (box.initial(rng), jnp.asarray(0.1 * rng.standard_normal((MOTORS, LATENTS)), jnp.float32))
    schedule = optax.warmup_cosine_decay_schedule(0.0, 3e-3, min(100, steps // 10), steps)
    optimiser = optax.chain(optax.clip_by_global_norm(1.0), optax.adam(schedule))
    moments, series = optimiser.init(state), jnp.asarray(data.series)
    for part, length in enumerate(lengths):
        preset = replace(RECIPE, window=length)
        run, rows = box.rollout(preset, data.scales), preset.history + length

        def loss(trained, motors, starts, run=run, rows=rows):
            z = trained[1][motors]
            windows = series[motors[:, None], starts[:, None] + jnp.arange(rows)]
            q, dq = run(trained[0], windows, z)
            errors = huber(q / POSITION_SCALE) + huber(dq / VELOCITY_SCALE)
            return jnp.mean(errors) + 1e-4 * jnp.mean(jnp.sum(trained[1] ** 2, axis=1))

        def step(both, batch, loss=loss):
            updates, moments = optimiser.update(jax.grad(loss)(both[0], *batch), both[1], both[0])
            return (optax.apply_updates(both[0], updates), moments), None

        drawn = draw(np.random.default_rng([1, part]), data, preset, steps // len(lengths))
        (state, moments), _ = jax.jit(lambda both, batches, step=step: jax.lax.scan(step, both, batches))(
            (state, moments), tuple(jnp.asarray(rows) for rows in drawn)
        )
    return jax.block_until_ready(state)


def measured_inertias(fleet: str) -> tuple[float, float]:
    """10th and 90th percentile of the joints' inertias in a trotting robot, without contacts: 1 / (M⁻¹)_jj [kg·m²]."""
    world, rng = World(WorldConfig.of(PUPPER_V2, physics_dt=spec.TWIN_PHYSICS_DT)), np.random.default_rng(0)
    motors = load_fleet(fleet).sample(spec.NUM_JOINTS, rng).actuator()
    trot = replay(world, motors, trot_targets(PUPPER_V2, rng, STEPS))
    data, inertias = mujoco.MjData(world.model), []
    for joint_pos in trot.joint_pos[::50]:
        data.qpos[7:] = joint_pos
        mujoco.mj_forward(world.model, data)
        full = np.zeros((world.model.nv, world.model.nv))
        mujoco.mj_fullM(world.model, data, full)
        inertias.append(1.0 / np.diag(np.linalg.inv(full))[6:])
    low, high = np.percentile(inertias, (10, 90))
    return float(low), float(high)


def free_run_error(run: Callable, parameters: Parameters, z: jnp.ndarray, held_out: TrainingData, rows: int) -> float:
    """Median over motors of the RMSE of free runs [mrad], one per segment."""
    starts = held_out.starts[np.searchsorted(held_out.starts, np.arange(0, held_out.series.shape[1], 500))]
    windows = jnp.asarray(np.stack([held_out.series[:, start : start + rows] for start in starts]))
    errors = jax.jit(jax.vmap(lambda one: run(parameters, one, z)[0]))(windows)
    return 1e3 * float(np.median(rms(np.asarray(errors), axis=(0, 1))))


def compare(settings: Settings) -> Results:
    """rmse_mrad and seconds of every model."""
    fleet = load_fleet(settings.fleet)
    motors = training_motors(fleet, MOTORS, 0)
    held_log = record(motors, BENCHES["adapt"], 5000, 77, fleet)
    benches = {"bench": BENCHES["rollout"]}
    benches["robot_loads"] = replace(BENCHES["rollout"], load_inertia=measured_inertias(settings.fleet))
    logs = {name: record(motors, bench, ROWS, 0, fleet) for name, bench in benches.items()}
    results = Results()

    def note(name: str, seconds: float, error: float) -> None:
        nonlocal results
        results += Results((Result("rmse_mrad", "mrad", error, name), Result("seconds", "s", seconds, name)))
        write_results(settings.out, results)
        print(f"{name}: {error:.1f} mrad, {seconds:.0f} s", flush=True)

    variants = {
        "taps": (BlackBox(), "bench", (64,)),
        "signs_and_play": (BlackBox(signs_and_play=True), "bench", (64,)),
        "recurrent": (BlackBox(recurrent=True), "bench", (64,)),
        "implicit_damping": (BlackBox(implicit_damping=True), "bench", (64,)),
        "curriculum": (BlackBox(), "bench", (16, 32, 64, 128)),
        "robot_loads": (BlackBox(), "robot_loads", (64,)),
    }
    free = replace(RECIPE, window=FREE_STEPS)
    for name, (box, bench, lengths) in variants.items():
        data, started = training_data(logs[bench], replace(RECIPE, window=max(lengths)), name), time.monotonic()
        parameters, z = train(box, data, lengths, settings.steps)
        seconds, held_out = time.monotonic() - started, training_data(held_log, free, "held out")
        run = box.rollout(free, data.scales)
        note(name, seconds, free_run_error(run, parameters, z, held_out, free.history + FREE_STEPS))
    grey_box(settings, logs["bench"], held_log, note)
    return results


def grey_box(settings: Settings, log: Any, held_log: Any, note: Callable[[str, float, float], None]) -> None:
    """Preset rollout with as many steps, by the same measure."""
    from motorprior.identification.networks.network import import_parameters

    preset = replace(PRESETS["rollout"], steps=settings.steps)
    data, started = training_data(log, preset, "bench"), time.monotonic()
    found = identify(data, preset, 0)
    seconds, free = time.monotonic() - started, replace(found.preset, window=FREE_STEPS)
    run, held_out = closed_loop(free, data.scales, bounded=False), training_data(held_log, free, "held out")
    z = jnp.asarray(found.mean, jnp.float32)
    note(
        "grey_box",
        seconds,
        free_run_error(run, import_parameters(found.network), z, held_out, free.history + FREE_STEPS),
    )


def main() -> None:
    """Measure, write and print."""
    settings = tyro.cli(Settings, description=__doc__)
    results = compare(settings)
    lines = ["| decoder or training | free runs [mrad] | s |", "|---|---|---|"]
    for name in results.distinct("model"):
        error, seconds = (results.value(quantity=quantity, model=name) for quantity in ("rmse_mrad", "seconds"))
        lines.append(f"| {name} | {error:.1f} | {seconds:.0f} |")
    write_text(settings.out / "alternatives.md", "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
