"""Standard deviation between units of a class of joints, in priors fitted to public logs.

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


def deviations(prior: MotorPrior) -> dict[str, tuple[float, float]]:
    """Standard deviations between units of a class and between the means of classes, by constant.

    Between the means it is NaN for one class.
    """
    model = prior.model
    assert isinstance(model, GreyBox)
    names = parameters_of(model.terms)
    signs = [SIGNED.get(name, 1.0) for name in names]
    outputs = model.decoder_latents(prior.mean) * signs

    rows_of_classes = [prior.classes.rows_of(name) for name in prior.classes.names]
    means = np.stack([outputs[rows].mean(axis=0) for rows in rows_of_classes])
    scatter = np.zeros(len(names))
    for rows, mean in zip(rows_of_classes, means, strict=True):
        scatter = scatter + np.sum((outputs[rows] - mean) ** 2, axis=0)

    within = np.sqrt(scatter / (len(outputs) - len(rows_of_classes)))
    between = np.full(len(names), np.nan)
    if len(rows_of_classes) > 1:
        between = means.std(axis=0, ddof=1)
    pairs = zip(within.tolist(), between.tolist(), strict=True)
    return dict(zip(names, pairs, strict=True))


def main() -> None:
    """Print a table per prior."""
    for path in tyro.cli(tuple[Path, ...], description=__doc__):
        prior = MotorPrior.load(path)
        units = {name: len(prior.classes.rows_of(name)) for name in prior.classes.names}
        print(f"{prior.motor}, {prior.robot}: units per class {units}")
        for name, (within, between) in deviations(prior).items():
            print(f"  {name:20} between units {within:.3f}  between classes {between:.3f}")


if __name__ == "__main__":
    main()
