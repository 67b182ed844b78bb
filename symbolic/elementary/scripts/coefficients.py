#!/usr/bin/env python3
"""Writes src/coefficients.rs: python3 scripts/coefficients.py > src/coefficients.rs, and
python3 scripts/coefficients.py waves > src/wave_coefficients.rs

Each polynomial interpolates its function at Chebyshev nodes, which is within a small factor of the best one, and is
rounded to f64. The error in its comment is measured with the rounded coefficients."""
import sys

from mpmath import (mp, mpf, cos, pi, exp, log, sin, tan, atan, asin, sinh, tanh, erf, erfc, sqrt, atanh, floor, besselj,
                    bessely)

mp.dps = 60
GRID = 400


def chebyshev(g, low, high, count):
    """Coefficients, in powers of the variable, of the polynomial through `count` Chebyshev nodes."""
    middle, half = (low + high) / 2, (high - low) / 2
    nodes = [middle + half * cos(pi * (2 * i + 1) / (2 * count)) for i in range(count)]
    powers = mp.matrix(count, count)
    for i, z in enumerate(nodes):
        for j in range(count):
            powers[i, j] = z ** j
    return [float(c) for c in mp.lu_solve(powers, mp.matrix([g(z) for z in nodes]))]


def polynomial(coefficients, z):
    return mp.polyval([mpf(c) for c in reversed(coefficients)], z)


def table(name, formula, g, span, whole, counts):
    """`whole(z, p)` is the error of the function relative to it when the polynomial's value is p."""
    low, high = map(mpf, span)
    for accuracy, count in zip(("SINGLE", "DOUBLE"), counts):
        if count is None:
            continue
        found = chebyshev(g, low, high, count)
        grid = [low + (high - low) * (i + mpf(1) / 2) / GRID for i in range(GRID)]
        worst = max(abs(whole(z, polynomial(found, z))) for z in grid)
        print(f"/// {formula}; argument in [{float(low):.4}, {float(high):.4}], relative error 2^{float(log(worst, 2)):.1f}.")
        print(f"pub(super) const {name}_{accuracy}: [f64; {count}] = [")
        for c in found:
            print(f"    {c!r},")
        print("];\n")


def odd(f, start=1):
    """The polynomial part of f(x) = x (start + z P(z)), z = x², and the error that a value of it leaves."""
    def part(z):
        x = sqrt(z)
        return (f(x) / x - start) / z
    return part, lambda z, p: (start + z * p) * sqrt(z) / f(sqrt(z)) - 1


def parts(name, formula, value, bits):
    """A constant as a sum of numbers with that many bits each; the last has 53."""
    print(f"/// {formula}, in parts of {bits} bits.")
    rest, found = value, []
    for width in bits:
        exponent = floor(log(abs(rest), 2))
        unit = mpf(2) ** (exponent - width + 1)
        part = (floor(rest / unit) if width < 53 else floor(rest / unit + mpf(1) / 2)) * unit
        assert mpf(float(part)) == part
        found.append(float(part))
        rest -= part
    print(f"pub(super) const {name}: [f64; {len(bits)}] = {found!r};\n")


if sys.argv[1:] == ["waves"]:
    print("""//! Coefficients of the Bessel functions and of sinc, lowest power first.
//!
//! Written by `scripts/coefficients.py waves`, which says how they are found. `SINGLE` is for results that are rounded to
//! f32; relative errors are of the height of the waves.
""")
    c = mpf(32)
    x_of = lambda t: sqrt(c * (1 + t))
    for n, start in ((0, mpf(1)), (1, mpf(1) / 2), (2, mpf(1) / 8)):
        g = lambda t: (besselj(n, x_of(t)) / x_of(t) ** n - start) / (c * (1 + t))
        envelope = lambda x: min(start, sqrt(2 / (pi * x)) / x ** n)
        table(f"BESSEL_{n}", f"Jₙ(x)/xⁿ = {float(start)} + z P(t), n = {n}, z = x² = 32 (1 + t)", g, ("-0.99999999999", 1),
              lambda t, p: (p - g(t)) * c * (1 + t) / envelope(x_of(t)), (11, 21))
    for n in (0, 1):
        x_of = lambda w: 8 / sqrt(w)
        def waves(w):
            """√(πx/2) times Jₙ and Yₙ, and cos and sin of the angle."""
            x = x_of(w)
            angle = x - pi / 4 - n * pi / 2
            return [sqrt(pi * x / 2) * besselj(n, x), sqrt(pi * x / 2) * bessely(n, x), cos(angle), sin(angle)]
        def even(w):
            j, y, cosine, sine = waves(w)
            return j * cosine + y * sine
        def uneven(w):
            j, y, cosine, sine = waves(w)
            return (y * cosine - j * sine) / sqrt(w)
        table(f"HANKEL_P{n}", f"√(πx/2) (Jₙ cos χ + Yₙ sin χ) = P(w), n = {n}, w = 64/x², χ = x − (2n + 1) π/4", even,
              ("1e-8", 1), lambda w, p: p - even(w), (5, 14))
        table(f"HANKEL_Q{n}", f"√(πx/2) (Yₙ cos χ − Jₙ sin χ) = 8/x P(w), n = {n}", uneven, ("1e-8", 1),
              lambda w, p: p - uneven(w), (5, 14))
    g = lambda z: ((sin(sqrt(z)) / sqrt(z) - cos(sqrt(z))) / z - mpf(1) / 3) / z
    table("SINC", "(sin x/x − cos x)/x² = ⅓ + z P(z), z = x²", g, ("1e-20", 4),
          lambda z, p: (p - g(z)) * z / (mpf(1) / 3 + z * g(z)), (5, 12))
    sys.exit()
