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
    """A value of a builder's code: an LLVM vector of numbers, or the bits of a comparison."""

    def __init__(self, builder: Any, value: Any):
        self.builder = builder
        self.value = value

    @classmethod
    def broadcast(cls, builder: Any, scalar: Any, width: int) -> Vector:
        """A scalar of the code in every lane."""
        vector_type = ir.VectorType(scalar.type, width)
        undefined = ir.Constant(vector_type, ir.Undefined)
        first_lane = builder.insert_element(undefined, scalar, ir.Constant(ir.IntType(32), 0))
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), width), [0] * width)
        return cls(builder, builder.shuffle_vector(first_lane, undefined, zeros))

    @classmethod
    def load(cls, builder: Any, address: Any, width: int, element: Any = _DOUBLE) -> Vector:
        """Load from an integer address."""
        pointer = builder.inttoptr(address, ir.VectorType(element, width).as_pointer())
        return cls(builder, builder.load(pointer, align=_BYTES[element]))

    def store(self, address: Any) -> None:
        """Store to an integer address."""
        vector_type = self.value.type
        pointer = self.builder.inttoptr(address, vector_type.as_pointer())
        self.builder.store(self.value, pointer, align=_BYTES[vector_type.element])

    __add__ = _operator("fadd")
    __sub__ = _operator("fsub")
    __mul__ = _operator("fmul")
    __truediv__ = _operator("fdiv")
    # commutative, to the last bit
    __radd__ = __add__
    __rmul__ = __mul__

    def __rsub__(self, other: float) -> Vector:
        minuend = _operand(other, self.value.type)
        return Vector(self.builder, self.builder.fsub(minuend, self.value))

    def __neg__(self) -> Vector:
        return Vector(self.builder, self.builder.fneg(self.value))

    def __abs__(self) -> Vector:
        return self.call("fabs", self)

    def __gt__(self, other: Vector | float) -> Vector:
        return self._compared(">", other)

    def __lt__(self, other: Vector | float) -> Vector:
        return self._compared("<", other)

    def _compared(self, operator: str, other: Vector | float) -> Vector:
        operand = _operand(other, self.value.type)
        return Vector(self.builder, self.builder.fcmp_ordered(operator, self.value, operand))

    def __or__(self, other: Vector) -> Vector:
        return Vector(self.builder, self.builder.or_(self.value, other.value))

    def call(self, name: str, *arguments: Vector) -> Vector:
        """Result of an LLVM intrinsic on vectors of this type."""
        vector_type = self.value.type
        function_type = ir.FunctionType(vector_type, [vector_type] * len(arguments))
        full_name = f"llvm.{name}.v{vector_type.count}f{8 * _BYTES[vector_type.element]}"
        function = cgutils.get_or_insert_function(self.builder.module, function_type, full_name)
        values = [argument.value for argument in arguments]
        return Vector(self.builder, self.builder.call(function, values))


def _operand(value: Vector | float, vector_type: Any) -> Any:
    if isinstance(value, Vector):
        return value.value
    return ir.Constant(vector_type, [float(value)] * vector_type.count)


def _where(mask: Vector, yes: Vector | float, no: Vector | float) -> Vector:
    vector_type = ir.VectorType(_DOUBLE, mask.value.type.count)
    if_true = _operand(yes, vector_type)
    if_false = _operand(no, vector_type)
    return Vector(mask.builder, mask.builder.select(mask.value, if_true, if_false))


def _clip(x: Vector, limit: Vector) -> Vector:
    """Within ±limit; NaN stays NaN."""
    above = x > limit
    below = x < -limit
    return _where(above, limit, _where(below, -limit, x))


LANE_ARITHMETIC = Arithmetic(
    where=_where,
    indicator=lambda mask: _where(mask, 1.0, 0.0),
    clip=_clip,
    positive_part=lambda x: _where(x > 0.0, x, 0.0 * x),
    with_sign_of=lambda magnitude, other: magnitude.call("copysign", magnitude, other),
    sqrt=lambda x: x.call("sqrt", x),
)
