"""Arithmetic on several float64 at once, spelled as usual, for the intrinsics that build compiled code.

LLVM does not vectorise a loop over the columns of (rows, motors) arrays: it would have to prove that no two of some
thirty rows overlap. A `Vector` is a value of the code being built, one lane per motor. Operations are emitted in the
order they are written and never contracted, so that every width gives the bytes of the scalar loop.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils

from motorprior.actuator.geared_motor_step import Arithmetic

_FLOAT = ir.DoubleType()
BYTES = 8  # Of a float64


class Vector:
    """``width`` float64, or the bits of a comparison.

    Args:
        builder: of the code (llvmlite).
        value: of an LLVM vector type.
    """

    def __init__(self, builder: Any, value: Any):
        self.builder, self.value = builder, value

    @classmethod
    def broadcast(cls, builder: Any, scalar: Any, width: int) -> Vector:
        """A scalar of the code in every lane."""
        kind = ir.VectorType(_FLOAT, width)
        single = builder.insert_element(ir.Constant(kind, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0))
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), width), [0] * width)
        return cls(builder, builder.shuffle_vector(single, ir.Constant(kind, ir.Undefined), zeros))

    @classmethod
    def load(cls, builder: Any, address: Any, width: int) -> Vector:
        """From an integer address."""
        return cls(builder, builder.load(_pointer(builder, address, width), align=BYTES))

    def store(self, address: Any) -> None:
        """To an integer address."""
        self.builder.store(self.value, _pointer(self.builder, address, self.value.type.count), align=BYTES)

    def __add__(self, other: Vector | float) -> Vector:
        return self._new("fadd", self, other)

    def __sub__(self, other: Vector | float) -> Vector:
        return self._new("fsub", self, other)

    def __mul__(self, other: Vector | float) -> Vector:
        return self._new("fmul", self, other)

    def __truediv__(self, other: Vector | float) -> Vector:
        return self._new("fdiv", self, other)

    def __radd__(self, other: float) -> Vector:
        return self._new("fadd", other, self)

    def __rsub__(self, other: float) -> Vector:
        return self._new("fsub", other, self)

    def __rmul__(self, other: float) -> Vector:
        return self._new("fmul", other, self)

    def __neg__(self) -> Vector:
        return Vector(self.builder, self.builder.fneg(self.value))

    def __abs__(self) -> Vector:
        return self._call("fabs", self)

    def __gt__(self, other: Vector | float) -> Vector:
        return Vector(self.builder, self.builder.fcmp_ordered(">", self.value, self._operand(other)))

    def __lt__(self, other: Vector | float) -> Vector:
        return Vector(self.builder, self.builder.fcmp_ordered("<", self.value, self._operand(other)))

    def __or__(self, other: Vector) -> Vector:
        return Vector(self.builder, self.builder.or_(self.value, other.value))

    def _operand(self, other: Vector | float) -> Any:
        if isinstance(other, Vector):
            return other.value
        return ir.Constant(self.value.type, [float(other)] * self.value.type.count)

    def _new(self, operation: str, left: Vector | float, right: Vector | float) -> Vector:
        emit = getattr(self.builder, operation)
        return Vector(self.builder, emit(self._operand(left), self._operand(right)))

    def _call(self, name: str, *arguments: Vector) -> Vector:
        kind = self.value.type
        function = ir.FunctionType(kind, [kind] * len(arguments))
        found = cgutils.get_or_insert_function(self.builder.module, function, f"llvm.{name}.v{kind.count}f64")
        return Vector(self.builder, self.builder.call(found, [each.value for each in arguments]))


def _where(condition: Vector, yes: Vector | float, no: Vector | float) -> Vector:
    builder, width = condition.builder, condition.value.type.count

    def value(operand: Vector | float) -> Any:
        if isinstance(operand, Vector):
            return operand.value
        return ir.Constant(ir.VectorType(_FLOAT, width), [float(operand)] * width)

    return Vector(builder, builder.select(condition.value, value(yes), value(no)))


def _indicator(condition: Vector) -> Vector:
    return _where(condition, 1.0, 0.0)


def _clip(x: Vector, limit: Vector) -> Vector:
    """Within ±limit; what is not a number stays it."""
    above, below = x > limit, x < -limit
    return _where(above, limit, _where(below, -limit, x))


def _positive_part(x: Vector) -> Vector:
    return _where(x > 0.0, x, 0.0 * x)


def _with_sign_of(magnitude: Vector, other: Vector) -> Vector:
    return magnitude._call("copysign", magnitude, other)


def _sqrt(x: Vector) -> Vector:
    return x._call("sqrt", x)


LANE_ARITHMETIC = Arithmetic(_where, _indicator, _clip, _positive_part, _with_sign_of, _sqrt)


def _pointer(builder: Any, address: Any, width: int) -> Any:
    return builder.inttoptr(address, ir.VectorType(_FLOAT, width).as_pointer())