print("""//! Coefficients of the elementary functions, lowest power first, and constants in parts.
//!
//! Written by scripts/coefficients.py, which says how they are found. `SINGLE` is for results that are rounded to f32.
#![allow(clippy::approx_constant)]
""")
r = log(2) / 2 * mpf("1.001")
table("EXP", "e^r = 1 + r + r² P(r)", lambda r: (exp(r) - 1 - r) / r**2, (-r, r * mpf("1.001")),
      lambda r, p: (1 + r + r * r * p) / exp(r) - 1, (6, 11))
z = ((sqrt(2) - 1) / (sqrt(2) + 1)) ** 2 * mpf("1.001")
g, e = odd(lambda s: 2 * atanh(s), 2)
table("LOG", "ln((1 + s)/(1 − s)) = 2s + s z P(z), z = s²", g, ("1e-30", z), e, (3, 7))
table("POWER", "ln((1 + s)/(1 − s)) = 2s + ⅔ s z + s z² P(z), z = s²", lambda z: (g(z) - mpf(2) / 3) / z,
      ("1e-20", z), lambda z, p: e(z, mpf(2) / 3 + z * p), (None, 9))
table("LOG_VARIANCE", "ln(1 + f) = f − f²/2 + f³ P(f)", lambda f: (log(1 + f) - f + f**2 / 2) / f**3,
      (sqrt(mpf(1) / 2) - 1, sqrt(2) - 1), lambda f, p: (f - f**2 / 2 + f**3 * p) / log(1 + f) - 1, (9, None))
z = (pi / 4) ** 2 * mpf("1.001")
g, e = odd(sin)
table("SIN", "sin r = r + r z P(z), z = r²", g, ("1e-30", z), e, (4, 7))
table("COS", "cos r = 1 − z/2 + z² P(z), z = r²", lambda z: (cos(sqrt(z)) - 1 + z / 2) / z**2, ("1e-20", z),
      lambda z, p: (1 - z / 2 + z * z * p) / cos(sqrt(z)) - 1, (3, 6))
g, e = odd(atan)
table("ATAN", "arctan u = u + u z P(z), z = u²", g, ("1e-30", 1), e, (11, 23))
g, e = odd(asin)
table("ASIN", "arcsin x = x + x z P(z), z = x²", g, ("1e-30", "0.2501"), e, (7, 14))
g, e = odd(sinh)
table("SINH", "sinh x = x + x z P(z), z = x²", g, ("1e-30", 1), e, (4, 8))
g, e = odd(tanh)
table("TANH", "tanh x = x + x z P(z), z = x²", g, ("1e-30", "0.5625"), e, (7, 14))
table("ERF", "erf x = x + x P(z), z = x²", lambda z: erf(sqrt(z)) / sqrt(z) - 1, ("1e-30", 1),
      lambda z, p: (1 + p) * sqrt(z) / erf(sqrt(z)) - 1, (8, 15))
c, t = mpf(2.5), lambda a: (a - c) / (a + c)
a = lambda t: c * (1 + t) / (1 - t)
g = lambda t: exp(a(t) ** 2) * erfc(a(t))
table("ERFC", "1 − erf a = e^(−a²) P(t), t = (a − 2.5)/(a + 2.5), 1 ≤ a ≤ 6", g, (t(1), t(6)),
      lambda t, p: (p - g(t)) * exp(-a(t) ** 2) / erf(a(t)), (9, 18))
c, scaled = mpf(2), lambda a: exp(a ** 2) * erfc(a) if a < mpf("1e7") else 1 / (a * sqrt(pi)) * (1 - 1 / (2 * a * a))
g = lambda t: (1 + 2 * a(t)) * scaled(a(t))
table("TAIL", "e^(a²) (1 − erf a) (1 + 2a) = P(t), t = (a − 2)/(a + 2), a ≥ 0", g, (-1, "0.99999999"),
      lambda t, p: p / g(t) - 1, (14, 27))
parts("LN_2", "ln 2", log(2), (32, 53))
parts("LN_2_SINGLE", "ln 2", log(2), (16, 53))
parts("LN_2_DOUBLE", "ln 2", log(2), (42, 42, 53))
parts("HALF_PI", "π/2", pi / 2, (33, 33, 33, 53))
parts("HALF_PI_SHORT", "π/2", pi / 2, (33, 53))
parts("HALF_PI_DOUBLE", "π/2", pi / 2, (53, 53))
parts("PI_DOUBLE", "π", pi, (53, 53))
parts("TWO_THIRDS", "⅔", mpf(2) / 3, (53, 53))
mp.prec = 1600
bits = int(floor(2 / pi * mpf(2) ** 1280))
print("/// 2/π: 64 bits before the point, 1,280 after it.")
print("pub(super) const TWO_OVER_PI: [u64; 21] = [")
for i in range(21):
    print(f"    0x{(bits >> (64 * (20 - i))) & (2**64 - 1):016x},")
print("];")
