"""A virtual robot in a thread of the test."""

from collections.abc import Callable
from threading import Thread

from motorprior.hardware.virtual.virtual_robot import VirtualRobot


def in_thread(robot: VirtualRobot) -> Callable[[], None]:
    """Start a virtual robot; returns a function that ends it."""
    thread = Thread(target=robot.run, daemon=True)
    thread.start()

    def end() -> None:
        robot.stop()
        thread.join(timeout=60.0)

    return end
