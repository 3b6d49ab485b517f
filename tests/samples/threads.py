"""A virtual robot in a thread of the test."""

from collections.abc import Callable
from threading import Event, Thread

from motorprior.hardware.virtual_robot import VirtualRobot


def in_thread(robot: VirtualRobot) -> Callable[[], None]:
    """Start a virtual robot; returns a function that ends it."""
    unplugged = Event()
    thread = Thread(target=robot.run, args=(unplugged.is_set,), daemon=True)
    thread.start()

    def end() -> None:
        unplugged.set()
        thread.join(timeout=60.0)

    return end
