"""Vectors of eight numbers, or four, for compiled loops that are too short for the compiler to make vectors of.

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
    """The type of eight numbers of one kind, or of another count."""

    def __init__(self, dtype, lanes=LANES):
        self.dtype, self.lanes = dtype, lanes
        super().__init__(name=f"Vector({dtype} x {lanes})")


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, ir.VectorType(dmm.lookup(fe_type.dtype).get_value_type(), fe_type.lanes))


# -- Between arrays and vectors ----------------------------------------------------------------------------------------


def _pointer(context, builder, array, values, vector):
    """Where a vector is in an array; not farther aligned than one number is."""
    value, place = values
    indices = unpack_tuple(builder, place)
    pointer = get_item_pointer(context, builder, array, context.make_array(array)(context, builder, value), indices)
    return builder.bitcast(pointer, context.get_value_type(vector).as_pointer())


def _loaded(array, place, lanes):
    """The signature and the code of a load."""
    vector = Vector(array.dtype, lanes)

    def code(context, builder, signature_, values):
        pointer = _pointer(context, builder, signature_.args[0], values, vector)
        return builder.load(pointer, align=array.dtype.bitwidth // 8)

    return vector(array, place), code


@_function
def load(_, array, place):
    """Eight numbers of an array from a place on, along its last axis. Nothing checks that the array has so many."""
    return _loaded(array, place, LANES)


@_function
def load_four(_, array, place):
    """Four numbers; see `load`."""
    return _loaded(array, place, 4)


@_function
def store(_, array, place, vector):
    """Write a vector to an array; see `load`."""

    def code(context, builder, signature_, values):
        pointer = _pointer(context, builder, signature_.args[0], values[:2], vector)
        builder.store(values[2], pointer, align=array.dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(array, place, vector), code


@_function
def zeros(_, dtype):
    """Eight zeros of a kind, such as `np.float32`."""

    def code(context, _builder, signature_, _values):
        return ir.Constant(context.get_value_type(signature_.return_type), None)

    return Vector(dtype.dtype)(dtype), code


@_function
def numbers(_, vector):
    """The numbers of a vector one by one, as a tuple."""

    def code(context, builder, signature_, values):
        each = [builder.extract_element(values[0], ir.IntType(32)(i)) for i in range(vector.lanes)]
        return context.make_tuple(builder, signature_.return_type, each)

    return types.UniTuple(vector.dtype, vector.lanes)(vector), code


def _window(begin):
    """A function that gives eight neighbouring numbers of two vectors that lie side by side, from one of them on."""

    def window(_, first, second):
        def code(_context, builder, _signature, values):
            places = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [begin + k for k in range(LANES)])
            return builder.shuffle_vector(*values, places)

        return first(first, second), code

    return _function(window)


from_1, from_2, from_4 = _window(1), _window(2), _window(4)


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
    function = get_or_insert_function(
        builder.module, ir.FunctionType(kind, [kind]), f"llvm.{name}.v{vector.lanes}{suffix}"
    )
    return builder.call(function, [value])


@_function
def times(_, number, vector):
    """A vector of floating-point numbers, each multiplied by a number, which has to be of their kind."""
    if number != vector.dtype:  # numba would round it to theirs
        return None

    def code(context, builder, _, values):
        kind, zero = context.get_value_type(vector), ir.IntType(32)(0)
        one = builder.insert_element(ir.Constant(kind, ir.Undefined), values[0], zero)
        all_ = ir.Constant(ir.VectorType(ir.IntType(32), vector.lanes), None)
        return builder.fmul(builder.shuffle_vector(one, one, all_), values[1])

    return vector(vector.dtype, vector), code


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

    return Vector(types.float64, vector.lanes)(vector), code


@_function
def singles(_, vector):
    """Whole numbers in single precision."""

    def code(context, builder, signature_, values):
        return builder.sitofp(values[0], context.get_value_type(signature_.return_type))

    return Vector(types.float32, vector.lanes)(vector), code
