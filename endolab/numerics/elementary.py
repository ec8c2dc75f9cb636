"""exp and log for compiled loops, of arithmetic alone: so that a loop takes many pixels at once.

Calls of the C library's are made one by one. These are as precise, to two units in the last place, for
whatever is finite and, of the logarithm, positive and no smaller than 1e-307; exp stops at e^±700.
"""

from typing import Any

from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

from endolab.numerics.compiled import COMPILED

ROUND = 6755399441055744.0  # 1.5 · 2⁵²: added, it leaves an integer in the last bits
LOG2_E = 1.4426950408889634
LN2_HIGH = 0.6931471803691238
LN2_LOW = 1.9082149292705877e-10
ONE_BITS = 0x3FF0000000000000
FRACTION_BITS = 0x000FFFFFFFFFFFFF
WHOLE_BITS = 0x4330000000000000
SQRT2 = 1.4142135623730951


def _bits_of(_: Any, x: Any) -> Any:
    """The 64 bits of a float64, as an integer."""
    return types.int64(types.float64), lambda _c, b, _s, given: b.bitcast(
        given[0], ir.IntType(64)
    )


def _float_of(_: Any, n: Any) -> Any:
    """The float64 of these 64 bits."""
    return types.float64(types.int64), lambda _c, b, _s, given: b.bitcast(
        given[0], ir.DoubleType()
    )


_bits: Any = intrinsic(_bits_of)
_float: Any = intrinsic(_float_of)


@njit(**COMPILED, forceinline=True)
def exp(x: float) -> float:
    """e^x, by x = n log 2 + r and Taylor's series of r."""
    x = min(max(x, -700.0), 700.0)
    turned = x * LOG2_E + ROUND
    n = turned - ROUND
    r = (x - n * LN2_HIGH) - n * LN2_LOW
    high = 1 / 39916800 + r * (1 / 479001600 + r * (1 / 6227020800))
    middle = 1 / 40320 + r * (1 / 362880 + r * (1 / 3628800 + r * high))
    low = 1 / 120 + r * (1 / 720 + r * (1 / 5040 + r * middle))
    series = 1 + r * (1 + r * (1 / 2 + r * (1 / 6 + r * (1 / 24 + r * low))))
    return series * _float((_bits(turned) << 52) + ONE_BITS)


@njit(**COMPILED, forceinline=True)
def log(x: float) -> float:
    """The natural logarithm, by x = 2ⁿ m and the series of 2 artanh (m - 1)/(m + 1)."""
    bits = _bits(x)
    n = _float((bits >> 52) | WHOLE_BITS) - (4503599627370496.0 + 1023.0)
    m = _float((bits & FRACTION_BITS) | ONE_BITS)
    large = m > SQRT2
    m = 0.5 * m if large else m
    n = n + 1 if large else n
    z = (m - 1) / (m + 1)
    s = z * z
    high = 1 / 13 + s * (1 / 15 + s * (1 / 17 + s * (1 / 19 + s * (1 / 21))))
    series = s * (1 / 3 + s * (1 / 5 + s * (1 / 7 + s * (1 / 9 + s * (1 / 11 + s * high)))))
    return n * LN2_HIGH + (n * LN2_LOW + 2 * z * series + 2 * z)
