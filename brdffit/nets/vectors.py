"""A Numba type of 16 float32, and tiles of such vectors, for explicitly vectorised kernels.

LLVM's vectoriser does not vectorise small fused layers, since arrays may alias and indices may wrap. Here a value is
already a vector. Where registers have 8 or 4 lanes, LLVM splits each vector into two or four. A tile is a tuple of
vectors that stay in registers; an outer product adds to all of them,

    tile[r] += array[first + r * stride] * vector,     r = 0 ... rows - 1.

Indices are not checked and do not wrap; arrays are flat, contiguous float32.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils
from numba.extending import intrinsic, models, register_model

from brdffit._jit import types

LANES = 16
_LLVM_VECTOR = ir.VectorType(ir.FloatType(), LANES)
_INT = ir.IntType(32)


class _VectorType(types.Type):
    def __init__(self) -> None:
        super().__init__(name="float32x16")


#: The Numba type of 16 float32.
vector = _VectorType()


@register_model(_VectorType)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager: Any, fe_type: Any) -> None:
        super().__init__(manager, fe_type, _LLVM_VECTOR)


def _pointer(context: Any, builder: Any, array_type: Any, array: Any, index: Any) -> Any:
    data = context.make_array(array_type)(context, builder, array).data
    return builder.gep(data, [index])


def _read(builder: Any, pointer: Any) -> Any:
    value = builder.load(builder.bitcast(pointer, _LLVM_VECTOR.as_pointer()))
    value.align = 4
    return value


def _write(builder: Any, value: Any, pointer: Any) -> None:
    builder.store(value, builder.bitcast(pointer, _LLVM_VECTOR.as_pointer())).align = 4


def _spread(builder: Any, scalar: Any) -> Any:
    """A scalar in all lanes."""
    undefined = ir.Constant(_LLVM_VECTOR, ir.Undefined)
    one = builder.insert_element(undefined, scalar, ir.Constant(_INT, 0))
    return builder.shuffle_vector(one, undefined, ir.Constant(ir.VectorType(_INT, LANES), [0] * LANES))


def _fused(builder: Any, a: Any, b: Any, c: Any) -> Any:
    signature = ir.FunctionType(_LLVM_VECTOR, [_LLVM_VECTOR] * 3)
    function = cgutils.get_or_insert_function(builder.module, signature, f"llvm.fma.v{LANES}f32")
    return builder.call(function, [a, b, c])


def _leaky(builder: Any, value: Any, like: Any, slope: Any) -> Any:
    """``value`` where ``like`` is positive, else ``slope`` times ``value``."""
    zero = ir.Constant(_LLVM_VECTOR, [0.0] * LANES)
    return builder.select(builder.fcmp_ordered(">", like, zero), value, builder.fmul(value, _spread(builder, slope)))


def _tuple_of(context: Any, builder: Any, tuple_type: Any, values: list[Any]) -> Any:
    made = cgutils.get_null_value(context.get_value_type(tuple_type))
    for i, value in enumerate(values):
        made = builder.insert_value(made, value, i)
    return made


@intrinsic
def load(typing_context, array, index):  # type: ignore[no-untyped-def]
    """array[index : index + 16] as a vector."""

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return _read(builder, _pointer(context, builder, signature.args[0], arguments[0], arguments[1]))

    return vector(array, types.intp), generate


@intrinsic
def store(typing_context, array, index, value):  # type: ignore[no-untyped-def]
    """array[index : index + 16] = value."""

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        _write(builder, arguments[2], _pointer(context, builder, signature.args[0], arguments[0], arguments[1]))
        return context.get_dummy_value()

    return types.void(array, types.intp, vector), generate


@intrinsic
def add(typing_context, a, b):  # type: ignore[no-untyped-def]
    """a + b."""
    return vector(vector, vector), lambda context, builder, signature, arguments: builder.fadd(*arguments)


@intrinsic
def leak(typing_context, value, like, slope):  # type: ignore[no-untyped-def]
    """value where like > 0, else slope * value: the derivative of the leaky rectifier applied to ``value``."""

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return _leaky(builder, *arguments)

    return vector(vector, vector, types.float32), generate


@intrinsic
def subtract(typing_context, a, b):  # type: ignore[no-untyped-def]
    """a - b."""
    return vector(vector, vector), lambda context, builder, signature, arguments: builder.fsub(*arguments)


@intrinsic
def multiply(typing_context, a, b):  # type: ignore[no-untyped-def]
    """a * b."""
    return vector(vector, vector), lambda context, builder, signature, arguments: builder.fmul(*arguments)


@intrinsic
def multiply_add(typing_context, a, b, c):  # type: ignore[no-untyped-def]
    """a * b + c, rounded once."""

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return _fused(builder, *arguments)

    return vector(vector, vector, vector), generate


@intrinsic
def halves(typing_context, a, b):  # type: ignore[no-untyped-def]
    """The vector whose first 8 lanes are the scalar a and whose last 8 are the scalar b."""

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        both = [builder.insert_element(ir.Constant(_LLVM_VECTOR, ir.Undefined), arguments[0], ir.Constant(_INT, 0))]
        both.append(builder.insert_element(both[0], arguments[1], ir.Constant(_INT, 1)))
        order = [0] * (LANES // 2) + [1] * (LANES // 2)
        return _shuffled(builder, both[1], order)

    return vector(types.float32, types.float32), generate


@intrinsic
def add_halves(typing_context, a):  # type: ignore[no-untyped-def]
    """a[i] + a[(i + 8) % 16] in each lane i."""

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return _rotated_sum(builder, arguments[0], LANES // 2)

    return vector(vector), generate


@intrinsic
def total(typing_context, a):  # type: ignore[no-untyped-def]
    """The sum of the lanes, a scalar."""

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        value, step = arguments[0], LANES // 2
        while step:
            value, step = _rotated_sum(builder, value, step), step // 2
        return builder.extract_element(value, ir.Constant(_INT, 0))

    return types.float32(vector), generate


def _shuffled(builder: Any, value: Any, order: list[int]) -> Any:
    lanes = ir.Constant(ir.VectorType(_INT, LANES), order)
    return builder.shuffle_vector(value, ir.Constant(_LLVM_VECTOR, ir.Undefined), lanes)


def _rotated_sum(builder: Any, value: Any, step: int) -> Any:
    return builder.fadd(value, _shuffled(builder, value, [(i + step) % LANES for i in range(LANES)]))


def _tile(rows: int) -> tuple[Any, Any, Any, Any]:
    """The operations on a tile of ``rows`` vectors: (repeated, loaded, multiply_add, stored)."""
    tile = types.UniTuple(vector, rows)

    @intrinsic
    def repeated(typing_context, array, index):  # type: ignore[no-untyped-def]
        """A tile each of whose vectors is array[index : index + 16]."""

        def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
            value = _read(builder, _pointer(context, builder, signature.args[0], arguments[0], arguments[1]))
            return _tuple_of(context, builder, tile, [value] * rows)

        return tile(array, types.intp), generate

    @intrinsic
    def loaded(typing_context, array, index, stride):  # type: ignore[no-untyped-def]
        """The tile whose vector r is read at array[index + r * stride]."""

        def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
            at, values = arguments[1], []
            for _ in range(rows):
                values.append(_read(builder, _pointer(context, builder, signature.args[0], arguments[0], at)))
                at = builder.add(at, arguments[2])
            return _tuple_of(context, builder, tile, values)

        return tile(array, types.intp, types.intp), generate

    @intrinsic
    def multiply_add(typing_context, sums, array, index, stride, value):  # type: ignore[no-untyped-def]
        """sums[r] + array[index + r * stride] * value for every r."""

        def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
            at, values = arguments[2], []
            for r in range(rows):
                scalar = builder.load(_pointer(context, builder, signature.args[1], arguments[1], at))
                before = builder.extract_value(arguments[0], r)
                values.append(_fused(builder, _spread(builder, scalar), arguments[4], before))
                at = builder.add(at, arguments[3])
            return _tuple_of(context, builder, tile, values)

        return tile(tile, array, types.intp, types.intp, vector), generate

    @intrinsic
    def stored(typing_context, sums, array, index, stride, slope):  # type: ignore[no-untyped-def]
        """Write each sums[r] to array[index + r * stride], after a leaky rectifier of this slope (1: none)."""

        def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
            at = arguments[2]
            for r in range(rows):
                value = builder.extract_value(arguments[0], r)
                value = _leaky(builder, value, value, arguments[4])
                _write(builder, value, _pointer(context, builder, signature.args[1], arguments[1], at))
                at = builder.add(at, arguments[3])
            return context.get_dummy_value()

        return types.void(tile, array, types.intp, types.intp, types.float32), generate

    return repeated, loaded, multiply_add, stored


#: Pixels that a kernel works on at once: 8 sums hide the latency of a fused multiply-add.
PIXELS = 8
repeated8, loaded8, multiply_add8, stored8 = _tile(PIXELS)
#: The rows of one 16 x 16 block of a weight gradient.
_, loaded16, multiply_add16, stored16 = _tile(LANES)
#: Half the rows of a weight gradient of 25 inputs and their bias.
_, loaded13, multiply_add13, stored13 = _tile(13)
