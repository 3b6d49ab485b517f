"""Run a module as on the robot's own computer: nothing can be imported but the standard library and three packages.

python bare_environment.py MODULE ARGS... or python bare_environment.py -c CODE
"""

import importlib.abc
import runpy
import sys

INSTALLED = {"numpy", "serial", "msgpack", "motorprior"}


class OnlyInstalled(importlib.abc.MetaPathFinder):
    """Says of everything else that it is not there."""

    def find_spec(self, fullname, path=None, target=None):
        top = fullname.partition(".")[0]
        if top not in INSTALLED and top not in sys.stdlib_module_names and not top.startswith("_"):
            raise ModuleNotFoundError(f"No module named {fullname!r}", name=fullname)


if __name__ == "__main__":
    sys.meta_path.insert(0, OnlyInstalled())
    sys.argv = sys.argv[1:]
    if sys.argv[0] == "-c":
        exec(sys.argv[1])
    else:
        runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
