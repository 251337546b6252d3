"""How wide lanes are on this processor, and exp, log, pow and tanh of all lanes at once.

The functions are kernel text themselves: sums, products and one division, and four functions of a number's bits that
:mod:`fdd.greybox.machine` knows. Reduction of the argument after Cody and Waite (1980), the logarithm by the series of
2 artanh((m - 1) / (m + 1)) (as fdlibm, Sun 1993), carried in pow as an unevaluated sum of two numbers (Dekker, 1971).
Polynomials are fused where the processor can. Errors, measured against extended
precision by ``tests/greybox/test_lanes.py``: below 1 unit in the last place for exp, log and pow, below 1.5 for tanh.
Other functions (sin, cos) are called lane by lane.
"""

from __future__ import annotations

from collections.abc import Mapping


def width(features: Mapping[str, bool]) -> int:
    """Lanes for a processor: as many floats as its widest vectors hold."""
    if features.get("avx512f") and features.get("avx512dq"):
        return 8
    return 4 if features.get("avx2") else 2  # two: SSE2 and NEON


def fuses(features: Mapping[str, bool], triple: str) -> bool:
    """Whether a product and a sum in one rounding are one instruction."""
    return bool(features.get("fma")) or triple.startswith(("aarch64", "arm64"))


def _polynomial(name: str, coefficients: list[float], power: str = "x") -> list[str]:
    """Lines that leave a polynomial in ``name``, by pairs (Estrin), which waits less than one after the other."""
    terms, lines, level, at = [repr(c) for c in coefficients], [], 0, power
    while len(terms) > 1:
        pairs = [terms[i : i + 2] for i in range(0, len(terms), 2)]
        made = []
        for i, pair in enumerate(pairs):
            label = name if len(pairs) == 1 else f"{name}{level}_{i}"
            lines.append(f"{label} = {pair[0]} + {at} * {pair[1]}" if len(pair) == 2 else f"{label} = {pair[0]}")
            made.append(label)
        if len(made) > 1:
            lines.append(f"{name}{level} = {at} * {at}")
        terms, at, level = made, f"{name}{level}", level + 1
    return [f"    {line}" for line in lines]


_HEAD = """MAGIC = 6755399441055744.0
LN2_HIGH = 0.6931471805582987
LN2_LOW = 1.6465949582897082e-12
"""

_REDUCE = """    k = x * 1.4426950408889634 + MAGIC - MAGIC
    r = x - k * LN2_HIGH - (k * LN2_LOW - more)
"""

# Interpolation at Chebyshev's points on the reduced range: (exp r - 1 - r) / r**2 to 2**-61 of exp r, and
# ((artanh s / s - 1) / z - 1/3) / z of z = s**2 to 2**-66 of artanh.
_EXP = [
    0.5, 0.1666666666666667, 0.04166666666666667, 0.008333333333326084, 0.0013888888888883711,
    0.0001984126987500228, 2.480158732567746e-05, 2.755725517000089e-06, 2.755727347871858e-07,
    2.5105312729622103e-08, 2.09147553258932e-09,
]  # fmt: skip
_ARTANH = [
    0.2, 0.14285714285714685, 0.11111111110826383, 0.09090909168049924, 0.0769229744350359, 0.0666740439940617,
    0.05853063232281699, 0.058621635304233734,
]  # fmt: skip
_LOG = [
    0.6666666666666735130, 0.3999999999940941908, 0.2857142874366239149, 0.2222219843214978396, 0.1818357216161805012,
    0.1531383769920937332, 0.1479819860511658591,
]  # fmt: skip  # fdlibm's Lg1 to Lg7


