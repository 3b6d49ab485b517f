"""The robots that come with the library, and the one that is meant when none is named."""

from __future__ import annotations

from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.robots.robot import Robot

SHIPPED: tuple[Robot, ...] = (PUPPER_V2,)
DEFAULT_ROBOT = SHIPPED[0].name
