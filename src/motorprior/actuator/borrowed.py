"""Arrays without reference counts, for compiled loops.

Numba counts references of an array whenever it takes one out of a tuple or cuts a view from it, with an atomic
instruction each time: a tenth of an episode (docs/speed.md). The caller of a compiled episode holds every array
until it returns, so nothing needs counting inside.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

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


if TYPE_CHECKING:

    def borrowed(arrays: Arrays) -> Arrays:
        """For compiled code: an array, or a (named) tuple with arrays in it, whose owner outlives the result."""
        ...

else:

    @intrinsic
    def borrowed(typingctx: Any, arrays: Any) -> Any:
        """See above."""

        def codegen(context, builder, signature, arguments):
            value = _borrow(context, builder, signature.args[0], arguments[0])
            return impl_ret_untracked(context, builder, signature.return_type, value)

        return arrays(arrays), codegen
