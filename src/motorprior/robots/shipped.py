"""The robots of the package; the first is the default."""

from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.robots.robot import Robot

SHIPPED: tuple[Robot, ...] = (PUPPER_V2,)
DEFAULT_ROBOT = SHIPPED[0].name
