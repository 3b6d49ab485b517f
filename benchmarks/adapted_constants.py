"""What a recording in the air says of a robot's motors: constants of the posterior means beside the true ones.

    python benchmarks/adapted_constants.py --prior runs/prior/prior.safetensors --out runs/constants

Virtual Puppers, recorded and adapted to as in `closing_the_loop.py`, without wear. For every excitation and every
constant that differs between motors, over the motors of all robots, to figures.json:
    EXCITATION/CONSTANT/correlation    of the found with the true values
    EXCITATION/CONSTANT/off            root mean square of the found less the true ones, of logarithms; of delay [s],
                                       load-dependent friction [-] and zero of the encoder [rad] themselves
    EXCITATION/CONSTANT/off_of_median  the same of the true motors' median in place of the found ones
and EXCITATION/robots_unlike_the_prior. Recordings and posteriors are kept.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from closing_the_loop import ROBOT, VirtualRobot, posterior_of
from motorprior.actuator.motor_posterior import MotorPosterior
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.bench.fleet import load_fleet
from motorprior.pipeline.prior_file import load_prior
from motorprior.pipeline.twin_body import draw_motors
from motorprior.signals import rmse

CONSTANTS = (
    *("kp", "kd_over_kp", "delay", "armature", "coulomb"),
    *("load_friction", "gear_stiffness", "backlash", "encoder_zero"),
)
NOT_OF_LOGARITHMS = ("delay", "load_friction", "encoder_zero")
"""They are near 0, or below."""


def true_constants(number: int) -> dict[str, np.ndarray]:
    """(joints,) each, of a virtual robot."""
    motors = draw_motors(ROBOT, load_fleet(ROBOT.fleets[0][0]), number)
    return {name: motors.kd / motors.kp if name == "kd_over_kp" else getattr(motors, name) for name in CONSTANTS}


def found_constants(prior: MotorPrior, posterior: Path) -> dict[str, np.ndarray]:
    """(joints,) each, of the posterior's means."""
    return prior.network.constants(MotorPosterior.load(posterior, prior).mean)


def compared(name: str, found: np.ndarray, true: np.ndarray) -> dict[str, float]:
    """The figures of one constant over all motors (M,)."""
    if name not in NOT_OF_LOGARITHMS:
        found, true = np.log(found), np.log(true)
    return {
        "correlation": float(np.corrcoef(found, true)[0, 1]),
        "off": float(rmse(found, true)),
        "off_of_median": float(rmse(np.median(true), true)),
    }


def main() -> None:
    """Record, adapt and compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--prior", type=Path, required=True, help="prior of the robots' fleet")
    parser.add_argument("--out", type=Path, required=True, help="folder for everything")
    parser.add_argument("--robots", type=int, default=8, help="virtual Puppers")
    parser.add_argument("--recorded", type=float, default=60.0, help="length of each recording [s]")
    parser.add_argument("--excitations", nargs="+", default=["multisine", "varied"], help="see `motorprior record`")
    given = parser.parse_args()
    prior, figures = load_prior(given.prior, ROBOT), dict[str, float]()
    for excitation in given.excitations:
        found, true, unlike = [], [], 0
        for number in range(given.robots):
            folder = given.out / excitation / f"robot_{number}"
            posterior, odd = posterior_of(VirtualRobot(number), folder, given.prior, given.recorded, excitation)
            found.append(found_constants(prior, posterior))
            true.append(true_constants(number))
            unlike += odd
        for name in CONSTANTS:
            both = (np.concatenate([each[name] for each in every]) for every in (found, true))
            figures |= {f"{excitation}/{name}/{key}": value for key, value in compared(name, *both).items()}
        figures[f"{excitation}/robots_unlike_the_prior"] = float(unlike)
    (given.out / "figures.json").write_text(json.dumps(figures, indent=1) + "\n")
    for key, value in figures.items():
        print(f"{key:48} {value:8.4f}")


if __name__ == "__main__":
    main()
