"""A Numba type of 8 float64 with arithmetic operators, so that one formula is written once and serves eight texels.

The operators + - * / take two vectors, or a vector and a number. The functions ``root``, ``logarithm``,
``exponential``, ``least``, ``greatest``, ``magnitude``, ``with_sign`` and ``chosen`` (which computes both sides)
complete them. Where registers are narrower, LLVM splits each vector. log and exp are the polynomials of
``models.elementary``, to 1e-7 of their value.
"""

from __future__ import annotations

import math
import operator
from typing import Any

from llvmlite import ir
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, models, register_model

from brdffit._jit import types

EIGHT = 8
_VECTOR = ir.VectorType(ir.DoubleType(), EIGHT)
_BITS = ir.VectorType(ir.IntType(64), EIGHT)
_FAST = ("reassoc", "contract", "nsz", "arcp")


class _DoublesType(types.Type):
    def __init__(self) -> None:
        super().__init__(name="float64x8")


#: The Numba type of 8 float64.
doubles = _DoublesType()


@register_model(_DoublesType)
class _DoublesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, fe_type: Any) -> None:
        super().__init__(manager, fe_type, _VECTOR)


def _spread(builder: Any, scalar: Any) -> Any:
    undefined = ir.Constant(_VECTOR, ir.Undefined)
    one = builder.insert_element(undefined, scalar, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(one, undefined, ir.Constant(ir.VectorType(ir.IntType(32), EIGHT), [0] * EIGHT))


def _number(value: float) -> Any:
    return ir.Constant(_VECTOR, [value] * EIGHT)


def _called(builder: Any, name: str, *values: Any) -> Any:
    kind = ir.FunctionType(_VECTOR, [_VECTOR] * len(values))
    function = builder.module.globals.get(f"llvm.{name}.v{EIGHT}f64") or ir.Function(
        builder.module, kind, f"llvm.{name}.v{EIGHT}f64"
    )
    return builder.call(function, values)


def _operator(symbol: Any, instruction: str) -> None:
    """Define an operator for two vectors, and for a vector and a number in either order."""
    both = [(doubles, doubles), (doubles, types.float64), (types.float64, doubles)]

    @infer_global(symbol)
    class _Template(ConcreteTemplate):
        key = symbol
        cases = [signature(doubles, *pair) for pair in both]

    def lower(context, builder, sig, arguments):  # type: ignore[no-untyped-def]
        a, b = (
            value if kind == doubles else _spread(builder, value)
            for kind, value in zip(sig.args, arguments, strict=True)
        )
        return getattr(builder, instruction)(a, b, flags=_FAST)

    for pair in both:
        lower_builtin(symbol, *pair)(lower)


for _symbol, _instruction in (
    (operator.add, "fadd"), (operator.sub, "fsub"), (operator.mul, "fmul"), (operator.truediv, "fdiv"),
):  # fmt: skip
    _operator(_symbol, _instruction)


def _of_pointer(context: Any, builder: Any, array_type: Any, array: Any, index: Any, kind: Any) -> Any:
    data = context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), kind.as_pointer())


@intrinsic
def eight(typing_context, array, index):  # type: ignore[no-untyped-def]
    """array[index : index + 8] of a flat array of float64, or of float32, which are widened."""

    def generate(context, builder, sig, arguments):  # type: ignore[no-untyped-def]
        single = sig.args[0].dtype == types.float32
        kind = ir.VectorType(ir.FloatType(), EIGHT) if single else _VECTOR
        value = builder.load(_of_pointer(context, builder, sig.args[0], *arguments, kind))
        value.align = 4 if single else 8
        return builder.fpext(value, _VECTOR) if single else value

    return doubles(array, types.intp), generate


@intrinsic
def put(typing_context, array, index, value):  # type: ignore[no-untyped-def]
    """array[index : index + 8] = value, of a flat array of float64, or of float32, to which it is rounded."""

    def generate(context, builder, sig, arguments):  # type: ignore[no-untyped-def]
        array, index, value = arguments
        single = sig.args[0].dtype == types.float32
        kind = ir.VectorType(ir.FloatType(), EIGHT) if single else _VECTOR
        if single:
            value = builder.fptrunc(value, kind)
        builder.store(value, _of_pointer(context, builder, sig.args[0], array, index, kind)).align = 4 if single else 8
        return context.get_dummy_value()

    return types.void(array, types.intp, doubles), generate


@intrinsic
def all_of(typing_context, number):  # type: ignore[no-untyped-def]
    """A number in every lane."""
    return doubles(types.float64), lambda context, builder, sig, arguments: _spread(builder, arguments[0])


