"""exp and log as polynomials, so that loops over nodes vectorise (libm's are called one by one).

``real`` is the float type of the arithmetic: kernels are written for it and specialised for float64. Both functions
reduce to the float32 exponent field, so in float64 they keep the range of float32 and the accuracy of the polynomials
(1e-7 for exp, 2e-7 for log): enough for an objective, not for a library of special functions.
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


@intrinsic
def bits_to_float(typingctx, bits):  # type: ignore[no-untyped-def]
    """The float32 with these bits."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        return builder.bitcast(args[0], ir.FloatType())

    return types.float32(types.int32), codegen


@intrinsic
def float_to_bits(typingctx, value):  # type: ignore[no-untyped-def]
    """The bits of this float32."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        return builder.bitcast(args[0], ir.IntType(32))

    return types.int32(types.float32), codegen


@intrinsic
def reciprocal(typingctx, x):  # type: ignore[no-untyped-def]
    """1 / x for finite x. That x is finite is what LLVM must be told before it takes, in a loop over float32, the
    processor's estimate and one step of Newton (to the last bit or two) instead of a division, which waits."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        one = ir.Constant(args[0].type, 1.0)
        return builder.fdiv(one, args[0], flags=("arcp", "contract", "ninf", "nsz", "reassoc"))

    return x(x), codegen


@inline
def exp_negative(x):
    """exp(x) for x <= 0; 0 below -32. x = k ln 2 + r, |r| <= ln 2 / 2; Taylor to r^7 (error 4e-9 before rounding).

    Of a lobe, what is 14 orders of magnitude below its peak adds nothing to a sum in single precision; but its squares
    and products would be subnormal numbers, which processors take many times as long over.
    """
    x = max(x, real(-32.0))
    k = np.int32(x * real(_LOG2E) - real(0.5))
    r = x - real(k) * real(_LN2)
    p = real(1 / 5040)
    p = p * r + real(1 / 720)
    p = p * r + real(1 / 120)
    p = p * r + real(1 / 24)
    p = p * r + real(1 / 6)
    p = p * r + real(0.5)
    p = p * r + real(1.0)
    p = p * r + real(1.0)
    scale = real(bits_to_float(np.int32((k + np.int32(127)) << np.int32(23))))
    return p * scale if x > real(-32.0) else real(0.0)


@inline
def log_positive(x):
    """log(x) for normal x > 0.

    x = 2^k m, m in [sqrt(1/2), sqrt 2); log m = 2 atanh z with z = (m-1)/(m+1), |z| <= 0.1716, odd series to z^9.
    """
    bits = float_to_bits(np.float32(x))
    k = np.int32((bits - np.int32(0x3F3504F3)) >> np.int32(23))
    m = x * real(bits_to_float(np.int32((np.int32(127) - k) << np.int32(23))))
    z = (m - real(1.0)) / (m + real(1.0))
    z2 = z * z
    p = real(2 / 9)
    p = p * z2 + real(2 / 7)
    p = p * z2 + real(2 / 5)
    p = p * z2 + real(2 / 3)
    p = p * z2 + real(2.0)
    return z * p + real(k) * real(_LN2)
