"""Run MODULE ARGS… or -c CODE with the packages of the robot's own computer only."""

import dataclasses
import importlib.abc
import importlib.util
import runpy
import sys

TYRO = {"tyro", "docstring_parser", "typeguard", "typing_extensions"}
INSTALLED = {"numpy", "safetensors", "serial", "msgpack", "rustypot", "motorprior", *TYRO}
find_spec = importlib.util.find_spec


def is_installed(name):
    top = name.partition(".")[0]
    return top in INSTALLED or top in sys.stdlib_module_names or top.startswith("_")


class OnlyInstalled(importlib.abc.MetaPathFinder):
    """Finder that rejects packages which the robot's computer lacks."""

    def find_spec(self, fullname, path=None, target=None):
        if not is_installed(fullname):
            raise ModuleNotFoundError(f"No module named {fullname!r}", name=fullname)


if __name__ == "__main__":
    sys.meta_path.insert(0, OnlyInstalled())
    importlib.util.find_spec = lambda name: find_spec(name) if is_installed(name) else None
    sys.argv = sys.argv[1:]

    # Limits for a busy computer replace those of the shipped robot before they are imported.
    from motorprior.robots import shipped

    late = {
        "tick_delay": 100.0,
        "late_ticks": 100,
        "stalled_time": 100.0,
        "telemetry_age": 0.5,
        "watchdog": 0.5,
    }
    robot, *others = shipped.SHIPPED
    wire = robot.require_wire()
    wire = dataclasses.replace(wire, safety=dataclasses.replace(wire.safety, **late))
    shipped.SHIPPED = (dataclasses.replace(robot, wire=wire), *others)

    if sys.argv[0] == "-c":
        exec(sys.argv[1])
    else:
        runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
