"""Arrays without reference counts, for compiled loops.

Numba counts references of an array whenever it takes one out of a tuple or cuts a view from it, with an atomic
instruction each time: a tenth of an episode (docs/speed.md). The caller of a compiled episode holds every array
until it returns, so nothing needs counting inside.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from numba import types
from numba.core import cgutils
from numba.core.imputils import impl_ret_untracked
from numba.extending import intrinsic

Arrays = TypeVar("Arrays")


def _borrow(context, builder, kind, value):
    """The same value with every array's owner forgotten."""
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value=value)
        array.meminfo = cgutils.get_null_value(array.meminfo.type)
        array.parent = cgutils.get_null_value(array.parent.type)
        return array._getvalue()
    if isinstance(kind, types.BaseTuple):
        parts = [
            _borrow(context, builder, inner, builder.extract_value(value, index))
            for index, inner in enumerate(kind.types)  # pyright: ignore[reportAttributeAccessIssue]
        ]
        return context.make_tuple(builder, kind, parts)
    return value


@intrinsic
def _borrowed(typingctx: Any, arrays: Any) -> Any:
    """Typing and code of `borrowed`."""

    def codegen(context, builder, signature, arguments):
        value = _borrow(context, builder, signature.args[0], arguments[0])
        return impl_ret_untracked(context, builder, signature.return_type, value)

    return arrays(arrays), codegen


borrowed: Callable[[Arrays], Arrays] = _borrowed
"""For compiled code: an array, or a (named) tuple with arrays in it, whose owner outlives the use of the result."""
