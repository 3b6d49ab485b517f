"""Obeys the operations of a pickle, one by one, on plain values: Python's own `pickle` takes no part.

A pickle is a program. Here it can make texts, numbers, lists, tuples and dictionaries whose keys are texts, repeat what
it has made, and call the few stand-ins that it may name. Every operation takes time and memory in proportion to its own
length; in Python's own machine the hash of nested tuples, or of numbers chosen for it, as a key takes for ever.
"""

from __future__ import annotations

import io
import pickletools
from collections.abc import Callable, Mapping
from typing import Any

from motorprior.exceptions import LogError, shown
from motorprior.logs.formats.pickled_arrays import Constructor, PickledArray, PickledDtype
from motorprior.logs.formats.pickled_tensors import PickledStorage, PickledTensor

MAX_OPERATIONS = 1_500_000
"""A few seconds' work."""
MAX_CONTAINERS = 1_000_000
"""Lists, dictionaries and tuples: each takes a byte of a file, and up to a hundred of memory."""
_CONTAINERS = frozenset({"EMPTY_LIST", "EMPTY_DICT", "LIST", "DICT", "TUPLE", "TUPLE1", "TUPLE2", "TUPLE3"})
_VALUES = """
INT BININT BININT1 BININT2 LONG LONG1 LONG4 FLOAT BINFLOAT STRING BINSTRING SHORT_BINSTRING
BINBYTES SHORT_BINBYTES BINBYTES8 UNICODE BINUNICODE SHORT_BINUNICODE BINUNICODE8
"""
VALUES = frozenset(_VALUES.split())
"""Operations that put their own argument on the stack."""
_CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False, "EMPTY_TUPLE": ()}
_WITH_STATE = Constructor | PickledDtype | PickledArray | PickledTensor | PickledStorage


class PickleMachine:
    """A stack, the stacks below its marks, and what was made so far by number.

    Args:
        constructors: everything that the pickle may name.
        persistent: makes what a reference to something outside the pickle stands for; without it they are refused.
    """

    def __init__(
        self,
        constructors: Mapping[tuple[str, str], Constructor],
        persistent: Callable[[Any], Any] | None = None,
    ):
        self._constructors, self._persistent = constructors, persistent
        self._stack: list[Any] = []
        self._below: list[list[Any]] = []
        self._made: dict[int, Any] = {}

    def run(self, data: bytes) -> Any:
        """What the pickle describes.

        Raises:
            LogError: an operation, a name or a key that is refused, too many operations or containers, or bytes after
                the last operation.
            Exception: whatever a damaged pickle ends in.
        """
        last = containers = 0
        for count, (operation, argument, position) in enumerate(pickletools.genops(io.BytesIO(data))):
            last = position or 0
            name = operation.name
            if name in VALUES:
                self._stack.append(argument)
            elif name not in ("STOP", "PROTO", "FRAME"):
                self._obey(name, argument)
            containers += name in _CONTAINERS
            if count >= MAX_OPERATIONS:
                raise LogError(f"more than {MAX_OPERATIONS} pickle operations are refused")
            if containers > MAX_CONTAINERS:
                raise LogError(f"more than {MAX_CONTAINERS} lists, dictionaries and tuples are refused")
        if rest := data[last + 1 :].strip():
            raise LogError(f"{len(rest)} bytes follow the end of the pickle")
        (found,) = self._stack
        return found

    def _obey(self, name: str, argument: Any) -> None:
        stack, made = self._stack, self._made
        match name:
            case "EMPTY_LIST":
                stack.append([])
            case "EMPTY_DICT":
                stack.append({})
            case "NONE" | "NEWTRUE" | "NEWFALSE" | "EMPTY_TUPLE":
                stack.append(_CONSTANTS[name])
            case "BYTEARRAY8":
                stack.append(bytes(argument))
            case "PUT" | "BINPUT" | "LONG_BINPUT":
                made[int(argument)] = stack[-1]
            case "MEMOIZE":
                made[len(made)] = stack[-1]
            case "GET" | "BINGET" | "LONG_BINGET":
                stack.append(made[int(argument)])
            case "MARK":
                self._below.append(stack)
                self._stack = []
            case "LIST" | "APPEND" | "APPENDS" | "DICT" | "SETITEM" | "SETITEMS":
                self._fill(name)
            case "TUPLE":
                items = tuple(self._to_mark())
                self._stack.append(items)
            case "TUPLE1" | "TUPLE2" | "TUPLE3":
                stack.append(tuple(self._last(int(name[-1]))))
            case _:
                self._call(name, argument)

    def _fill(self, name: str) -> None:
        """Make a list or a dictionary, or put items into the last one."""
        items = self._last(1 if name == "APPEND" else 2) if name in ("APPEND", "SETITEM") else self._to_mark()
        is_list = name in ("LIST", "APPEND", "APPENDS")
        if name in ("LIST", "DICT"):
            self._stack.append([] if is_list else {})
        target = self._stack[-1]
        if type(target) is list and is_list:
            target.extend(items)
        elif type(target) is dict and not is_list:
            for key, value in zip(items[::2], items[1::2], strict=True):
                if type(key) is not str:
                    raise LogError(f"the dictionary key {shown(key)} is not a text")
                target[key] = value
        else:
            raise LogError(f"the pickle operation {name} on {type(target).__name__} is refused")

    def _call(self, name: str, argument: Any) -> None:
        """Name or call a stand-in, or tell it its state."""
        if name == "GLOBAL":
            self._stack.append(self._named(*argument.split(" ", 1)))
        elif name == "STACK_GLOBAL":
            self._stack.append(self._named(*self._last(2)))
        elif name == "REDUCE":
            function, arguments = self._last(2)
            if not isinstance(function, Constructor) or type(arguments) is not tuple:
                raise LogError(f"a call of {shown(function)} is refused")
            self._stack.append(function(*arguments))
        elif name == "BUILD":
            (state,) = self._last(1)
            if not isinstance(self._stack[-1], _WITH_STATE):
                raise LogError(f"a state for {shown(self._stack[-1])} is refused")
            self._stack[-1].__setstate__(state)
        elif name == "BINPERSID" and self._persistent is not None:
            self._stack.append(self._persistent(*self._last(1)))
        else:
            detail = f" ({argument})" if isinstance(argument, str) else ""
            raise LogError(f"the pickle operation {name}{detail} is refused")

    def _named(self, module: Any, name: Any) -> Constructor:
        known = isinstance(module, str) and isinstance(name, str)
        if not known or (module, name) not in self._constructors:
            raise LogError(f"the pickle asks for {shown(module, 100)[1:-1]}.{shown(name, 100)[1:-1]}, which is refused")
        return self._constructors[module, name]

    def _last(self, count: int) -> list[Any]:
        """Take the last items off the stack."""
        if len(self._stack) < count:
            raise LogError("the pickle takes more than it made")
        items = self._stack[-count:]
        del self._stack[-count:]
        return items

    def _to_mark(self) -> list[Any]:
        """Take everything after the last mark."""
        items, self._stack = self._stack, self._below.pop()
        return items
