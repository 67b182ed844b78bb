/*
 * Gradient and Hessian over a1, a2, a3 as Maple wrote them: appendix A.1 of the master's thesis whose model is models/thesis-spot.toml
 * ("Maple Generated Functions"), quoted to be timed. What the printed page has lost is restored: a + in t20, a * in t55 and in t50,
 * and x, which has to start at the row's first whole pixel. The sum is that of r^2 / f, with f = 1 / ((1 + s) (1 + s^2 / 2)).
 */
#include <math.h>
#include <stddef.h>
#include <stdint.h>

#ifdef ROWS
#define PIXEL phi[y_int][x_int]
#else
#define PIXEL phi[x_int][y_int]
#endif

static void function_opt_a1a2a3(float **phi, float a1, float a2, float a3, float b_x, float b_y, float v0, float v1, int N,
                                int M, float *jac, float *hess)
{
    float t64, t2, t39, t3, t12, t5, t66, t49, t63, t20, t48, t47, t61, t58, t57, t27, t29, t65, t30, t31, t19, t9, t4;
    float t10, t7, t46, t50, t43, t44, t62, t59, t60, t11, t51, t54, t55, t45, t53;
    float hess11 = 0, hess12 = 0, hess22 = 0, hess13 = 0, hess23 = 0, hess33 = 0, jac1 = 0, jac2 = 0, jac3 = 0;
    int x_int, y_int, x_int_lower, x_int_upper;
    float x, y, x_lower, x_upper, D4;
    for (y = 1.f, y_int = 0; y_int < M; y_int++, y++) {
        D4 = a2 * a2 * (y - b_y) * (y - b_y) - a1 * (a3 * (y - b_y) * (y - b_y) - 1.0);
        if (D4 < 0) {
            x_int_lower = 0;
            x_int_upper = -1;
            x_lower = 1.f;
        } else {
            D4 = sqrt(D4);
            x_lower = (-a2 * (y - b_y) - D4) / a1 + b_x + 1.0;
            x_int_lower = floor(x_lower) - 1;
            x_lower = x_int_lower + 1;
            if (x_int_lower < 0) {
                x_lower = 1.f;
                x_int_lower = 0;
            }
            x_upper = (-a2 * (y - b_y) + D4) / a1 + b_x + 1.0;
            x_int_upper = ceil(x_upper) - 1;
            if (x_int_upper > N)
                x_int_upper = N;
        }
        for (x = x_lower, x_int = x_int_lower; x_int < x_int_upper; x_int++, x++)
            if (PIXEL < 255) {
                t31 = x - b_x;
                t29 = t31 * t31;
                t30 = y - b_y;
                t20 = t29 * a1 + (0.2e1f * t31 * a2 + t30 * a3) * t30;
                t65 = 0.1e1f + t20;
                t19 = t20 * t20;
                t9 = (0.5e0f * t19 + 0.1e1f) * t65;
                t58 = 0.2e1f / t9;
                t54 = PIXEL - v0;
                t2 = -v1 + t54 * t9;
                t7 = pow(t9, -0.2e1f);
                t66 = t2 * t2 * t7;
                t53 = t31 * t30;
                t10 = (0.2e1f + 0.2e1f * t20 + 0.3e1f * t19) * t53;
                t3 = t54 * t10;
                t50 = t3 * t58;
                t39 = 0.15e1f * t19 + t65;
                t12 = t39 * t29;
                t5 = t54 * t12;
                t49 = t5 * t58;
                t55 = t2 * t7;
                t47 = -0.20e1f * t55;
                t64 = t49 + t12 * t47;
                t48 = t66 * t58;
                t63 = t48 * t12;
                t51 = t2 * t58;
                t62 = -0.10e1f * t66 + t54 * t51;
                t57 = 0.1e1f + 0.3e1f * t20;
                t61 = t57 * t62;
                t27 = t30 * t30;
                t60 = t62 * t29 * t27;
                t59 = (0.2e1f + 0.6e1f * t20) * t53 * t62;
                t46 = -0.40e1f * t55;
                t11 = t39 * t27;
                t45 = t11 * t48;
                t44 = t11 * t47;
                t43 = t10 * t47;
                t4 = t54 * t11;
                hess11 = hess11 + t5 * t5 * t58 + t29 * t29 * t61 + (t5 * t46 + t63) * t12;
                hess12 = hess12 + t10 * t63 + t5 * t43 + t29 * t59 + t64 * t3;
                hess22 = hess22 + t10 * t10 * t48 + (0.4e1f + 0.12e2f * t20) * t60 + (t10 * t46 + t50) * t3;
                hess13 = hess13 + t12 * t45 + t5 * t44 + t57 * t60 + t64 * t4;
                hess23 = hess23 + t10 * t45 + t3 * t44 + t27 * t59 + (t50 + t43) * t4;
                hess33 = hess33 + t11 * t11 * t48 + (t11 * t46 + t58 * t4) * t4 + t27 * t27 * t61;
                jac1 = jac1 - 0.10e1f * t12 * t66 + t2 * t49;
                jac2 = jac2 - 0.10e1f * t10 * t66 + t2 * t50;
                jac3 = jac3 - 0.10e1f * t11 * t66 + t4 * t51;
            }
    }
    jac[0] = jac1;
    jac[1] = jac2;
    jac[2] = jac3;
    hess[0] = hess11;
    hess[1] = hess12;
    hess[2] = hess13;
    hess[3] = hess22;
    hess[4] = hess23;
    hess[5] = hess33;
}

/* Called as every contender is; inputs are a1, a2, a3, bx, by, v0, v1 with centres counted from 0. */
int32_t call_appendix_a1(const void *pixels, const size_t *plane, const size_t *window, const double *inputs, double *outputs,
                         uint64_t *counts)
{
    static float *lines[4096];
    const size_t width = window[2], height = window[3];
    float jac[3], hess[6];
#ifdef ROWS
    const size_t count = height, length = width;
#else
    const size_t count = width, length = height;
#endif
    if (plane[0] * plane[1] < width * height || count > 4096)
        return 0;
    for (size_t i = 0; i < count; i++)
        lines[i] = (float *)pixels + i * length;
    function_opt_a1a2a3(lines, inputs[0], inputs[1], inputs[2], inputs[3] + 1, inputs[4] + 1, inputs[5], inputs[6], width,
                        height, jac, hess);
    for (int i = 0; i < 3; i++)
        outputs[i] = jac[i];
    for (int i = 0; i < 6; i++)
        outputs[3 + i] = hess[i];
    counts[0] = counts[1] = 0;
    return 1;
}
