"""Named recipes of identification."""

from __future__ import annotations

from dataclasses import dataclass

from motorprior.actuator.kind import Model
from motorprior.exceptions import ConfigError


@dataclass(frozen=True)
class Preset:
    """One recipe.

    Attributes:
        objective: ``torque`` (one-step regression, the paper's) or ``rollout`` (closed loop).
        period: sample period of the network [s].
        taps: ages of the history inputs in periods.
        has_armature: decode an armature from z for the engine.
        grey_box: decode the constants of a geared motor from z; the network adds what they leave over.
        num_latents: size of z; 0 gives one network for all motors.
        num_neurons: per hidden layer.
        kl_weight: of KL(N(μ, σ²) ‖ N(0, I)), summed over latents, mean over motors, beside a loss of order 1; without
            noise only its ½|μ|² is left.
        warm_up: steps before a window in which the motor follows the recorded joint, so that its hidden state settles;
            a short one teaches too little friction, with which a wrong state is forgotten sooner.
        window: steps of a rollout (1 for torque regression).
        noisy: draw z from the motors' posteriors in training, as the paper does; otherwise it is their mean. Noise
            hides what the logs say only faintly, such as dry friction beside viscous.
        batch: windows per Adam step.
        steps: Adam steps.
        learning_rate: peak of a cosine schedule with warm-up.
        own_latents: each latent scales one of the 14 constants; otherwise the decoder mixes them.
        per_motor: every motor has constants of its own, one latent each, without backlash or network.
        standardise: after the training each latent becomes N(0, 1) among the training motors, and their posteriors a
            Laplace approximation (`posterior`).
    """

    objective: str
    period: float
    taps: tuple[int, ...]
    has_armature: bool
    grey_box: bool = False
    num_latents: int = 4
    num_neurons: int = 24
    kl_weight: float = 1e-3
    warm_up: int = 0
    window: int = 64
    noisy: bool = True
    batch: int = 256
    steps: int = 3000
    learning_rate: float = 3e-3
    own_latents: bool = False
    per_motor: bool = False
    standardise: bool = False

    @property
    def history(self) -> int:
        """Steps of a window before its first free one."""
        return max(self.taps[-1], self.warm_up)


_TAPS = (0, 1, 2, 4, 6, 9, 13, 20)
# Baselines: one_motor is rollout without a latent: the best single set of constants. per_motor fits a servo with
# delay, friction and rotor, but no backlash, to every motor by itself (in the manner of PACE, Bjelonic et al., 2025).
# latent_network is rollout without the physics: the network gives all of the torque, z also the armature; one_network
# is that without a latent. actuator_net is the recipe of Hwangbo et al., Science Robotics 4, 2019: three taps,
# softsign, torque regression. paper_wide is the control between paper and rollout: the paper's loss on rollout's data,
# clock and taps.
PRESETS = {
    "paper": Preset("torque", 0.01, (0, 1, 2, 3, 4), has_armature=False, window=1, batch=1024, steps=4000),
    "rollout": Preset(
        "rollout", 0.002, _TAPS, has_armature=False, grey_box=True, num_latents=14, num_neurons=8, kl_weight=1e-4,
        warm_up=120, noisy=False, steps=4000, learning_rate=1e-2, own_latents=True, standardise=True,
    ),
    "one_motor": Preset(
        "rollout", 0.002, _TAPS, has_armature=False, grey_box=True, num_latents=0, num_neurons=8, warm_up=90,
        learning_rate=1e-2,
    ),
    "per_motor": Preset(
        "rollout", 0.002, (0,), has_armature=False, grey_box=True, num_latents=14, num_neurons=4, kl_weight=0.0,
        warm_up=90, noisy=False, learning_rate=1e-2, own_latents=True, per_motor=True, standardise=True,
    ),
    "latent_network": Preset("rollout", 0.002, _TAPS, has_armature=True, standardise=True),
    "one_network": Preset("rollout", 0.002, _TAPS, has_armature=True, num_latents=0),
    "actuator_net": Preset(
        "torque", 0.002, (0, 5, 10), has_armature=False, num_latents=0, num_neurons=32, window=1, batch=1024, steps=4000
    ),
    "paper_wide": Preset("torque", 0.002, _TAPS, has_armature=False, window=1, batch=1024, steps=4000),
}  # fmt: skip
MODELS = (
    Model("paper", "paper", "#cf3b3b"),
    Model("rollout", "rollout", "#2563c9"),
    Model("one_motor", "one motor", "#7d4fa8"),
    Model("per_motor", "per motor", "#7d4fa8"),
    Model("latent_network", "latent network", "#7d4fa8"),
    Model("one_network", "one network", "#1a9a8b"),
    Model("actuator_net", "actuator net", "#7d4fa8"),
    Model("paper_wide", "paper, wide", "#e08a1e"),
)
"""How the motors of each recipe are shown; not part of the recipe, whose fields are the key of what it has made."""


def identification_preset(name: str) -> Preset:
    """The recipe of that name.

    Raises:
        ConfigError: unknown name.
    """
    if name not in PRESETS:
        raise ConfigError(f"no identification preset {name!r}", remedy=f"use one of {', '.join(PRESETS)}")
    return PRESETS[name]
