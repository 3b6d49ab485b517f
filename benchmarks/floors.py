"""Error floors of a motor prior: grey boxes with the true constants compared with the physical motors.

    python benchmarks/floors.py --fleet mixed --json floors.json

The errors are due to the step of 2 ms, the sample of 32 motors of a fleet, and contact. Figures:
    two_sample_auc                         256 grey boxes against 256 other motors of the fleet on the standard bench
    two_sample_auc/SAMPLER/N               the same for 256 samples of a distribution fitted to the constants of N
                                           motors, a gaussian or the copula of a prior; median of SETS sets of motors
    displacement_m/DAMPING_RATIO           distance between trotting robots after 2 s, grey boxes at 2 ms with this
                                           damping ratio of the foot contacts, physical motors at 1 ms and ratio 1
    rmse_rad/…, torque_hf_ratio/…          of the joints; torque above 20 Hz over that of the physical motors
    …/suspended                            the same without contact
Medians of 12 trots.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from figures import report
from motorprior.actuator.geared_motor import GearedMotor
from motorprior.actuator.geared_motor_step import PARAMETERS, ZERO_SCALE
from motorprior.actuator.grey_box import GreyBox, GreyBoxActuator
from motorprior.actuator.physical import MotorParameters, PhysicalActuator
from motorprior.bench.behaviour import behaviours
from motorprior.bench.families import require_geared
from motorprior.bench.fleet import load_fleet
from motorprior.identification.held_out import two_sample_auc
from motorprior.identification.latents.standardise import standardised
from motorprior.robots.build_model import CONTACT_TIME
from motorprior.robots.pupper_v2 import spec
from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.simulation.playback import replay
from motorprior.simulation.world import World
from motorprior.studies.robot_fidelity import STEPS, compare, trot_targets

DAMPING_RATIOS = (1.0, 1.5, 2.0, 3.0)
TROTS, POPULATION, MIN_CONSTANT = 12, 256, 1e-6
NUM_FITTED, SETS = (32, 128), 7


def true_grey_box(motors: MotorParameters) -> GreyBoxActuator:
    """Grey boxes with these constants, one latent per constant."""
    values = {name: getattr(motors, name) for name in PARAMETERS if name != "kd_over_kp"}
    values["kd_over_kp"] = motors.kd / motors.kp
    raw = np.stack([np.log(np.maximum(values[name], MIN_CONSTANT)) for name in PARAMETERS], axis=1)
    raw[:, -1] = motors.encoder_zero / ZERO_SCALE
    box = GreyBox(GearedMotor(raw.mean(axis=0), np.eye(len(PARAMETERS))), spec.PHYSICS_DT)
    return GreyBoxActuator(box, raw - raw.mean(axis=0))


def gaussian(given: GreyBoxActuator, rng: np.random.Generator) -> GreyBoxActuator:
    """Samples of a Gaussian with mean and covariance of the given motors."""
    z = rng.multivariate_normal(given.z.mean(axis=0), np.cov(given.z.T), POPULATION)
    return GreyBoxActuator(given.model, z)


def copula(given: GreyBoxActuator, rng: np.random.Generator) -> GreyBoxActuator:
    """Samples of the copula that a prior fits to the given motors."""
    box, _ = standardised(given.model, given.z)
    assert isinstance(box, GreyBox)
    return GreyBoxActuator(box, rng.standard_normal((POPULATION, len(PARAMETERS))))


def bench_aucs(fleet_name: str) -> dict[str, float]:
    """Two-sample AUC between motors of the fleet and grey boxes on the standard bench."""
    fleet, rng = load_fleet(fleet_name), np.random.default_rng(1)

    def auc(boxes: GreyBoxActuator) -> float:
        physical = fleet.sample(POPULATION, rng).actuator()
        return two_sample_auc(behaviours(boxes).values, behaviours(physical).values, 0)

    figures = {"two_sample_auc": auc(true_grey_box(require_geared(fleet.sample(POPULATION, rng))))}
    for count in NUM_FITTED:
        given = [true_grey_box(require_geared(fleet.sample(count, rng))) for _ in range(SETS)]
        for sampler in (gaussian, copula):
            areas = [auc(sampler(motors, rng)) for motors in given]
            figures[f"two_sample_auc/{sampler.__name__}/{count}"] = float(np.median(areas))
    return figures


def robot_floor(fleet_name: str, suspended: bool, damping_ratio: float) -> tuple[float, float, float]:
    """Joint error [rad], ratio of torque above 20 Hz, and distance of the bases [m]: medians over TROTS."""
    fine = World(PUPPER_V2, physics_dt=spec.TWIN_PHYSICS_DT, suspended=suspended)
    coarse, rows = World(PUPPER_V2, suspended=suspended), []
    coarse.model.pair_solref[:] = CONTACT_TIME, damping_ratio
    for trot in range(TROTS):
        rng = np.random.default_rng([2, trot])
        motors = require_geared(load_fleet(fleet_name).sample(spec.NUM_JOINTS, rng))
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
    report(figures, arguments.json)


if __name__ == "__main__":
    main()
