"""Floors of a motor prior's errors: grey boxes with the true constants against the physical motors.

    python benchmarks/floors.py --fleet mixed --json floors.json

What a step of 2 ms costs, what is known of a fleet from 32 of its motors, and what contact adds. A flat map:
    two_sample_auc                         256 such motors against 256 others of the fleet on the standard bench
    two_sample_auc/SAMPLER/N               the same for 256 draws of a SAMPLER of the constants of N true motors: a
                                           gaussian with their mean and covariance, or the copula of a prior; median of
                                           SETS sets of N motors
    displacement_m/DAMPING_RATIO           of the trotting robot after 2 s, from that of the physical motors at 1 ms
    rmse_rad/…, torque_hf_ratio/…          of the joints, and torque above 20 Hz over the physical motors' own
    …/suspended                                 the same without contact
for feet whose contacts have that damping ratio in the model of 2 ms; in the model of 1 ms it is 1. Medians of 12 trots.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from motorprior.actuator.geared_motor import GearedMotor
from motorprior.actuator.geared_motor_constants import PARAMETERS, ZERO_SCALE
from motorprior.actuator.latent import LatentActuator, LatentNetwork
from motorprior.actuator.physical import MotorParameters, PhysicalActuator
from motorprior.artifacts import write_json
from motorprior.bench.behaviour import behaviours
from motorprior.bench.families import geared
from motorprior.bench.fleet import load_fleet
from motorprior.identification.evaluation.distribution import two_sample_auc
from motorprior.identification.latents.standardise import standardised
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.build_model import CONTACT_TIME
from motorprior.simulation.playback import replay
from motorprior.simulation.world import World
from motorprior.simulation.world_config import WorldConfig
from motorprior.transfer.robot_fidelity import STEPS, compare, trot_targets

DAMPING_RATIOS = (1.0, 1.5, 2.0, 3.0)
TROTS, POPULATION, NEURONS, SMALLEST = 12, 256, 4, 1e-6
KNOWN, SETS = (32, 128), 7


def true_grey_box(motors: MotorParameters) -> LatentActuator:
    """Grey boxes with these constants, one latent per constant, and a network that gives 0 N·m."""
    values = {name: getattr(motors, name) for name in PARAMETERS if name != "kd_over_kp"}
    values["kd_over_kp"] = motors.kd / motors.kp
    raw = np.stack([np.log(np.maximum(values[name], SMALLEST)) for name in PARAMETERS], axis=1)
    raw[:, -1] = motors.encoder_zero / ZERO_SCALE
    size, nothing = len(PARAMETERS), np.zeros
    network = LatentNetwork(
        w1=nothing((2, NEURONS)), v1=nothing((size, NEURONS)), b1=nothing(NEURONS), w2=nothing((NEURONS, NEURONS)),
        b2=nothing(NEURONS), w3=nothing(NEURONS), b3=nothing(()), log_armature=nothing(()),
        armature_slope=nothing(size), taps=(0,), period=spec.PHYSICS_DT, error_scale=1.0, velocity_scale=1.0,
        torque_scale=1.0, torque_limit=1.0, has_armature=False, motor=GearedMotor(raw.mean(axis=0), np.eye(size)),
    )  # fmt: skip
    return LatentActuator(network, raw - raw.mean(axis=0))


def gaussian(known: LatentActuator, rng: np.random.Generator) -> LatentActuator:
    """Draws of a Gaussian with the known motors' mean and covariance."""
    z = rng.multivariate_normal(known.z.mean(axis=0), np.cov(known.z.T), POPULATION)
    return LatentActuator(known.network, z)


def copula(known: LatentActuator, rng: np.random.Generator) -> LatentActuator:
    """Draws as a prior makes them, from the known motors."""
    network, _ = standardised(known.network, known.z)
    return LatentActuator(network, rng.standard_normal((POPULATION, len(PARAMETERS))))


def bench_aucs(fleet_name: str) -> dict[str, float]:
    """Two-sample AUC between motors of the fleet and grey boxes on the standard bench."""
    fleet, rng = load_fleet(fleet_name), np.random.default_rng(1)

    def auc(boxes: LatentActuator) -> float:
        physical = fleet.sample(POPULATION, rng).actuator()
        return two_sample_auc(behaviours(boxes).values, behaviours(physical).values, 0)

    figures = {"two_sample_auc": auc(true_grey_box(geared(fleet.sample(POPULATION, rng))))}
    for count in KNOWN:
        known = [true_grey_box(geared(fleet.sample(count, rng))) for _ in range(SETS)]
        for sampler in (gaussian, copula):
            areas = [auc(sampler(motors, rng)) for motors in known]
            figures[f"two_sample_auc/{sampler.__name__}/{count}"] = float(np.median(areas))
    return figures


def robot_floor(fleet_name: str, suspended: bool, damping_ratio: float) -> tuple[float, float, float]:
    """Joint error [rad], ratio of chatter, and distance of the bases [m]: medians over TROTS."""
    fine = World(WorldConfig.of(PUPPER_V2, physics_dt=spec.TWIN_PHYSICS_DT, suspended=suspended))
    coarse, rows = World(WorldConfig.of(PUPPER_V2, suspended=suspended)), []
    coarse.model.pair_solref[:] = CONTACT_TIME, damping_ratio
    for trot in range(TROTS):
        rng = np.random.default_rng([2, trot])
        motors = geared(load_fleet(fleet_name).sample(spec.NUM_JOINTS, rng))
        targets = trot_targets(PUPPER_V2, rng, STEPS)
        truth = replay(fine, PhysicalActuator(motors), targets)
        found = replay(coarse, true_grey_box(motors), targets)
        error, chatter, apart = compare(found, truth, spec.CONTROL_DT)
        rows.append((error, chatter / compare(truth, truth, spec.CONTROL_DT)[1], apart))
    error, ratio, apart = np.median(rows, axis=0)
    return float(error), float(ratio), float(apart)


def main() -> None:
    """Measure, print and write; see the module docstring."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fleet", default="mixed")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    figures = bench_aucs(arguments.fleet)
    cases = [(False, ratio, f"{ratio:g}") for ratio in DAMPING_RATIOS] + [(True, 1.0, "suspended")]
    for suspended, ratio, name in cases:
        error, hf, apart = robot_floor(arguments.fleet, suspended, ratio)
        figures |= {f"rmse_rad/{name}": error, f"torque_hf_ratio/{name}": hf, f"displacement_m/{name}": apart}
    for name, value in figures.items():
        print(f"{name:28s} {value:.4f}")
    if arguments.json:
        write_json(arguments.json, figures)


if __name__ == "__main__":
    main()
