"""Spread between units of a class of joints, from priors that were fitted to public logs.

    python benchmarks/unit_spread.py runs/real/go2/traj_0/prior/prior.safetensors …

Per prior and constant: the standard deviation of its logarithm (of encoder_zero [rad]) between the
training motors of a class of joints, pooled over the classes, and between the means of the classes.
It contains errors of the fits, so it is an upper bound. Servos of an arm (one class) differ by
their places, too. These are the sources of `standardise.ASSUMED_STD` and ASSUMED_BETWEEN: the
Unitree Go2, and the Stanford Pupper by `motorprior calibrate`.
"""

from pathlib import Path

import numpy as np
import tyro

from motorprior.actuator.geared_motor_step import parameters_of
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.motor_prior import MotorPrior
from motorprior.actuator.optional_terms import SIGNED


def spreads(prior: MotorPrior) -> dict[str, tuple[float, float]]:
    """Standard deviations between units of a class and between the means of classes (NaN for one), by constant."""
    model = prior.model
    groups = [prior.classes.rows_of(name) for name in prior.classes.names]
    assert isinstance(model, GreyBox)
    names = parameters_of(model.terms)
    outputs = model.decoder_latents(prior.mean) * [SIGNED.get(name, 1.0) for name in names]
    means = np.stack([outputs[rows].mean(axis=0) for rows in groups])
    scatter = sum(
        np.sum((outputs[rows] - outputs[rows].mean(axis=0)) ** 2, axis=0) for rows in groups
    )
    within = np.sqrt(scatter / (len(outputs) - len(groups)))
    between = means.std(axis=0, ddof=1) if len(groups) > 1 else np.full(len(names), np.nan)
    return {name: (float(a), float(b)) for name, a, b in zip(names, within, between, strict=True)}


def main() -> None:
    """Print a table per prior."""
    for path in tyro.cli(tuple[Path, ...], description=__doc__):
        prior = MotorPrior.load(path)
        units = {name: len(prior.classes.rows_of(name)) for name in prior.classes.names}
        print(f"{prior.motor}, {prior.robot}: units per class {units}")
        for name, (within, between) in spreads(prior).items():
            print(f"  {name:20} between units {within:.3f}  between classes {between:.3f}")


if __name__ == "__main__":
    main()
