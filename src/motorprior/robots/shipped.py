"""The robots of the package; the first is the default."""

from motorprior.robots.pupper_v2.robot import PUPPER_V2
from motorprior.robots.robot import Robot
from motorprior.robots.so101.robot import SO101

SHIPPED: tuple[Robot, ...] = (PUPPER_V2, SO101)
DEFAULT_ROBOT = SHIPPED[0].name