def text() -> str:
    """Kernel text of ``lanes_exp``, ``lanes_log``, ``lanes_pow`` and ``lanes_tanh``."""
    return "\n".join([
        _HEAD,
        "def exp_of_sum(y: float, rest: float) -> float:",
        "    x = 710.0 if y > 710.0 else y",
        "    x = -746.0 if x < -746.0 else x",
        "    more = rest if x == y else 0.0",  # beyond, the rest may be anything
        _REDUCE,
        *_polynomial("q", _EXP, "r"),
        "    e = 1.0 + (r + r * r * q)",
        "    a = 0.5 * k + MAGIC - MAGIC",
        "    return e * power_of_two(a) * power_of_two(k - a)",
        "\n",
        "def lanes_exp(x: float) -> float:",
        "    return exp_of_sum(x, 0.0)",
        "\n",
        "def lanes_tanh(x: float) -> float:",
        "    neg = x < 0.0",
        "    a = fabs(x)",
        "    x = 44.0 if a > 22.0 else 2.0 * a",
        "    more = 0.0",
        _REDUCE,
        *_polynomial("q", _EXP, "r"),
        "    w = r * r * q",
        "    p = r + w",
        "    p_low = (r - p) + w",
        "    s = power_of_two(k)",
        "    g = s * p",  # e + e_low = exp(2 |x|) - 1
        "    v = s - 1.0",
        "    e = g + v",
        "    b = e - g",
        "    e_low = (g - (e - b)) + (v - b) + s * p_low",
        "    d = e + 2.0",
        "    b = d - e",
        "    d_low = (e - (d - b)) + (2.0 - b) + e_low",
        "    t = e / d",
        "    t = t + (e_low - t * d_low) / d",
        "    return -t if neg else t",
        "\n",
        "def lanes_log(x: float) -> float:",
        "    small = x < 2.2250738585072014e-308",
        "    y = x * 18014398509481984.0 if small else x",
        "    k = exponent_of(y) - (54.0 if small else 0.0)",
        "    f = fraction_of(y) - 1.0",
        "    s = f / (2.0 + f)",
        "    z = s * s",
        *_polynomial("q", _LOG, "z"),
        "    h = 0.5 * f * f",
        "    out = k * LN2_HIGH - ((h - (s * (h + z * q) + k * LN2_LOW)) - f)",
        "    out = x if x == inf or not (x == x) else out",
        "    out = nan if x < 0.0 else out",
        "    return -inf if x == 0.0 else out",
        "\n",
        "def lanes_pow(x: float, y: float) -> float:",
        "    a = fabs(x)",
        "    b = a",
        "    shift = 0.0",
        "    if a < 2.2250738585072014e-308:",
        "        b = a * 18014398509481984.0",
        "        shift = 54.0",
        "    k = exponent_of(b) - shift",
        "    m = fraction_of(b)",
        "    f = m - 1.0",
        "    d = m + 1.0",  # d + d_low = m + 1
        "    t = d - m",
        "    d_low = (m - (d - t)) + (1.0 - t)",
        "    s = f / d",  # s + s_low = (m - 1) / (m + 1)
        "    s_low = (-product_error(s, d, f) - s * d_low) * (1.0 / d)",
        "    z = s * s",
        "    z_low = product_error(s, s, z) + 2.0 * s * s_low",
        *_polynomial("q", _ARTANH, "z"),
        "    p = z * q",
        "    c = 0.3333333333333333 + p",
        "    c_low = (0.3333333333333333 - c) + p + 1.850371707708594e-17",
        "    v = z * c",
        "    v_low = product_error(z, c, v) + (z * c_low + z_low * c)",
        "    w = s * v",
        "    w_low = product_error(s, v, w) + (s * v_low + s_low * v)",
        "    l = s + w",
        "    l_low = (s - l) + w + (s_low + w_low)",
        "    n = k * LN2_HIGH",
        "    high = n + 2.0 * l",
        "    low = (n - high) + 2.0 * l + (2.0 * l_low + k * LN2_LOW)",
        "    e = y * high",
        "    e_low = product_error(y, high, e) + y * low",
        "    out = exp_of_sum(e, e_low)",
        "    if not (x > 0.0 and x < inf and fabs(y) < inf):",  # what no logarithm says
        "        out = (inf if y < 0.0 else 0.0) if a == 0.0 else out",
        "        out = (0.0 if y < 0.0 else inf) if a == inf else out",
        "        up = (a > 1.0 and y > 0.0) or (a < 1.0 and y < 0.0)",
        "        out = (inf if up else 0.0) if fabs(y) == inf else out",
        "        whole = floor(y) == y",
        "        half = 0.5 * y",
        "        odd = whole and not (floor(half) == half)",
        "        out = (-out if odd else out) if x < 0.0 else out",
        "        out = nan if x < 0.0 and not whole and a < inf else out",
        "        out = out if x == x and y == y else nan",
        "        out = 1.0 if y == 0.0 or x == 1.0 or (a == 1.0 and fabs(y) == inf) else out",
        "    return out",
    ]) + "\n"  # fmt: skip
