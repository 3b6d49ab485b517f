"""Why torque regression oscillates, and the effect of single changes.

See docs/why-the-paper-oscillates.md.

    python benchmarks/why_oscillation.py --out runs/why

Torque causes acceleration, so the last change of velocity reveals the torque. A one-step regression
learns this relation, which is correct in open loop. A simulator closes the loop. Here the network
is linearised about recorded states and connected to a joint. The largest eigenvalue of joint +
history is the growth of disturbances per step; above 1 the legs oscillate up to the torque limit.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import motorprior as mp
from figures import markdown
from motorprior.actuator.actuator import Actuator
from motorprior.actuator.arrays import ActuatorArrays
from motorprior.actuator.families import require_geared
from motorprior.actuator.latent import LatentNetwork, NetworkActuator
from motorprior.actuator.motor_prior import Decoder
from motorprior.actuator.physical import PhysicalMotors
from motorprior.artifacts import write_json, write_text
from motorprior.bench.dynamometer import Trial, run
from motorprior.bench.recording import BenchSchedule, bench_schedule, record, training_motors
from motorprior.excitation.hand_made import gait, zero_order_hold
from motorprior.identification.identify import identify
from motorprior.identification.presets import identification_preset
from motorprior.identification.windows import training_data
from motorprior.jax_device import use_cpu_by_default
from motorprior.report.plots_style import OTHER_COLOR, model_color, png_bytes
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from spectra import high_frequency_rms
from virtual_fleets.held_out_trials import HELD_OUT_SEED, ModelOfMotors
from virtual_fleets.robot_fidelity import CUTOFF, robot_fidelity

# range of load inertias [kg·m²]
MIN_LOAD = 3e-4
MAX_LOAD = 3e-2
NUM_INPUTS = 12  # histories of a motor
# apparent inertias of the leg joints without motors, knee to abduction [kg·m²]
LEG = (2e-4, 1.7e-3)
# periods of a bench [s]
FAST = 0.002
SLOW = 0.01
WIDE = bench_schedule("rollout")
SINUSOIDS = bench_schedule("paper")


@dataclass(frozen=True)
class Variant:
    """One recipe for the same motors."""

    bench: BenchSchedule
    preset: str  # recipe of identification
    color: str
    changes: dict[str, Any] = field(default_factory=dict)  # to the recipe
    # the engine has the rotor inertia; the learned torque acts on joint and rotor
    armature: bool = False
    damping: bool = False  # the engine integrates the velocity gain kd implicitly


# The paper's recipe and two changes to it; torque regression, which has both, and changes to it;
# closed-loop training
VARIANTS = {
    "the paper's recipe": Variant(SINUSOIDS, "paper", model_color("paper")),
    "paper + 2 ms clock": Variant(
        replace(SINUSOIDS, period=FAST), "paper", model_color("paper"), {"period": FAST}
    ),
    "paper + loads and impacts": Variant(
        replace(WIDE, period=SLOW, segment_steps=200, hold_steps=1), "paper", model_color("paper")
    ),
    "torque regression": Variant(WIDE, "paper_wide", model_color("paper_wide")),
    "torque + armature": Variant(WIDE, "paper_wide", "#c2571a", armature=True),
    "torque + implicit damping": Variant(WIDE, "paper_wide", "#d9a400", damping=True),
    "torque + both": Variant(WIDE, "paper_wide", "#8c6d00", armature=True, damping=True),
    "closed loop": Variant(WIDE, "latent_network", OTHER_COLOR, {"has_armature": False}),
    "closed loop + armature": Variant(WIDE, "latent_network", model_color("one_network")),
    "closed loop + physics": Variant(WIDE, "rollout", model_color("rollout")),
}


@dataclass(frozen=True)
class Settings:
    """Train every variant and analyse its closed loop."""

    out: Path  # folder for why.json, why.png and table.md
    fleet: str = "pupper_v2"  # population of motors
    seed: int = 0  # seed of bench and training
    adam_steps: int | None = None  # Adam steps; the steps of the presets if not given
    motors: int = 32  # training motors, at least one per joint of the robot
    steps: int = 10_000  # samples of each motor's log
    loads: int = 13  # load inertias of the sweep
    variants: tuple[str, ...] = tuple(VARIANTS)  # names of the variants

    def load_inertias(self) -> np.ndarray:
        """(loads,) load inertias of the sweep [kg·m²]."""
        return np.geomspace(MIN_LOAD, MAX_LOAD, self.loads)


@dataclass(frozen=True)
class EngineAssisted(NetworkActuator):
    """Motors of a network with given armature and damping in the engine."""

    in_engine: np.ndarray  # (2, n) armature [kg·m²] and damping [N·m·s/rad]

    @property
    def armature(self) -> np.ndarray:
        """(n,) [kg·m²]."""
        return self.in_engine[0]

    def arrays(self, physics_dt: float) -> ActuatorArrays:
        """See `Actuator.arrays`."""
        return super().arrays(physics_dt)._replace(damping=self.in_engine[1].copy())


@dataclass(frozen=True)
class Learned:
    """A trained variant."""

    model: Decoder
    mean: np.ndarray  # (n, Z) latents z of the training motors
    armature: np.ndarray  # (n,) armature of the training motors in the engine [kg·m²]
    damping: np.ndarray  # (n,) damping of the training motors in the engine [N·m·s/rad]

    def motors(self, index: np.ndarray) -> Actuator:
        """The training motors at ``index``."""
        if not isinstance(self.model, LatentNetwork):
            return self.model.motors(self.mean[index])
        in_engine = np.stack([self.armature, self.damping])[:, index]
        return EngineAssisted(self.model, self.mean[index], in_engine)


def residual_log(log: mp.MotorLog, armature: np.ndarray, damping: np.ndarray) -> mp.MotorLog:
    """The log with the torque to learn if the engine has armature and damping (n,).

    torque + armature·(dq' - dq)/period + damping·dq', with dq' the velocity at the next sample; the
    last sample of a segment repeats the previous one.
    """
    assert log.joint_torque is not None and log.joint_vel is not None
    torque = log.joint_torque.copy()
    for rows in log.segment_slices():
        velocity = log.joint_vel[rows]
        period = float(np.median(np.diff(log.time[rows])))
        torque[rows][:-1] += armature * np.diff(velocity, axis=0) / period + damping * velocity[1:]
        torque[rows][-1] = torque[rows][-2]
    return replace(log, joint_torque=torque)


def train(
    settings: Settings, variant: Variant, motors: PhysicalMotors
) -> tuple[Learned, mp.MotorLog]:
    """The learned motors of a variant, and their log."""
    preset = replace(identification_preset(variant.preset), **variant.changes)
    preset = replace(preset, steps=settings.adam_steps or preset.steps)
    log = record(
        motors, variant.bench, settings.steps, settings.seed, mp.load_fleet(settings.fleet)
    )
    armature = variant.armature * motors.armature
    damping = variant.damping * motors.kd
    prior = identify(
        training_data(residual_log(log, armature, damping), preset, "bench"), preset, settings.seed
    )
    if preset.has_armature:
        armature = prior.model.armature(prior.mean)
    return Learned(prior.model, prior.mean, armature, damping), log


def sensitivities(network: LatentNetwork, mean: np.ndarray, states: np.ndarray) -> np.ndarray:
    """(M, N, 2T) derivatives of the torque by the inputs of all taps.

    The inputs are errors, with derivatives in N·m/rad, and velocities, in N·m·s/rad.

    ``mean`` (M, Z) are latents, ``states`` (M, N, 2T) scaled inputs from the logs.
    """
    step = 1e-3
    inputs = 2 * len(network.taps)
    scale = np.repeat([network.error_scale, network.velocity_scale], len(network.taps))
    slopes = np.zeros(states.shape)
    for column, nudge in enumerate(step * np.eye(inputs)):
        for motor, z in enumerate(mean):
            rows = states[motor]
            latents = np.repeat(z[None], states.shape[1], axis=0)
            difference = network.torque(rows + nudge, latents) - network.torque(
                rows - nudge, latents
            )
            slopes[motor, :, column] = difference / (2 * step) / scale[column]
    return slopes


def growth(
    network: LatentNetwork, learned: Learned, slopes: np.ndarray, load: float
) -> tuple[float, float]:
    """Largest |eigenvalue| per 2 ms and its frequency [Hz], medians over motors and states.

    State: errors and velocities of the last taps[-1] + 1 steps. With inertia J = load + armature,
    dq' = (dq + period·torque/J) / (1 + period·damping/J),  error' = error - period·dq'.
    """
    inertia = load + learned.armature
    length = network.taps[-1] + 1
    period = network.period
    taps = np.array(network.taps)
    count = slopes.shape[0] * slopes.shape[1]
    gain = period * slopes / inertia[:, None, None]
    matrix = np.zeros((count, 2 * length, 2 * length))
    shift = np.eye(length, k=-1)
    matrix[:, :length, :length] = shift
    matrix[:, length:, length:] = shift
    flat = gain.reshape(count, -1)
    half = len(taps)
    matrix[:, length, taps] += flat[:, :half]
    matrix[:, length, length + taps] += flat[:, half:]
    matrix[:, length, length] += 1.0
    matrix[:, length, :] /= np.repeat(1.0 + period * learned.damping / inertia, slopes.shape[1])[
        :, None
    ]
    matrix[:, 0, :] = -period * matrix[:, length, :]
    matrix[:, 0, 0] += 1.0
    values = np.linalg.eigvals(matrix)
    largest = np.take_along_axis(values, np.argmax(np.abs(values), axis=1)[:, None], axis=1)[:, 0]
    size = float(np.median(np.abs(largest))) ** (FAST / period)
    return size, float(np.median(np.abs(np.angle(largest))) / (2 * np.pi * period))


def recorded_inputs(network: LatentNetwork, log: mp.MotorLog) -> np.ndarray:
    """(M, NUM_INPUTS, 2T) scaled histories from a log."""
    first = log.segment_slices()[0]
    rows = np.array(network.taps)
    picked = np.linspace(first.start + rows[-1], first.stop - 1, NUM_INPUTS).astype(int)
    error = (log.position_target - log.joint_pos) / network.error_scale
    assert log.joint_vel is not None
    velocity = log.joint_vel / network.velocity_scale
    past_rows = picked - rows[:, None]  # (T, NUM_INPUTS)
    histories = [np.moveaxis(channel[past_rows], 0, 2) for channel in (error, velocity)]
    return np.concatenate(histories, axis=2).transpose(1, 0, 2)


def chatter(actuator, load: float, seed: int) -> float:
    """Median torque above 20 Hz [N·m] of joints with this load, for a gait held at 100 Hz."""
    rng = np.random.default_rng([HELD_OUT_SEED, seed, 77])
    count = actuator.num_motors
    target = np.stack([zero_order_hold(gait(rng, 1000, 0.002), 5) for _ in range(count)], axis=1)
    response = run(actuator, Trial(target, np.zeros_like(target), np.full(count, load), 0.002))
    return float(np.median(high_frequency_rms(response.joint_torque, 0.002, CUTOFF)))


def compute(settings: Settings) -> dict[str, Any]:
    """Closed loops, chatter over load, and torque above 20 Hz in the robot."""
    fleet = mp.load_fleet(settings.fleet)
    motors = require_geared(training_motors(fleet, settings.motors, settings.seed))
    loads = settings.load_inertias()

    models: dict[str, ModelOfMotors] = {}
    variants: dict[str, dict[str, Any]] = {}
    for name in settings.variants:
        learned, log = train(settings, VARIANTS[name], motors)
        models[name] = learned.motors
        learned_motors = learned.motors(np.arange(settings.motors))
        variants[name] = {
            "armature_in_engine": float(learned_motors.armature.mean()),
            "chatter": [chatter(learned_motors, load, settings.seed) for load in loads],
        }
        if isinstance(learned.model, LatentNetwork):  # a grey box has other state than its inputs
            inputs = recorded_inputs(learned.model, log)
            slopes = sensitivities(learned.model, learned.mean, inputs)
            loops = [growth(learned.model, learned, slopes, load) for load in loads]
            variants[name]["growth"] = [size for size, _ in loops]
            variants[name]["frequency"] = [frequency for _, frequency in loops]
        print(f"trained: {name}", flush=True)

    truth = mp.PhysicalActuator(motors)
    physical: dict[str, Any] = {"chatter": [chatter(truth, load, settings.seed) for load in loads]}
    for place, suspended in (("standing", False), ("suspended", True)):
        fidelity = robot_fidelity(PUPPER_V2, motors, models, suspended, settings.seed)
        for name in models:
            variants[name][f"{place}_rmse"] = float(np.median(fidelity[name][0]))
            variants[name][f"{place}_torque_hf"] = float(np.median(fidelity[name][1]))
        physical[f"{place}_torque_hf"] = float(np.median(fidelity["physical"][1]))
    return {"loads": loads.tolist(), "variants": variants, "physical": physical}


def picture(results: dict[str, Any]) -> bytes:
    """Growth of a disturbance per step; chatter over load; torque above 20 Hz in the robot."""
    figure = Figure(figsize=(13.5, 4.3), layout="constrained")
    left, middle, right = figure.subplots(1, 3, width_ratios=(1.0, 1.0, 1.25))
    left.set(xscale="log", ylabel="growth of a disturbance in 2 ms,\nlargest eigenvalue, median")
    left.axhline(1.0, color="k", lw=1)
    middle.set(xscale="log", yscale="log", ylabel="torque above 20 Hz [N·m], one joint")
    loads = results["loads"]
    middle.plot(loads, results["physical"]["chatter"], "k--", label="physical")
    for axes, key in ((left, "growth"), (middle, "chatter")):
        for name, values in results["variants"].items():
            variant = VARIANTS[name]
            # the paper's recipe diverges on a bare leg
            if variant.preset != "paper" and key in values:
                axes.plot(loads, values[key], "o-", color=variant.color, label=name, ms=3)
        axes.axvspan(*LEG, color="0.9", zorder=0)
        axes.set_xlabel("load inertia [kg·m²]\n(grey: a Pupper's leg joints)")
        axes.legend(frameon=False, fontsize=7)
    _bars(right, results)
    return png_bytes(figure)


def _bars(axes: Axes, results: dict[str, Any]) -> None:
    """Ratios of all variants, first on top."""
    variants = results["variants"]
    place = np.arange(len(variants))
    for offset, where, alpha in ((-0.2, "standing", 1.0), (0.2, "suspended", 0.5)):
        physical = results["physical"][f"{where}_torque_hf"]
        values = [variant[f"{where}_torque_hf"] / physical for variant in variants.values()]
        colors = [VARIANTS[name].color for name in variants]
        axes.barh(place + offset, values, 0.38, color=colors, alpha=alpha, label=where)
    labels = [f"{name}  ({1e3 * variants[name]['standing_rmse']:.0f} mrad)" for name in variants]
    axes.set_yticks(place, labels, fontsize=8)
    axes.invert_yaxis()
    axes.axvline(1.0, color="k", lw=1)
    label = "torque above 20 Hz in the robot, ratio to the physical\n"
    label += "motors' (in brackets: joint RMSE, standing)"
    axes.set(xscale="log", xlabel=label)
    axes.legend(frameon=False, fontsize=8)


def table(results: dict[str, Any]) -> str:
    """Markdown: one row per variant."""
    head = ["variant", f"growth in 2 ms, load {1e3 * results['loads'][0]:.1f} g·m²"]
    rows = []
    for where in ("standing", "suspended"):
        head += [f"{where}: RMSE [mrad]", "torque > 20 Hz"]
    for name, values in results["variants"].items():
        loop = ""
        if "growth" in values:
            loop = f"{values['growth'][0]:.2f} at {values['frequency'][0]:.0f} Hz"
        cells = [loop]
        for where in ("standing", "suspended"):
            ratio = values[f"{where}_torque_hf"] / results["physical"][f"{where}_torque_hf"]
            cells += [f"{1e3 * values[f'{where}_rmse']:.1f}", f"{ratio:.2f} ×"]
        rows.append([name, *cells])
    return markdown(head, rows)


def main() -> None:
    """Measure; write why.json, why.png and table.md; print the table."""
    settings = tyro.cli(Settings, description=__doc__)
    use_cpu_by_default()
    results = compute(settings)
    write_json(settings.out / "why.json", results)
    write_text(settings.out / "table.md", table(results) + "\n")
    (settings.out / "why.png").write_bytes(picture(results))
    print(table(results))


if __name__ == "__main__":
    main()
