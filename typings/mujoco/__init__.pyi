# MuJoCo ships no type stubs, and its compiled module hides its names from the type checker.
from typing import Any

def __getattr__(name: str) -> Any: ...
