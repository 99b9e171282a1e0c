"""Linear algebra and elementary functions whose last bit is the same on every x86-64 processor.

BLAS and LAPACK choose their kernels by the processor, numpy dispatches its elementary functions likewise, and glibc has
sin, cos, atan2, exp, log and pow with and without fused multiply-add. All of these round differently. What is here uses
only what IEEE 754 defines to the last bit: + - * /, square roots, rounding to integers, scaling by powers of two and
comparisons, in the order in which they are written. core, world, geometry, fracture and simulation use
nothing else (`python -m lint.portable_arithmetic`).

The elementary functions are those of fdlibm (Sun Microsystems 1993, "Freely Distributable LIBM"): argument reduction
and minimax polynomials with errors below one unit in the last place. All functions work on arrays of any shape.
"""

from __future__ import annotations

import numpy as np

# pi/2 as a sum; the first two have 33 bits, so that their products with quotients below 2^20 are exact.
_TWO_OVER_PI = 6.36619772367581382433e-01
_HALF_PI = (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
LARGEST_ANGLE = 1.0e6  # [rad] beyond, the quotient has more than 20 bits
_SINE = (
    -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04,
    2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10,
)  # fmt: skip
_COSINE = (
    4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05,
    -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11,
)  # fmt: skip
# atan(1/2), atan(1) and pi/2, each with what its last bit leaves
_ARCTANGENT_HALF = (4.63647609000806093515e-01, 2.26987774529616870924e-17)
_ARCTANGENT_ONE = (7.85398163397448278999e-01, 3.06161699786838301793e-17)
_RIGHT_ANGLE = (1.57079632679489655800e00, 6.12323399573676603587e-17)
# from the highest power down
_ARCTANGENT = (
    1.62858201153657823623e-02, -3.65315727442169155270e-02, 4.97687799461593236017e-02, -5.83357013379057348645e-02,
    6.66107313738753120669e-02, -7.69187620504482999495e-02, 9.09088713343650656196e-02, -1.11111104054623557880e-01,
    1.42857142725034663711e-01, -1.99999999998764832476e-01, 3.33333333333329318027e-01,
)  # fmt: skip
_LN2, _LN2_TAIL = 6.93147180369123816490e-01, 1.90821492927058770002e-10
_EXPONENTIAL = (
    1.66666666666666019037e-01, -2.77777777770155933842e-03, 6.61375632143793436117e-05,
    -1.65339022054652515390e-06, 4.13813679705723846039e-08,
)  # fmt: skip
_LOGARITHM = (
    6.666666666666735130e-01, 3.999999999940941908e-01, 2.857142874366239149e-01, 2.222219843214978396e-01,
    1.818357216161805012e-01, 1.531383769920937332e-01, 1.479819860511658591e-01,
)  # fmt: skip


# --- elementary functions ---------------------------------------------------------------------------------------------


def sine(angle):
    """Sines of angles [rad] of at most LARGEST_ANGLE."""
    return sine_after(angle, 0.0)


def cosine(angle):
    """Cosines of angles [rad] of at most LARGEST_ANGLE."""
    return sine_after(angle, 1.0)


def sine_after(angle, quarters):
    """sin(angle + quarters pi/2): the rest of the angle within +-pi/4, in two parts, through both polynomials.

    Without branches, so that numba compiles it as it is, for scalars too.
    """
    k = np.floor(angle * _TWO_OVER_PI + 0.5)
    first = angle - k * _HALF_PI[0]
    second = first - k * _HALF_PI[1]
    tail = k * _HALF_PI[2] - ((first - second) - k * _HALF_PI[1])
    x = second - tail
    y = (second - x) - tail
    z = x * x
    s, c = _SINE, _COSINE
    r = s[1] + z * (s[2] + z * (s[3] + z * (s[4] + z * s[5])))
    sin = x - ((z * (0.5 * y - z * x * r) - y) - z * x * s[0])
    r = z * (c[0] + z * (c[1] + z * (c[2] + z * (c[3] + z * (c[4] + z * c[5])))))
    w = 1.0 - 0.5 * z
    cos = w + (((1.0 - w) - 0.5 * z) + (z * r - x * y))
    k = k + quarters
    odd = k - 2.0 * np.floor(0.5 * k)  # 0 or 1: products with it are exact
    half = np.floor(0.5 * k)
    sign = 1.0 - 2.0 * (half - 2.0 * np.floor(0.5 * half))
    return sign * ((1.0 - odd) * sin + odd * cos)


def arctangent2(y, x):
    """The angle [rad] of (x, y), in [-pi, pi]; 0 for (0, 0). Without branches, as sine_after."""
    up, along = np.abs(y), np.abs(x)
    low, high = np.minimum(up, along), np.maximum(up, along)
    t = low / (high + (high == 0.0))  # within [0, 1]
    # t is turned back by the nearest of 0, atan(1/2) and atan(1): each of these is 1 or 0, products with it are exact.
    by_one, by_half = 1.0 * (t >= 0.6875), 1.0 * (t >= 0.4375) * (t < 0.6875)
    by_none = 1.0 - by_half - by_one
    rest = by_none * t + by_half * ((2.0 * t - 1.0) / (2.0 + t)) + by_one * ((t - 1.0) / (t + 1.0))
    back = by_half * _ARCTANGENT_HALF[0] + by_one * _ARCTANGENT_ONE[0]
    tail = by_half * _ARCTANGENT_HALF[1] + by_one * _ARCTANGENT_ONE[1]
    z = rest * rest
    series = 0.0 * z
    for coefficient in _ARCTANGENT:
        series = z * (coefficient + series)
    angle = back - ((rest * series - tail) - rest)
    swapped, behind = 1.0 * (up > along), 1.0 * (x < 0.0)
    angle = (1.0 - swapped) * angle + swapped * (_RIGHT_ANGLE[0] - (angle - _RIGHT_ANGLE[1]))
    angle = (1.0 - behind) * angle + behind * (2.0 * _RIGHT_ANGLE[0] - (angle - 2.0 * _RIGHT_ANGLE[1]))
    return (1.0 - 2.0 * (y < 0.0)) * angle


def arccosine(x) -> np.ndarray:
    """Arccosines [rad], in [0, pi], of numbers in [-1, 1]."""
    x = np.asarray(x, np.float64)
    return 2.0 * arctangent2(np.sqrt(1.0 - x), np.sqrt(1.0 + x))


def exponential(x) -> np.ndarray:
    """Powers of e with exponents x; 0 and infinity beyond the range of float64."""
    x = np.clip(np.asarray(x, np.float64), -800.0, 800.0)
    k = np.floor(x / (_LN2 + _LN2_TAIL) + 0.5)
    high, low = x - k * _LN2, k * _LN2_TAIL
    r = high - low
    z = r * r
    p = _EXPONENTIAL
    c = r - z * (p[0] + z * (p[1] + z * (p[2] + z * (p[3] + z * p[4]))))
    with np.errstate(over="ignore", under="ignore"):
        return np.ldexp(1.0 - ((low - (r * c) / (2.0 - c)) - high), k.astype(np.int64))


def logarithm(x) -> np.ndarray:
    """Natural logarithms of positive numbers."""
    mantissa, k = np.frexp(np.asarray(x, np.float64))
    small = mantissa < np.sqrt(0.5)
    mantissa, k = np.where(small, 2.0 * mantissa, mantissa), np.where(small, k - 1, k).astype(np.float64)
    f = mantissa - 1.0
    s = f / (2.0 + f)
    z = s * s
    w = z * z
    c = _LOGARITHM
    even = w * (c[1] + w * (c[3] + w * c[5]))
    odd = z * (c[0] + w * (c[2] + w * (c[4] + w * c[6])))
    half = 0.5 * f * f
    return k * _LN2 - ((half - (s * (half + even + odd) + k * _LN2_TAIL)) - f)


def power(x, exponent) -> np.ndarray:
    """Numbers >= 0 to any power, to a relative error of about 2^-52 (1 + |exponent ln x|)."""
    x = np.asarray(x, np.float64)
    if np.all(exponent == 1.0):
        return x.copy()
    powers = exponential(exponent * logarithm(np.where(x > 0.0, x, 1.0)))
    with np.errstate(divide="ignore"):
        at_zero = np.where(np.equal(exponent, 0.0), 1.0, np.where(np.less(exponent, 0.0), np.inf, 0.0))
    return np.where(x > 0.0, powers, at_zero)


def cube_root(x: float) -> float:
    """Of a number >= 0: a power, and one step of Newton's method."""
    if x == 0.0:
        return 0.0
    root = float(power(x, 1.0 / 3.0))
    return root - (root - x / (root * root)) / 3.0


# --- vectors and matrices ---------------------------------------------------------------------------------------------


def dots(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar products along the last axis; the others are broadcast."""
    a, b = np.asarray(a), np.asarray(b)
    total = a[..., 0] * b[..., 0]
    for i in range(1, a.shape[-1]):
        total = total + a[..., i] * b[..., i]
    return total


def lengths(vectors: np.ndarray) -> np.ndarray:
    """Euclidean norms along the last axis."""
    return np.sqrt(dots(vectors, vectors))


def products(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Matrix products (..., n, k) by (..., k, m); meant for a few k."""
    a, b = np.asarray(a), np.asarray(b)
    total = a[..., :, :1] * b[..., :1, :]
    for i in range(1, a.shape[-1]):
        total = total + a[..., :, i : i + 1] * b[..., i : i + 1, :]
    return total


def images(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Vectors (..., k) multiplied from the left by matrices (..., n, k)."""
    return dots(matrices, np.asarray(vectors)[..., None, :])


def determinants(matrices: np.ndarray) -> np.ndarray:
    """Of matrices (..., 3, 3)."""
    a, b, c = (matrices[..., i, :] for i in range(3))
    return dots(a, np.cross(b, c))


def inverses(matrices: np.ndarray) -> np.ndarray:
    """Of matrices (..., 3, 3), by their cofactors."""
    a, b, c = (np.asarray(matrices)[..., i, :] for i in range(3))
    cofactors = np.stack((np.cross(b, c), np.cross(c, a), np.cross(a, b)), axis=-1)
    return cofactors / dots(a, cofactors[..., 0])[..., None, None]


def solutions(matrices: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Vectors x (..., 3) with matrices (..., 3, 3) x = right (..., 3), for well-conditioned matrices."""
    return images(inverses(matrices), right)


# --- rotations --------------------------------------------------------------------------------------------------------


def rotation_vectors(quaternions: np.ndarray) -> np.ndarray:
    """Axis times angle [rad], (..., 3), of unit quaternions (..., 4); the angle is at most pi."""
    quaternions = np.asarray(quaternions)
    q = np.where(quaternions[..., 3:] < 0.0, -quaternions, quaternions)
    size = lengths(q[..., :3])
    # angle / sin(angle / 2), which tends to 2
    scale = np.where(size > 0.0, 2.0 * arctangent2(size, q[..., 3]) / np.where(size > 0.0, size, 1.0), 2.0)
    return scale[..., None] * q[..., :3]


# --- random numbers ---------------------------------------------------------------------------------------------------


def normal_numbers(generator: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Normally distributed with mean 0 and variance 1: Box, Muller 1958. numpy's own take log1p and exp from glibc."""
    first, second = generator.random((2, *shape))
    return np.sqrt(-2.0 * logarithm(1.0 - first)) * cosine(2.0 * np.pi * second)
