"""All actuator models. A new one describes itself in its own file and gets one entry here."""

from __future__ import annotations

from motorprior.actuator.foreign_step import FOREIGN
from motorprior.actuator.friction_pd import FRICTION_PD
from motorprior.actuator.grey_box import GREY_BOX
from motorprior.actuator.ideal_pd import IDEAL_PD
from motorprior.actuator.kind import ActuatorKind, Model
from motorprior.actuator.latent import LATENT
from motorprior.actuator.physical import PHYSICAL
from motorprior.exceptions import ConfigError

KINDS: tuple[ActuatorKind, ...] = (IDEAL_PD, FRICTION_PD, PHYSICAL, LATENT, GREY_BOX, FOREIGN)


def models() -> dict[str, Model]:
    """Every name under which motors of these kinds appear in tables, in the order of KINDS."""
    return {model.name: model for kind in KINDS for model in kind.models}


def title(name: str) -> str:
    """What a reader sees in place of ``name``.

    Raises:
        ConfigError: no actuator has that name.
    """
    return _model(name).title


def colour(name: str) -> str:
    """Of the model in tables and plots, #rrggbb.

    Raises:
        ConfigError: no actuator has that name.
    """
    return _model(name).colour


def _model(name: str) -> Model:
    known = models()
    if name not in known:
        raise ConfigError(f"no actuator model {name!r}", remedy=f"use one of {', '.join(known)}")
    return known[name]
