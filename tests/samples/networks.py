"""A network of a latent actuator with random weights."""

from dataclasses import replace
from typing import Any

import numpy as np

from motorprior.actuator.latent import LatentNetwork


def network(
    neurons: int = 8, latents: int = 3, taps: tuple[int, ...] = (0, 2, 5), **changes: Any
) -> LatentNetwork:
    """Network with softsign layers of ``neurons``; ``changes`` are fields of `LatentNetwork`."""
    rng = np.random.default_rng(0)
    inputs = 2 * len(taps)
    shapes = {
        "w1": (inputs, neurons),
        "v1": (latents, neurons),
        "b1": (neurons,),
        "w2": (neurons, neurons),
        "b2": (neurons,),
        "w3": (neurons,),
        "armature_slope": (latents,),
    }
    made = LatentNetwork(
        **{name: rng.standard_normal(shape) for name, shape in shapes.items()},
        b3=np.array(-0.3),
        log_armature=np.array(np.log(0.002)),
        taps=taps,
        period=0.002,
        error_scale=0.2,
        velocity_scale=3.0,
        torque_scale=0.7,
        torque_limit=10.0,
        has_armature=True,
    )
    return replace(made, **changes)
