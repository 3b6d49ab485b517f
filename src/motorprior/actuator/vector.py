"""Vector arithmetic with ordinary operators, for the intrinsics that emit compiled code.

LLVM does not vectorise a loop over the columns of (rows, motors) arrays: it would have to prove
that no two of about thirty rows overlap. A `Vector` is a value of the emitted code with one lane
per motor. Operations are emitted in the order in which they are written and never contracted, so
every width gives the bytes of the scalar loop.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import cgutils

from motorprior.actuator.geared_motor_step import Arithmetic

_DOUBLE = ir.DoubleType()
FLOAT = ir.FloatType()
_BYTES = {_DOUBLE: 8, FLOAT: 4}


def _operator(instruction: str) -> Callable[[Vector, Vector | float], Vector]:
    def apply(self: Vector, other: Vector | float) -> Vector:
        emit = getattr(self.builder, instruction)
        return Vector(self.builder, emit(self.value, _operand(other, self.value.type)))

    return apply


class Vector:
    """An LLVM vector of floating-point numbers, or the bits of a comparison: a value of the code of a builder."""

    def __init__(self, builder: Any, value: Any):
        self.builder = builder
        self.value = value

    @classmethod
    def broadcast(cls, builder: Any, scalar: Any, width: int) -> Vector:
        """A scalar of the code in every lane."""
        kind = ir.VectorType(scalar.type, width)
        single = builder.insert_element(
            ir.Constant(kind, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0)
        )
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), width), [0] * width)
        return cls(builder, builder.shuffle_vector(single, ir.Constant(kind, ir.Undefined), zeros))

    @classmethod
    def load(cls, builder: Any, address: Any, width: int, element: Any = _DOUBLE) -> Vector:
        """Load from an integer address."""
        pointer = builder.inttoptr(address, ir.VectorType(element, width).as_pointer())
        return cls(builder, builder.load(pointer, align=_BYTES[element]))

    def store(self, address: Any) -> None:
        """Store to an integer address."""
        kind = self.value.type
        self.builder.store(
            self.value,
            self.builder.inttoptr(address, kind.as_pointer()),
            align=_BYTES[kind.element],
        )

    __add__ = _operator("fadd")
    __sub__ = _operator("fsub")
    __mul__ = _operator("fmul")
    __truediv__ = _operator("fdiv")
    # commutative, to the last bit
    __radd__ = __add__
    __rmul__ = __mul__

    def __rsub__(self, other: float) -> Vector:
        return Vector(self.builder, self.builder.fsub(_operand(other, self.value.type), self.value))

    def __neg__(self) -> Vector:
        return Vector(self.builder, self.builder.fneg(self.value))

    def __abs__(self) -> Vector:
        return self.call("fabs", self)

    def __gt__(self, other: Vector | float) -> Vector:
        return Vector(
            self.builder,
            self.builder.fcmp_ordered(">", self.value, _operand(other, self.value.type)),
        )

    def __lt__(self, other: Vector | float) -> Vector:
        return Vector(
            self.builder,
            self.builder.fcmp_ordered("<", self.value, _operand(other, self.value.type)),
        )

    def __or__(self, other: Vector) -> Vector:
        return Vector(self.builder, self.builder.or_(self.value, other.value))

    def call(self, name: str, *arguments: Vector) -> Vector:
        """Result of an LLVM intrinsic on vectors of this type."""
        kind = self.value.type
        function = ir.FunctionType(kind, [kind] * len(arguments))
        full_name = f"llvm.{name}.v{kind.count}f{8 * _BYTES[kind.element]}"
        found = cgutils.get_or_insert_function(self.builder.module, function, full_name)
        return Vector(self.builder, self.builder.call(found, [each.value for each in arguments]))


def _operand(value: Vector | float, kind: Any) -> Any:
    return (
        value.value if isinstance(value, Vector) else ir.Constant(kind, [float(value)] * kind.count)
    )


def _where(condition: Vector, yes: Vector | float, no: Vector | float) -> Vector:
    kind = ir.VectorType(_DOUBLE, condition.value.type.count)
    chosen = condition.builder.select(condition.value, _operand(yes, kind), _operand(no, kind))
    return Vector(condition.builder, chosen)


def _clip(x: Vector, limit: Vector) -> Vector:
    """Within ±limit; NaN stays NaN."""
    above = x > limit
    below = x < -limit
    return _where(above, limit, _where(below, -limit, x))


LANE_ARITHMETIC = Arithmetic(
    where=_where,
    indicator=lambda condition: _where(condition, 1.0, 0.0),
    clip=_clip,
    positive_part=lambda x: _where(x > 0.0, x, 0.0 * x),
    with_sign_of=lambda magnitude, other: magnitude.call("copysign", magnitude, other),
    sqrt=lambda x: x.call("sqrt", x),
)
