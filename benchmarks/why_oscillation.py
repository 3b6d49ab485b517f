"""Why torque regression oscillates, and which single change cures how much: docs/why-the-paper-oscillates.md.

    python benchmarks/why_oscillation.py --out runs/why

Three minutes on two cores.

Torque causes acceleration, so the last change of velocity tells the torque that made it: a regression one step
ahead reads the torque off its inputs, correctly, and in open loop that costs nothing. A simulator closes the loop: the
network is linearised about recorded states, put on a joint, and the largest eigenvalue of joint + history says by how
much a disturbance grows each step. Above 1 the legs oscillate until the torque limit holds them.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro
from matplotlib.figure import Figure

from motorprior.actuator.latent import LatentActuator, LatentNetwork
from motorprior.actuator.physical import PhysicalActuator
from motorprior.artifacts import write_json
from motorprior.bench.dynamometer import Trial, run
from motorprior.bench.fleet import load_fleet
from motorprior.bench.record import bench_preset, record
from motorprior.cli.bench import training_motors
from motorprior.identification.validate import HELD_OUT_SEED
from motorprior.signals import high_frequency_rms
from motorprior.transfer.plots_style import MODEL_COLORS, OTHER_COLOR, png_bytes
from motorprior.transfer.robot_fidelity import CUTOFF, robot_fidelity

STEPS, MOTORS = 10_000, 32
LOADS = np.geomspace(3e-4, 3e-2, 13)
"""Load inertias of the sweep [kg·m²]."""
LEG = (2e-4, 1.7e-3)
"""Apparent inertias of the leg joints without motors, knee to abduction [kg·m²]."""
VARIANTS = {
    "torque regression": ("paper_wide", {}),
    "+ closed loop": ("latent_network", {"has_armature": False}),
    "+ armature": ("latent_network", {}),
    "+ physics": ("rollout", {}),
}
"""Each has the change in its name in addition to those above it; all on the same log."""
COLORS = (MODEL_COLORS["paper_wide"], OTHER_COLOR, MODEL_COLORS["one_network"], MODEL_COLORS["rollout"])


@dataclass(frozen=True)
class Settings:
    """Train the four variants and look at their loops."""

    out: Path
    """Folder for why.json and why.png."""
    fleet: str = "pupper_v2"
    """Population of motors."""
    seed: int = 0
    """Seed of bench and training."""
    adam_steps: int | None = None
    """Adam steps; the presets' own number if not given."""


def train(settings: Settings) -> dict[str, tuple[LatentNetwork, np.ndarray]]:
    """Every variant's network and the training motors' posterior means."""
    from motorprior.identification.presets import identification_preset
    from motorprior.identification.train import identify
    from motorprior.identification.windows import training_data

    fleet = load_fleet(settings.fleet)
    motors = training_motors(fleet, MOTORS, settings.seed)
    log, found = record(motors, bench_preset("rollout"), STEPS, settings.seed, fleet), {}
    for name, (preset_name, changes) in VARIANTS.items():
        preset = replace(identification_preset(preset_name), **changes)
        preset = replace(preset, steps=settings.adam_steps or preset.steps)
        identified = identify(training_data(log, preset, "bench"), preset, settings.seed)
        found[name] = (identified.network, identified.mean)
        print(f"trained: {name}", flush=True)
    return found


def sensitivities(network: LatentNetwork, mean: np.ndarray, states: np.ndarray) -> np.ndarray:
    """(M, N, 2T) derivatives of the torque by errors [N·m/rad] and velocities [N·m·s/rad] of every tap.

    Args:
        network: that gives the torque.
        mean: (M, Z) latents.
        states: (M, N, 2T) scaled inputs of every motor from its log.
    """
    step, inputs = 1e-3, 2 * len(network.taps)
    scale = np.repeat([network.error_scale, network.velocity_scale], len(network.taps))
    slopes = np.zeros(states.shape)
    for column, nudge in enumerate(step * np.eye(inputs)):
        for motor, z in enumerate(mean):
            rows, latents = states[motor], np.repeat(z[None], states.shape[1], axis=0)
            difference = network.torque(rows + nudge, latents) - network.torque(rows - nudge, latents)
            slopes[motor, :, column] = difference / (2 * step) / scale[column]
    return slopes


def growth(network: LatentNetwork, slopes: np.ndarray, armature: np.ndarray, load: float) -> tuple[float, float]:
    """Median over motors and states of the largest eigenvalue's size, and its median frequency [Hz].

    State: errors and velocities of the last taps[-1] + 1 steps. dq' = dq + period·torque/(load + armature),
    error' = error - period·dq'.
    """
    length, period, taps = network.taps[-1] + 1, network.period, np.array(network.taps)
    count = slopes.shape[0] * slopes.shape[1]
    gain = period * slopes / (load + armature)[:, None, None]
    matrix = np.zeros((count, 2 * length, 2 * length))
    shift = np.eye(length, k=-1)
    matrix[:, :length, :length], matrix[:, length:, length:] = shift, shift
    flat, half = gain.reshape(count, -1), len(taps)
    matrix[:, length, taps] += flat[:, :half]
    matrix[:, length, length + taps] += flat[:, half:]
    matrix[:, length, length] += 1.0
    matrix[:, 0, :] = -period * matrix[:, length, :]
    matrix[:, 0, 0] += 1.0
    values = np.linalg.eigvals(matrix)
    largest = np.take_along_axis(values, np.argmax(np.abs(values), axis=1)[:, None], axis=1)[:, 0]
    return float(np.median(np.abs(largest))), float(np.median(np.abs(np.angle(largest))) / (2 * np.pi * period))


