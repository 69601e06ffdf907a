"""exp and log as polynomials, so that loops over nodes vectorise (libm's functions take one number at a time).

``real`` is the float type of the arithmetic: kernels are written for float32 and specialised for float64, where exp and
log still have the accuracy of their polynomials (1e-7 and 2e-7), which is enough for an objective. The polynomials are
minimax in the relative error on the interval that remains once the exponent field is split off.
"""

from __future__ import annotations

import math

import numpy as np
from llvmlite import ir
from numba.extending import intrinsic

from brdffit._jit import inline, types

real = np.float32

_LOG2E = math.log2(math.e)
_LN2 = math.log(2.0)
#: The flags of ordinary arithmetic here (brdffit._jit).
_FAST = ("arcp", "contract", "nsz", "reassoc")


@intrinsic
def reciprocal(typingctx, x):  # type: ignore[no-untyped-def]
    """1 / x for finite x. Told that x is finite, LLVM uses in loops over float32 the processor's estimate and one
    Newton step (right to the last bit or two) instead of a division, which is slower."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        one = ir.Constant(args[0].type, 1.0)
        return builder.fdiv(one, args[0], flags=("ninf", *_FAST))

    return x(x), codegen


@intrinsic
def inverse_root(typingctx, x):  # type: ignore[no-untyped-def]
    """1 / sqrt(x) for finite x > 0, as ``reciprocal``: an estimate and one Newton step in loops over float32."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        root = builder.module.declare_intrinsic("llvm.sqrt", [args[0].type])
        flags = ("afn", "ninf", *_FAST)
        one = ir.Constant(args[0].type, 1.0)
        return builder.fdiv(one, builder.call(root, [args[0]], fastmath=flags), flags=flags)

    return x(x), codegen


@intrinsic
def product(typingctx, x, y):  # type: ignore[no-untyped-def]
    """x * y for numbers that are not NaN, so that the compiler removes products with a constant 0."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        return builder.fmul(*args, flags=("nnan", *_FAST))

    return x(x, x), codegen


@intrinsic
def alternate(typingctx, x, j):  # type: ignore[no-untyped-def]
    """x for an even index j, -x for an odd one, by the last bit of j."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        bits, integer = _layout(args[0].type)
        index = builder.trunc(args[1], integer) if bits == 23 else args[1]
        sign = builder.shl(index, ir.Constant(integer, integer.width - 1))
        return builder.bitcast(builder.xor(builder.bitcast(args[0], integer), sign), args[0].type)

    return x(x, types.int64), codegen


@intrinsic
def align_stack(typingctx):  # type: ignore[no-untyped-def]
    """Align the stack of the calling function to a cache line: a loop with more values than registers keeps vectors on
    the stack, and each would otherwise lie across two lines."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        attributes = builder.function.attributes
        attributes.add("nounwind")  # true of every kernel; llvmlite leaves an alignment out that stands alone
        attributes.alignstack = 64
        return context.get_dummy_value()

    return types.void(), codegen


def _layout(kind: ir.Type) -> tuple[int, ir.IntType]:
    """Mantissa bits of a float type, and the integer type of its size."""
    return (23, ir.IntType(32)) if isinstance(kind, ir.FloatType) else (52, ir.IntType(64))


def _by_the_grid(operation: str):  # type: ignore[no-untyped-def]
    """Code that adds or subtracts 1.5 * 2^23 (or 2^52), where floats are integers; it must not be reassociated."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        kind = args[0].type
        grid = ir.Constant(kind, 1.5 * 2.0 ** _layout(kind)[0])
        return getattr(builder, operation)(args[0], grid, flags=("contract",))

    return codegen


@intrinsic
def on_integer_grid(typingctx, x):  # type: ignore[no-untyped-def]
    """A number whose last bits are the integer nearest to x."""
    return x(x), _by_the_grid("fadd")


