"""Vectors of eight numbers, for compiled loops that are too short for the compiler to make vectors of by itself.

`total += absolute(load(first, (i, j)) - load(second, (k, l)))` is in machine code what it says, eight columns at a
time, whatever the processor's own vectors hold. A loop of as many turns would become scalar code, or look through its
arrays for overlaps each time that it begins. Each of the eight numbers is what a scalar would be: no result depends on
what else is in its vector.
"""

import operator
from typing import Any

from llvmlite import ir
from numba.core import types
from numba.core.cgutils import get_item_pointer, get_or_insert_function, unpack_tuple
from numba.core.datamodel import models
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, register_model

_function: Any = intrinsic  # whose annotations know nothing of the first argument's going

LANES = 8
"""Numbers in a vector."""


class Vector(types.Type):
    """The type of eight numbers of one kind."""

    def __init__(self, dtype):
        self.dtype = dtype
        super().__init__(name=f"Vector({dtype} x {LANES})")


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, ir.VectorType(dmm.lookup(fe_type.dtype).get_value_type(), LANES))


# -- Between arrays and vectors ----------------------------------------------------------------------------------------


def _pointer(context, builder, array, value, place):
    """Where a vector is in an array; not farther aligned than one number is."""
    indices = unpack_tuple(builder, place)
    pointer = get_item_pointer(context, builder, array, context.make_array(array)(context, builder, value), indices)
    return builder.bitcast(pointer, context.get_value_type(Vector(array.dtype)).as_pointer())


@_function
def load(_, array, place):
    """Eight numbers of an array from a place on, along its last axis. Nothing checks that the array has so many."""

    def code(context, builder, signature_, values):
        pointer = _pointer(context, builder, signature_.args[0], *values)
        return builder.load(pointer, align=array.dtype.bitwidth // 8)

    return Vector(array.dtype)(array, place), code


@_function
def store(_, array, place, vector):
    """Write eight numbers to an array; see `load`."""

    def code(context, builder, signature_, values):
        pointer = _pointer(context, builder, signature_.args[0], *values[:2])
        builder.store(values[2], pointer, align=array.dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(array, place, vector), code


@_function
def zeros(_, dtype):
    """Eight zeros of a kind, such as `np.float32`."""

    def code(context, _builder, signature_, _values):
        return ir.Constant(context.get_value_type(signature_.return_type), None)

    return Vector(dtype.dtype)(dtype), code


# -- Arithmetic --------------------------------------------------------------------------------------------------------


def _same_kind(name):
    """Let numba know an operator of two vectors of one kind."""

    class Operator(AbstractTemplate):
        def generic(self, arguments, _keywords):
            if len(arguments) == 2 and isinstance(arguments[0], Vector) and arguments[0] == arguments[1]:
                return signature(arguments[0], *arguments)
            return None

    infer_global(name)(Operator)


def _define(name, of_floats, of_integers):
    _same_kind(name)

    @lower_builtin(name, Vector, Vector)
    def code(_context, builder, signature_, values):
        kind = of_floats if isinstance(signature_.return_type.dtype, types.Float) else of_integers
        return getattr(builder, kind)(*values)


_define(operator.add, "fadd", "add")
_define(operator.iadd, "fadd", "add")
_define(operator.sub, "fsub", "sub")
_define(operator.mul, "fmul", "mul")
_define(operator.xor, "", "xor")


def _of_llvm(name, context, builder, vector, value):
    """LLVM's own function of this name, such as `fabs`."""
    kind = context.get_value_type(vector)
    suffix = f"{'f' if isinstance(vector.dtype, types.Float) else 'i'}{vector.dtype.bitwidth}"
    function = get_or_insert_function(builder.module, ir.FunctionType(kind, [kind]), f"llvm.{name}.v{LANES}{suffix}")
    return builder.call(function, [value])


@_function
def absolute(_, vector):
    """Absolute values of floating-point numbers."""

    def code(context, builder, _, values):
        return _of_llvm("fabs", context, builder, vector, values[0])

    return vector(vector), code


@_function
def bits_set(_, vector):
    """How many bits of each whole number are set."""

    def code(context, builder, _, values):
        return _of_llvm("ctpop", context, builder, vector, values[0])

    return vector(vector), code


@_function
def doubles(_, vector):
    """The same numbers in double precision."""

    def code(context, builder, signature_, values):
        return builder.fpext(values[0], context.get_value_type(signature_.return_type))

    return Vector(types.float64)(vector), code


@_function
def singles(_, vector):
    """Whole numbers in single precision."""

    def code(context, builder, signature_, values):
        return builder.sitofp(values[0], context.get_value_type(signature_.return_type))

    return Vector(types.float32)(vector), code
