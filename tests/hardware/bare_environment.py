"""`bare_environment.py MODULE ARGS…` or `-c CODE`: only the standard library and four packages can be imported."""

import dataclasses
import importlib.abc
import runpy
import sys

INSTALLED = {"numpy", "safetensors", "serial", "msgpack", "motorprior"}


class OnlyInstalled(importlib.abc.MetaPathFinder):
    """Finds no other package."""

    def find_spec(self, fullname, path=None, target=None):
        top = fullname.partition(".")[0]
        if top not in INSTALLED and top not in sys.stdlib_module_names and not top.startswith("_"):
            raise ModuleNotFoundError(f"No module named {fullname!r}", name=fullname)


if __name__ == "__main__":
    sys.meta_path.insert(0, OnlyInstalled())
    sys.argv = sys.argv[1:]
    from motorprior.robots import shipped

    late = {
        "tick_delay": 100.0,
        "late_ticks": 100,
        "stalled_time": 100.0,
        "telemetry_age": 0.5,
        "watchdog": 0.5,
    }
    (robot,) = shipped.SHIPPED
    wire = robot.require_wire()
    wire = dataclasses.replace(wire, safety=dataclasses.replace(wire.safety, **late))
    shipped.SHIPPED = (dataclasses.replace(robot, wire=wire),)  # before it is imported from there
    if sys.argv[0] == "-c":
        exec(sys.argv[1])
    else:
        runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