@intrinsic
def off_integer_grid(typingctx, x):  # type: ignore[no-untyped-def]
    """The integer that ``on_integer_grid`` rounded to, as a float."""
    return x(x), _by_the_grid("fsub")


@intrinsic
def times_power_of_two(typingctx, x, k):  # type: ignore[no-untyped-def]
    """x 2^k, k from ``on_integer_grid``, by an addition to the exponent field of x."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        kind = args[0].type
        bits, integer = _layout(kind)
        power = builder.shl(builder.bitcast(args[1], integer), ir.Constant(integer, bits))
        return builder.bitcast(builder.add(builder.bitcast(args[0], integer), power), kind)

    return x(x, x), codegen


def _exponent_field(builder, x):  # type: ignore[no-untyped-def]
    """Bits of x, and k shifted into place, where x = 2^k m with m in [sqrt(1/2), sqrt 2)."""
    bits, integer = _layout(x.type)
    half = int(np.float32(math.sqrt(0.5)).view(np.int32)) if bits == 23 else int(np.float64(math.sqrt(0.5)).view(int))
    pattern = builder.bitcast(x, integer)
    above = builder.sub(pattern, ir.Constant(integer, half))
    return pattern, builder.and_(above, ir.Constant(integer, -(1 << bits)))


@intrinsic
def binary_exponent(typingctx, x):  # type: ignore[no-untyped-def]
    """k, as a float, of x = 2^k m with m in [sqrt(1/2), sqrt 2); x normal and positive."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        kind = args[0].type
        bits, _ = _layout(kind)
        _, field = _exponent_field(builder, args[0])
        return builder.fmul(builder.sitofp(field, kind), ir.Constant(kind, 2.0**-bits), flags=_FAST)

    return x(x), codegen


@intrinsic
def binary_mantissa(typingctx, x):  # type: ignore[no-untyped-def]
    """m of x = 2^k m with m in [sqrt(1/2), sqrt 2); x normal and positive."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        pattern, field = _exponent_field(builder, args[0])
        return builder.bitcast(builder.sub(pattern, field), args[0].type)

    return x(x), codegen


@inline
def exp_negative(x):
    """exp(x) for x <= 0 (and correct up to 80); 0 below -32. x = k ln 2 + r, |r| <= ln 2 / 2; 1 + r + r^2 ..., to 1e-7.

    A lobe that is 14 orders of magnitude below its peak adds nothing to a sum in single precision, but its squares and
    products would be subnormal numbers, with which processors are many times slower.
    """
    k = on_integer_grid(x * real(_LOG2E))
    r = x - off_integer_grid(k) * real(_LN2)
    # In pairs (Estrin's scheme): a chain of five dependent operations would be slower.
    r2 = r * r
    p = real(0.008312524909621168) * r + real(0.04189011322082906)
    p = p * r2 + (real(0.16667114465105606) * r + real(0.49999231790927484))
    p = p * r2 + (r + real(1.0))
    return times_power_of_two(p, k) if x > real(-32.0) else real(0.0)


@inline
def log_parts(x):
    """k, u and Q of log x = k ln 2 + u Q, for normal x > 0: x = 2^k (1 + u) with 1 + u in [sqrt(1/2), sqrt 2).

    Q is log(1 + u) / u = 1 - u/2 + ..., to 2e-7.
    """
    u = binary_mantissa(x) - real(1.0)
    u2 = u * u
    p = real(-0.10082378969197524) * u + real(0.16180501338702347)
    p = p * u2 + (real(-0.17243224618210293) * u + real(0.1990688314005559))
    p0 = real(-0.24971228514604218) * u + real(0.3333471490702673)
    p0 = p0 * u2 + (real(-0.5000032343660697) * u + real(1.0))
    p = p * (u2 * u2) + p0
    return binary_exponent(x), u, p


@inline
def log_positive(x):
    """log(x) for normal x > 0; about -88 at 0."""
    k, u, quotient = log_parts(x)
    return u * quotient + k * real(_LN2)
