"""Decoders of geared motors around a small servo."""

import numpy as np

from motorprior.actuator.geared_motor_step import parameters_of
from motorprior.actuator.grey_box import GreyBox
from motorprior.actuator.optional_terms import INITIAL, SIGNED

SMALL_SERVO = {
    "kp": 10.0,
    "kd_over_kp": 0.09,
    "velocity_filter": 0.003,
    "delay": 0.008,
    "torque_limit": 1.5,
    "armature": 0.002,
    "coulomb": 0.06,
    "stribeck_torque": 0.01,
    "viscous_damping": 0.004,
    "load_friction": 0.2,
    "gear_stiffness": 70.0,
    "backlash": 0.015,
    "gear_damping": 0.03,
}
"""Constants of the central motor in SI units."""


def make_grey_box(
    spread: float = 0.2,
    latents: int = 3,
    seed: int = 0,
    terms: tuple[str, ...] = (),
    **constants: float,
) -> GreyBox:
    """Decoder with random directions of its latents.

    ``spread`` is the deviation of the logarithms per latent; ``constants`` replace constants of
    the central motor [SI].
    """
    rng = np.random.default_rng(seed)
    values = {"encoder_zero": 0.0} | SMALL_SERVO | INITIAL | constants
    names = parameters_of(terms)
    center = np.zeros(len(names))
    for index, name in enumerate(names):
        if name in SIGNED:
            center[index] = values[name] / SIGNED[name]
        else:
            center[index] = np.log(max(values[name], np.exp(-50.0)))

    return GreyBox(center, spread * rng.standard_normal((latents, len(names))), 0.002, terms)