def recorded_inputs(network: LatentNetwork, log, count: int = 24) -> np.ndarray:
    """(M, count, 2T) scaled histories out of a log."""
    first, rows = log.segment_slices()[0], np.array(network.taps)
    picked = np.linspace(first.start + rows[-1], first.stop - 1, count).astype(int)
    error = (log.position_target - log.joint_pos) / network.error_scale
    velocity = log.joint_vel / network.velocity_scale
    parts = [np.stack([channel[picked - age] for age in rows], axis=2) for channel in (error, velocity)]
    return np.concatenate(parts, axis=2).transpose(1, 0, 2)


def chatter(actuator, load: float, seed: int) -> float:
    """Median torque above 20 Hz [N·m] of joints with that load on a gait held at 100 Hz."""
    from motorprior.bench.excitation import gait, held

    rng = np.random.default_rng([HELD_OUT_SEED, seed, 77])
    count = actuator.num_motors
    target = np.stack([held(gait(rng, 1000, 0.002), 5) for _ in range(count)], axis=1)
    response = run(actuator, Trial(target, np.zeros_like(target), np.full(count, load), 0.002))
    return float(np.median(high_frequency_rms(response.joint_torque, 0.002, CUTOFF)))


def measure(settings: Settings) -> dict:
    """Loops, chatter against load, and torque above 20 Hz in the robot."""
    fleet = load_fleet(settings.fleet)
    motors = training_motors(fleet, MOTORS, settings.seed)
    log = record(motors, bench_preset("rollout"), STEPS, settings.seed, fleet)
    found = train(settings)
    results: dict = {"loads": LOADS.tolist(), "variants": {}}
    for name, (network, mean) in found.items():
        own = LatentActuator(network, mean)
        results["variants"][name] = {
            "armature_in_engine": float(own.armature.mean()),
            "chatter": [chatter(own, load, settings.seed) for load in LOADS],
        }
        if network.motor is None:  # a grey box is no function of its recorded inputs alone
            slopes = sensitivities(network, mean, recorded_inputs(network, log))
            loops = [growth(network, slopes, own.armature, load) for load in LOADS]
            results["variants"][name] |= {"growth": [size for size, _ in loops], "frequency": [at for _, at in loops]}
    results["physical"] = {"chatter": [chatter(PhysicalActuator(motors), load, settings.seed) for load in LOADS]}
    models = {name: lambda index, n=n, z=z: LatentActuator(n, z[index]) for name, (n, z) in found.items()}
    for place, hung in (("standing", False), ("hung", True)):
        fidelity = robot_fidelity(motors, models, hung, settings.seed)
        for name in models:
            results["variants"][name][f"{place}_rmse"] = float(np.median(fidelity.rmse[name]))
            results["variants"][name][f"{place}_torque_hf"] = float(np.median(fidelity.torque_hf[name]))
        results["physical"][f"{place}_torque_hf"] = float(np.median(fidelity.torque_hf["physical"]))
    return results


def picture(results: dict) -> bytes:
    """Growth of a disturbance per step; chatter against load; torque above 20 Hz in the robot."""
    shown = Figure(figsize=(12.0, 3.9), layout="constrained")
    left, middle, right = shown.subplots(1, 3)
    names, variants = list(results["variants"]), results["variants"]
    for name, color in zip(names, COLORS, strict=True):
        if "growth" in variants[name]:
            left.semilogx(LOADS, variants[name]["growth"], "o-", color=color, label=name, ms=3)
    left.axhline(1.0, color="k", lw=1)
    for axes in (left, middle):
        axes.axvspan(*LEG, color="0.9", zorder=0)
    left.set_xlabel("load inertia [kg·m²]\n(grey: a Pupper's leg joints)")
    left.set_ylabel("growth of a disturbance in 2 ms,\nlargest eigenvalue, median")
    left.legend(frameon=False, fontsize=8)
    for name, color in zip(names, COLORS, strict=True):
        middle.loglog(LOADS, variants[name]["chatter"], "o-", color=color, label=name, ms=3)
    middle.loglog(LOADS, results["physical"]["chatter"], "k--", label="physical")
    middle.set_xlabel("load inertia [kg·m²]")
    middle.set_ylabel("torque above 20 Hz [N·m], one joint")
    middle.legend(frameon=False, fontsize=8)
    place = np.arange(len(names))
    for offset, where, alpha in ((-0.2, "standing", 1.0), (0.2, "hung", 0.5)):
        values = [variants[n][f"{where}_torque_hf"] / results["physical"][f"{where}_torque_hf"] for n in names]
        right.bar(place + offset, values, 0.38, color=COLORS, alpha=alpha, label=where)
    right.axhline(1.0, color="k", lw=1)
    right.set_yscale("log")
    right.set_xticks(place, [name.replace(" ", "\n") for name in names], fontsize=8)
    right.set_ylabel("torque above 20 Hz in the robot,\nratio to the physical motors'")
    right.legend(frameon=False, fontsize=8)
    return png_bytes(shown)


def main() -> None:
    """Measure, write why.json and why.png, print what the page quotes."""
    settings = tyro.cli(Settings, description=__doc__)
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    results = measure(settings)
    settings.out.mkdir(parents=True, exist_ok=True)
    write_json(settings.out / "why.json", results)
    (settings.out / "why.png").write_bytes(picture(results))
    for name, found in results["variants"].items():
        print(name, {key: value for key, value in found.items() if not isinstance(value, list)})
    print("physical", {key: value for key, value in results["physical"].items() if not isinstance(value, list)})


if __name__ == "__main__":
    main()