@intrinsic
def root(typing_context, x):  # type: ignore[no-untyped-def]
    """Square root."""
    return doubles(doubles), lambda context, builder, sig, arguments: _called(builder, "sqrt", *arguments)


@intrinsic
def magnitude(typing_context, x):  # type: ignore[no-untyped-def]
    """|x|."""
    return doubles(doubles), lambda context, builder, sig, arguments: _called(builder, "fabs", *arguments)


@intrinsic
def with_sign(typing_context, x, like):  # type: ignore[no-untyped-def]
    """|x| with the sign of ``like``."""
    return doubles(doubles, doubles), lambda context, builder, sig, arguments: _called(builder, "copysign", *arguments)


@intrinsic
def chosen(typing_context, test, positive, other):  # type: ignore[no-untyped-def]
    """``positive`` where test > 0, else ``other``."""

    def generate(context, builder, sig, arguments):  # type: ignore[no-untyped-def]
        return builder.select(builder.fcmp_ordered(">", arguments[0], _number(0.0)), arguments[1], arguments[2])

    return doubles(doubles, doubles, doubles), generate


def _extreme(sign: str) -> Any:
    @intrinsic
    def extreme(typing_context, x, bound):  # type: ignore[no-untyped-def]
        """The smaller, or the larger, of a vector and a vector or number, lane by lane."""

        def generate(context, builder, sig, arguments):  # type: ignore[no-untyped-def]
            x, bound = arguments
            if sig.args[1] != doubles:
                bound = _spread(builder, bound)
            return builder.select(builder.fcmp_ordered(sign, x, bound), x, bound)

        return doubles(doubles, doubles if bound == doubles else types.float64), generate

    return extreme


least, greatest = _extreme("<"), _extreme(">")

_HALF = 0x3FE6A09E667F3BCD  # sqrt(1/2)
_LOG = (
    -0.10082378969197524, 0.16180501338702347, -0.17243224618210293, 0.1990688314005559, -0.24971228514604218,
    0.3333471490702673, -0.5000032343660697, 1.0,
)  # fmt: skip
_EXP = (0.008312524909621168, 0.04189011322082906, 0.16667114465105606, 0.49999232790927484, 1.0, 1.0)


def _polynomial(builder: Any, coefficients: Any, x: Any) -> Any:
    total = _number(coefficients[0])
    for each in coefficients[1:]:
        total = builder.fadd(builder.fmul(total, x, flags=_FAST), _number(each), flags=_FAST)
    return total


def _whole(value: int) -> Any:
    return ir.Constant(_BITS, [value] * EIGHT)


@intrinsic
def logarithm(typing_context, x):  # type: ignore[no-untyped-def]
    """log(x) of normal x > 0."""

    def generate(context, builder, sig, arguments):  # type: ignore[no-untyped-def]
        # x = 2^k m with m in [sqrt(1/2), sqrt 2): subtracting the bits of sqrt(1/2) leaves k in the exponent field.
        pattern = builder.bitcast(arguments[0], _BITS)
        field = builder.and_(builder.sub(pattern, _whole(_HALF)), _whole(-(1 << 52)))
        k = builder.fmul(builder.sitofp(field, _VECTOR), _number(2.0**-52))
        u = builder.fsub(builder.bitcast(builder.sub(pattern, field), _VECTOR), _number(1.0))
        quotient = _polynomial(builder, _LOG, u)
        part = builder.fmul(k, _number(math.log(2.0)))
        return builder.fadd(builder.fmul(u, quotient, flags=_FAST), part, flags=_FAST)

    return doubles(doubles), generate


@intrinsic
def exponential(typing_context, x):  # type: ignore[no-untyped-def]
    """exp(x), |x| at most 700."""

    def generate(context, builder, sig, arguments):  # type: ignore[no-untyped-def]
        # Adding 1.5 * 2^52 rounds to an integer. An instruction without flags would get the kernel's fast-math flags,
        # and these sums must not be reassociated.
        grid, plain = _number(1.5 * 2.0**52), ("contract",)
        k = builder.fadd(builder.fmul(arguments[0], _number(math.log2(math.e)), flags=plain), grid, flags=plain)
        whole = builder.fsub(k, grid, flags=plain)
        r = builder.fsub(arguments[0], builder.fmul(whole, _number(math.log(2.0)), flags=plain), flags=plain)
        p = _polynomial(builder, _EXP, r)
        power = builder.shl(builder.bitcast(k, _BITS), _whole(52))
        return builder.bitcast(builder.add(builder.bitcast(p, _BITS), power), _VECTOR)

    return doubles(doubles), generate
