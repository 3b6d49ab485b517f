"""Named recipes of identification."""

from __future__ import annotations

from dataclasses import dataclass

from motorprior.exceptions import ConfigError


@dataclass(frozen=True)
class Preset:
    """One recipe.

    Attributes:
        objective: ``torque`` (one-step regression, the paper's) or ``rollout`` (closed loop).
        period: sample period of the network [s].
        taps: ages of the history inputs in periods.
        has_armature: decode an armature from z for the engine.
        num_latents: size of z; 0 gives one network for all motors.
        num_neurons: per hidden layer.
        kl_weight: weight of KL(N(μ, σ²) ‖ N(0, I)) per latent, beside a loss of order 1.
        window: steps of a rollout (1 for torque regression).
        batch: windows per Adam step.
        steps: Adam steps.
        learning_rate: peak of a cosine schedule with warm-up.
    """

    objective: str
    period: float
    taps: tuple[int, ...]
    has_armature: bool
    num_latents: int = 4
    num_neurons: int = 24
    kl_weight: float = 1e-3
    window: int = 64
    batch: int = 256
    steps: int = 3000
    learning_rate: float = 3e-3


# paper_wide is the control between paper and rollout: the paper's loss on rollout's data, clock and taps.
PRESETS = {
    "paper": Preset("torque", 0.01, (0, 1, 2, 3, 4), has_armature=False, window=1, batch=1024, steps=4000),
    "rollout": Preset("rollout", 0.002, (0, 1, 2, 4, 6, 9, 13, 20), has_armature=True),
    "one_network": Preset("rollout", 0.002, (0, 1, 2, 4, 6, 9, 13, 20), has_armature=True, num_latents=0),
    "paper_wide": Preset(
        "torque", 0.002, (0, 1, 2, 4, 6, 9, 13, 20), has_armature=False, window=1, batch=1024, steps=4000
    ),
}


def identification_preset(name: str) -> Preset:
    """The recipe of that name.

    Raises:
        ConfigError: unknown name.
    """
    if name not in PRESETS:
        raise ConfigError(f"no identification preset {name!r}", remedy=f"use one of {', '.join(PRESETS)}")
    return PRESETS[name]
