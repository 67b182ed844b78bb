"""What SymPy makes of thesis-spot: writes sympy_cse.c beside itself, to be timed by `cargo bench -p isophote-benches --bench aot`.

F, gradient and Hessian by differentiation and cse(optimizations="basic"), powers as products, one sum for each entry. The
loops around it have the row bounds of isophote's programs, and the sums are total over rows in double, as theirs are.
`python3 benches/src/speed/sympy_cse.py`; the benchmark needs what it wrote, not SymPy.
"""
import re
import sys
from pathlib import Path

try:
    import sympy as sp
    from sympy.printing.c import C99CodePrinter
except ImportError:
    sys.exit(print("SymPy is not installed: sympy_cse.c stays as it is"))

NAMES = "a1 a2 a3 bx by k1 k2 v0 v1"
a1, a2, a3, bx, by, k1, k2, v0, v1 = sp.symbols(NAMES)
x, y, phi = sp.symbols("x y phi")
dx, dy = x - bx, y - by
s = a1 * dx**2 + 2 * a2 * dx * dy + a3 * dy**2
F = (phi - (v1 * (1 + k1 * s + k2 * s**2 - (1 + k1 + k2) * s**3) + v0)) ** 2
SUBSETS = {"b": [bx, by], "a": [a1, a2, a3], "ab": [bx, by, a1, a2, a3], "abv": [bx, by, a1, a2, a3, v0, v1]}
HEAD = """/*
 * Loops of thesis-spot as SymPy {version} makes them: written by sympy_cse.py, which says how. Not to be edited.
 * Inputs are {names}; outputs are F, its gradient, and the upper triangle of its Hessian.
 */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
"""
FUNCTION = """
/* {flops} operations a pixel */
int32_t call_{name}(const void *pixels, const size_t *plane, const size_t *window, const double *inputs, double *outputs,
                    uint64_t *counts)
{{
    const float {inputs};
    const size_t width = window[2], height = window[3];
    double {totals};
    if (window[0] + width > plane[0] || window[1] + height > plane[1] || width == 0 || height == 0)
        return 0;
    counts[0] = counts[1] = 0;
    for (size_t row = 0; row < height; row++) {{
        const double first = (double)window[0], last = (double)(window[0] + width - 1), Y = (double)(window[1] + row) - inputs[4];
        const double root = sqrt(inputs[1] * inputs[1] * Y * Y - inputs[0] * (inputs[2] * Y * Y - 1.0));
        double lo = inputs[3] + (-inputs[1] * Y - root) / inputs[0], hi = inputs[3] + (-inputs[1] * Y + root) / inputs[0];
        if (!(lo <= hi))
            continue;
        lo = lo > first ? ceil(lo) : first;
        hi = hi < last ? floor(hi) : last;
        if (!(lo <= hi))
            continue;
        const size_t start = (size_t)lo;
        const int32_t count = (int32_t)((size_t)hi - start + 1);
        const float *const line = (const float *)pixels + (window[1] + row) * plane[3] + start;
        const float y = (float)(window[1] + row), x_first = (float)start;
        float {sums};
        for (int32_t i = 0; i < count; i++) {{
            const float x = x_first + (float)i, phi = line[i];
{body}
        }}
        counts[0] += (uint64_t)count;
{rows}
    }}
{ends}
    return 1;
}}
"""


class Products(C99CodePrinter):
    """Integer powers as products: with pow() left in, compilers make no vectors."""

    def _print_Pow(self, power):
        if power.exp.is_Integer and 1 < power.exp < 9:
            return "(" + "*".join([f"({self._print(power.base)})"] * int(power.exp)) + ")"
        return super()._print_Pow(power)


def c(expression):
    number = r"(?<![\w.])(\d+\.?\d*(?:e-?\d+)?)(?![\w.\[])"
    return re.sub(number, lambda m: (m[1] if "." in m[1] else m[1] + ".0") + "f", Products().doprint(expression))


def function(name, subset):
    hessian = [sp.diff(F, p, q) for i, p in enumerate(subset) for q in subset[i:]]
    shared, entries = sp.cse([F] + [sp.diff(F, p) for p in subset] + hessian, optimizations="basic")
    lines = lambda indent, texts: "\n".join(" " * indent + text for text in texts)
    count = range(len(entries))
    body = [f"const float {v} = {c(e)};" for v, e in shared] + [f"o{i} += {c(e)};" for i, e in enumerate(entries)]
    return FUNCTION.format(
        name=name,
        flops=sum(sp.count_ops(e) for _, e in shared) + sum(sp.count_ops(e) + 1 for e in entries),
        inputs=", ".join(f"{name} = (float)inputs[{i}]" for i, name in enumerate(NAMES.split())),
        totals=", ".join(f"t{i} = 0" for i in count),
        sums=", ".join(f"o{i} = 0" for i in count),
        body=lines(12, body),
        rows=lines(8, [f"t{i} += o{i};" for i in count]),
        ends=lines(4, [f"outputs[{i}] = t{i};" for i in count]),
    )


text = HEAD.format(version=sp.__version__, names=NAMES.replace(" ", ", "))
text += "".join(function(f"spot_{name}", subset) for name, subset in SUBSETS.items())
Path(__file__).with_suffix(".c").write_text(text)
