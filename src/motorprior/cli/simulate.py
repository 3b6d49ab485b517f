"""``motorprior simulate``: a motor log of a simulated robot under an excitation."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

import tyro

from motorprior.pipeline.motor_choice import MotorChoice
from motorprior.pipeline.simulate import Simulate


@dataclass(frozen=True)
class SimulateCommand(Simulate):
    """Excite a simulated robot, with a fixed base or suspended, and record a motor log."""

    motors: Annotated[MotorChoice, tyro.conf.arg(name="")] = field(default_factory=MotorChoice)
