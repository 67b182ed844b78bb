/*
 * Loops of thesis-spot as SymPy 1.14.0 makes them: written by sympy_cse.py, which says how. Not to be edited.
 * Inputs are a1, a2, a3, bx, by, k1, k2, v0, v1; outputs are F, its gradient, and the upper triangle of its Hessian.
 */
#include <math.h>
#include <stddef.h>
#include <stdint.h>

/* 99 operations a pixel */
int32_t call_spot_b(const void *pixels, const size_t *plane, const size_t *window, const double *inputs, double *outputs,
                    uint64_t *counts)
{
    const float a1 = (float)inputs[0], a2 = (float)inputs[1], a3 = (float)inputs[2], bx = (float)inputs[3], by = (float)inputs[4], k1 = (float)inputs[5], k2 = (float)inputs[6], v0 = (float)inputs[7], v1 = (float)inputs[8];
    const size_t width = window[2], height = window[3];
    double t0 = 0, t1 = 0, t2 = 0, t3 = 0, t4 = 0, t5 = 0;
    if (window[0] + width > plane[0] || window[1] + height > plane[1] || width == 0 || height == 0)
        return 0;
    counts[0] = counts[1] = 0;
    for (size_t row = 0; row < height; row++) {
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
        float o0 = 0, o1 = 0, o2 = 0, o3 = 0, o4 = 0, o5 = 0;
        for (int32_t i = 0; i < count; i++) {
            const float x = x_first + (float)i, phi = line[i];
            const float x0 = bx - x;
            const float x1 = by - y;
            const float x2 = a2*x1;
            const float x3 = a1*((x0)*(x0)) + a3*((x1)*(x1)) + 2.0f*x0*x2;
            const float x4 = ((x3)*(x3));
            const float x5 = k1 + k2 + 1.0f;
            const float x6 = -phi + v0 + v1*(k1*x3 + k2*x4 - ((x3)*(x3)*(x3))*x5 + 1.0f);
            const float x7 = a1*x0 + x2;
            const float x8 = 2.0f*k2*x3;
            const float x9 = 3.0f*x4*x5;
            const float x10 = k1 + x8 - x9;
            const float x11 = 4.0f*v1;
            const float x12 = x10*x11*x6;
            const float x13 = a3*x1;
            const float x14 = ((x7)*(x7));
            const float x15 = 2.0f*v1*((x10)*(x10));
            const float x16 = 4.0f*k2;
            const float x17 = 12.0f*x3*x5;
            const float x18 = a2*x0 + x13;
            const float x19 = x18*x7;
            const float x20 = ((x18)*(x18));
            o0 += ((x6)*(x6));
            o1 += x12*x7;
            o2 += -x12*(-a2*x0 - x13);
            o3 += x11*(x14*x15 + x6*(a1*k1 + a1*x8 - a1*x9 + x14*x16 - x14*x17));
            o4 += x11*(x15*x19 + x6*(a2*k1 + a2*x8 - a2*x9 + x16*x19 - x17*x19));
            o5 += x11*(x15*x20 + x6*(a3*k1 + a3*x8 - a3*x9 + x16*x20 - x17*x20));
        }
        counts[0] += (uint64_t)count;
        t0 += o0;
        t1 += o1;
        t2 += o2;
        t3 += o3;
        t4 += o4;
        t5 += o5;
    }
    outputs[0] = t0;
    outputs[1] = t1;
    outputs[2] = t2;
    outputs[3] = t3;
    outputs[4] = t4;
    outputs[5] = t5;
    return 1;
}

/* 72 operations a pixel */
int32_t call_spot_a(const void *pixels, const size_t *plane, const size_t *window, const double *inputs, double *outputs,
                    uint64_t *counts)
{
    const float a1 = (float)inputs[0], a2 = (float)inputs[1], a3 = (float)inputs[2], bx = (float)inputs[3], by = (float)inputs[4], k1 = (float)inputs[5], k2 = (float)inputs[6], v0 = (float)inputs[7], v1 = (float)inputs[8];
    const size_t width = window[2], height = window[3];
    double t0 = 0, t1 = 0, t2 = 0, t3 = 0, t4 = 0, t5 = 0, t6 = 0, t7 = 0, t8 = 0, t9 = 0;
    if (window[0] + width > plane[0] || window[1] + height > plane[1] || width == 0 || height == 0)
        return 0;
    counts[0] = counts[1] = 0;
    for (size_t row = 0; row < height; row++) {
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
        float o0 = 0, o1 = 0, o2 = 0, o3 = 0, o4 = 0, o5 = 0, o6 = 0, o7 = 0, o8 = 0, o9 = 0;
        for (int32_t i = 0; i < count; i++) {
            const float x = x_first + (float)i, phi = line[i];
            const float x0 = bx - x;
            const float x1 = ((x0)*(x0));
            const float x2 = by - y;
            const float x3 = ((x2)*(x2));
            const float x4 = x0*x2;
            const float x5 = a1*x1 + 2.0f*a2*x4 + a3*x3;
            const float x6 = ((x5)*(x5));
            const float x7 = k1 + k2 + 1.0f;
            const float x8 = -phi + v0 + v1*(k1*x5 + k2*x6 - ((x5)*(x5)*(x5))*x7 + 1.0f);
            const float x9 = 2.0f*x8;
            const float x10 = 3.0f*x7;
            const float x11 = k1 + 2.0f*k2*x5 - x10*x6;
            const float x12 = v1*x11;
            const float x13 = x12*x9;
            const float x14 = v1*(v1*((x11)*(x11)) + x9*(k2 - x10*x5));
            const float x15 = 2.0f*x14;
            const float x16 = 4.0f*x14;
            const float x17 = x1*x3;
            o0 += ((x8)*(x8));
            o1 += x1*x13;
            o2 += 4.0f*x12*x4*x8;
            o3 += x13*x3;
            o4 += ((x0)*(x0)*(x0)*(x0))*x15;
            o5 += ((x0)*(x0)*(x0))*x16*x2;
            o6 += x15*x17;
            o7 += 8.0f*x14*x17;
            o8 += x0*x16*((x2)*(x2)*(x2));
            o9 += x15*((x2)*(x2)*(x2)*(x2));
        }
        counts[0] += (uint64_t)count;
        t0 += o0;
        t1 += o1;
        t2 += o2;
        t3 += o3;
        t4 += o4;
        t5 += o5;
        t6 += o6;
        t7 += o7;
        t8 += o8;
        t9 += o9;
    }
    outputs[0] = t0;
    outputs[1] = t1;
    outputs[2] = t2;
    outputs[3] = t3;
    outputs[4] = t4;
    outputs[5] = t5;
    outputs[6] = t6;
    outputs[7] = t7;
    outputs[8] = t8;
    outputs[9] = t9;
    return 1;
}

/* 186 operations a pixel */
int32_t call_spot_ab(const void *pixels, const size_t *plane, const size_t *window, const double *inputs, double *outputs,
                    uint64_t *counts)
{
    const float a1 = (float)inputs[0], a2 = (float)inputs[1], a3 = (float)inputs[2], bx = (float)inputs[3], by = (float)inputs[4], k1 = (float)inputs[5], k2 = (float)inputs[6], v0 = (float)inputs[7], v1 = (float)inputs[8];
    const size_t width = window[2], height = window[3];
    double t0 = 0, t1 = 0, t2 = 0, t3 = 0, t4 = 0, t5 = 0, t6 = 0, t7 = 0, t8 = 0, t9 = 0, t10 = 0, t11 = 0, t12 = 0, t13 = 0, t14 = 0, t15 = 0, t16 = 0, t17 = 0, t18 = 0, t19 = 0, t20 = 0;
    if (window[0] + width > plane[0] || window[1] + height > plane[1] || width == 0 || height == 0)
        return 0;
    counts[0] = counts[1] = 0;
    for (size_t row = 0; row < height; row++) {
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
        float o0 = 0, o1 = 0, o2 = 0, o3 = 0, o4 = 0, o5 = 0, o6 = 0, o7 = 0, o8 = 0, o9 = 0, o10 = 0, o11 = 0, o12 = 0, o13 = 0, o14 = 0, o15 = 0, o16 = 0, o17 = 0, o18 = 0, o19 = 0, o20 = 0;
        for (int32_t i = 0; i < count; i++) {
            const float x = x_first + (float)i, phi = line[i];
            const float x0 = bx - x;
            const float x1 = ((x0)*(x0));
            const float x2 = by - y;
            const float x3 = ((x2)*(x2));
            const float x4 = a2*x2;
            const float x5 = 2.0f*x0;
            const float x6 = a1*x1 + a3*x3 + x4*x5;
            const float x7 = ((x6)*(x6));
            const float x8 = k1 + k2 + 1.0f;
            const float x9 = -phi + v0 + v1*(k1*x6 + k2*x7 - ((x6)*(x6)*(x6))*x8 + 1.0f);
            const float x10 = a1*x0 + x4;
            const float x11 = 4.0f*v1;
            const float x12 = x10*x11;
            const float x13 = 2.0f*k2;
            const float x14 = x13*x6;
            const float x15 = 3.0f*x8;
            const float x16 = x15*x7;
            const float x17 = k1 + x14 - x16;
            const float x18 = x17*x9;
            const float x19 = a3*x2;
            const float x20 = 2.0f*x9;
            const float x21 = v1*x17*x20;
            const float x22 = x0*x11;
            const float x23 = ((x10)*(x10));
            const float x24 = v1*((x17)*(x17));
            const float x25 = 2.0f*x24;
            const float x26 = 4.0f*k2;
            const float x27 = x6*x8;
            const float x28 = 12.0f*x27;
            const float x29 = a2*x0 + x19;
            const float x30 = x10*x29;
            const float x31 = x10*x26;
            const float x32 = x0*x10;
            const float x33 = 6.0f*x27;
            const float x34 = x11*x2;
            const float x35 = x20*(k2 - x15*x6) + x24;
            const float x36 = ((x29)*(x29));
            const float x37 = x2*x29;
            const float x38 = v1*x35;
            const float x39 = 2.0f*x38;
            const float x40 = x1*x3;
            o0 += ((x9)*(x9));
            o1 += x12*x18;
            o2 += -x11*x18*(-a2*x0 - x19);
            o3 += x1*x21;
            o4 += x18*x2*x22;
            o5 += x21*x3;
            o6 += x11*(x23*x25 + x9*(a1*k1 + a1*x14 - a1*x16 + x23*x26 - x23*x28));
            o7 += x11*(x25*x30 + x9*(a2*k1 + a2*x14 - a2*x16 - x28*x30 + x29*x31));
            o8 += x22*(x24*x32 + x9*(x13*x32 + x17 - x32*x33));
            o9 += x34*(x10*x24*x5 + x9*(x0*x31 + x17 - x28*x32));
            o10 += x12*x3*x35;
            o11 += x11*(x25*x36 + x9*(a3*k1 + a3*x14 - a3*x16 + x26*x36 - x28*x36));
            o12 += x1*x11*x29*x35;
            o13 += x22*(x25*x37 + x9*(x17 + x26*x37 - x28*x37));
            o14 += x34*(x24*x37 + x9*(x13*x37 + x17 - x33*x37));
            o15 += ((x0)*(x0)*(x0)*(x0))*x39;
            o16 += ((x0)*(x0)*(x0))*x34*x35;
            o17 += x39*x40;
            o18 += 8.0f*x38*x40;
            o19 += ((x2)*(x2)*(x2))*x22*x35;
            o20 += ((x2)*(x2)*(x2)*(x2))*x39;
        }
        counts[0] += (uint64_t)count;
        t0 += o0;
        t1 += o1;
        t2 += o2;
        t3 += o3;
        t4 += o4;
        t5 += o5;
        t6 += o6;
        t7 += o7;
        t8 += o8;
        t9 += o9;
        t10 += o10;
        t11 += o11;
        t12 += o12;
        t13 += o13;
        t14 += o14;
        t15 += o15;
        t16 += o16;
        t17 += o17;
        t18 += o18;
        t19 += o19;
        t20 += o20;
    }
    outputs[0] = t0;
    outputs[1] = t1;
    outputs[2] = t2;
    outputs[3] = t3;
    outputs[4] = t4;
    outputs[5] = t5;
    outputs[6] = t6;
    outputs[7] = t7;
    outputs[8] = t8;
    outputs[9] = t9;
    outputs[10] = t10;
    outputs[11] = t11;
    outputs[12] = t12;
    outputs[13] = t13;
    outputs[14] = t14;
    outputs[15] = t15;
    outputs[16] = t16;
    outputs[17] = t17;
    outputs[18] = t18;
    outputs[19] = t19;
    outputs[20] = t20;
    return 1;
}

/* 225 operations a pixel */
int32_t call_spot_abv(const void *pixels, const size_t *plane, const size_t *window, const double *inputs, double *outputs,
                    uint64_t *counts)
{
    const float a1 = (float)inputs[0], a2 = (float)inputs[1], a3 = (float)inputs[2], bx = (float)inputs[3], by = (float)inputs[4], k1 = (float)inputs[5], k2 = (float)inputs[6], v0 = (float)inputs[7], v1 = (float)inputs[8];
    const size_t width = window[2], height = window[3];
    double t0 = 0, t1 = 0, t2 = 0, t3 = 0, t4 = 0, t5 = 0, t6 = 0, t7 = 0, t8 = 0, t9 = 0, t10 = 0, t11 = 0, t12 = 0, t13 = 0, t14 = 0, t15 = 0, t16 = 0, t17 = 0, t18 = 0, t19 = 0, t20 = 0, t21 = 0, t22 = 0, t23 = 0, t24 = 0, t25 = 0, t26 = 0, t27 = 0, t28 = 0, t29 = 0, t30 = 0, t31 = 0, t32 = 0, t33 = 0, t34 = 0, t35 = 0;
    if (window[0] + width > plane[0] || window[1] + height > plane[1] || width == 0 || height == 0)
        return 0;
    counts[0] = counts[1] = 0;
    for (size_t row = 0; row < height; row++) {
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
        float o0 = 0, o1 = 0, o2 = 0, o3 = 0, o4 = 0, o5 = 0, o6 = 0, o7 = 0, o8 = 0, o9 = 0, o10 = 0, o11 = 0, o12 = 0, o13 = 0, o14 = 0, o15 = 0, o16 = 0, o17 = 0, o18 = 0, o19 = 0, o20 = 0, o21 = 0, o22 = 0, o23 = 0, o24 = 0, o25 = 0, o26 = 0, o27 = 0, o28 = 0, o29 = 0, o30 = 0, o31 = 0, o32 = 0, o33 = 0, o34 = 0, o35 = 0;
        for (int32_t i = 0; i < count; i++) {
            const float x = x_first + (float)i, phi = line[i];
            const float x0 = bx - x;
            const float x1 = ((x0)*(x0));
            const float x2 = by - y;
            const float x3 = ((x2)*(x2));
            const float x4 = a2*x2;
            const float x5 = 2.0f*x0;
            const float x6 = a1*x1 + a3*x3 + x4*x5;
            const float x7 = ((x6)*(x6));
            const float x8 = k1 + k2 + 1.0f;
            const float x9 = k1*x6 + k2*x7 - ((x6)*(x6)*(x6))*x8 + 1.0f;
            const float x10 = v1*x9;
            const float x11 = -phi + v0;
            const float x12 = x10 + x11;
            const float x13 = 4.0f*v1;
            const float x14 = a1*x0 + x4;
            const float x15 = 2.0f*k2;
            const float x16 = x15*x6;
            const float x17 = 3.0f*x8;
            const float x18 = x17*x7;
            const float x19 = k1 + x16 - x18;
            const float x20 = x14*x19;
            const float x21 = x13*x20;
            const float x22 = a3*x2;
            const float x23 = x12*x19;
            const float x24 = x1*x19;
            const float x25 = 2.0f*x12;
            const float x26 = v1*x25;
            const float x27 = x0*x13;
            const float x28 = x19*x3;
            const float x29 = ((x14)*(x14));
            const float x30 = v1*((x19)*(x19));
            const float x31 = 2.0f*x30;
            const float x32 = 4.0f*k2;
            const float x33 = x6*x8;
            const float x34 = 12.0f*x33;
            const float x35 = a2*x0 + x22;
            const float x36 = x14*x35;
            const float x37 = x14*x32;
            const float x38 = x0*x14;
            const float x39 = 6.0f*x33;
            const float x40 = x13*x2;
            const float x41 = x25*(k2 - x17*x6) + x30;
            const float x42 = x13*x41;
            const float x43 = 2.0f*x10 + x11;
            const float x44 = 4.0f*x43;
            const float x45 = ((x35)*(x35));
            const float x46 = x2*x35;
            const float x47 = x19*x35;
            const float x48 = 2.0f*v1;
            const float x49 = x41*x48;
            const float x50 = x1*x3;
            const float x51 = 2.0f*x43;
            const float x52 = x19*x2;
            o0 += ((x12)*(x12));
            o1 += x12*x21;
            o2 += -x13*x23*(-a2*x0 - x22);
            o3 += x24*x26;
            o4 += x2*x23*x27;
            o5 += x26*x28;
            o6 += 2.0f*x12;
            o7 += x25*x9;
            o8 += x13*(x12*(a1*k1 + a1*x16 - a1*x18 + x29*x32 - x29*x34) + x29*x31);
            o9 += x13*(x12*(a2*k1 + a2*x16 - a2*x18 - x34*x36 + x35*x37) + x31*x36);
            o10 += x27*(x12*(x15*x38 + x19 - x38*x39) + x30*x38);
            o11 += x40*(x12*(x0*x37 + x19 - x34*x38) + x14*x30*x5);
            o12 += x14*x3*x42;
            o13 += x21;
            o14 += x20*x44;
            o15 += x13*(x12*(a3*k1 + a3*x16 - a3*x18 + x32*x45 - x34*x45) + x31*x45);
            o16 += x1*x35*x42;
            o17 += x27*(x12*(x19 + x32*x46 - x34*x46) + x31*x46);
            o18 += x40*(x12*(x15*x46 + x19 - x39*x46) + x30*x46);
            o19 += x13*x47;
            o20 += x44*x47;
            o21 += ((x0)*(x0)*(x0)*(x0))*x49;
            o22 += ((x0)*(x0)*(x0))*x40*x41;
            o23 += x49*x50;
            o24 += x24*x48;
            o25 += x24*x51;
            o26 += 8.0f*v1*x41*x50;
            o27 += ((x2)*(x2)*(x2))*x27*x41;
            o28 += x27*x52;
            o29 += x0*x44*x52;
            o30 += ((x2)*(x2)*(x2)*(x2))*x49;
            o31 += x28*x48;
            o32 += x28*x51;
            o33 += 2.0f;
            o34 += 2.0f*x9;
            o35 += 2.0f*((x9)*(x9));
        }
        counts[0] += (uint64_t)count;
        t0 += o0;
        t1 += o1;
        t2 += o2;
        t3 += o3;
        t4 += o4;
        t5 += o5;
        t6 += o6;
        t7 += o7;
        t8 += o8;
        t9 += o9;
        t10 += o10;
        t11 += o11;
        t12 += o12;
        t13 += o13;
        t14 += o14;
        t15 += o15;
        t16 += o16;
        t17 += o17;
        t18 += o18;
        t19 += o19;
        t20 += o20;
        t21 += o21;
        t22 += o22;
        t23 += o23;
        t24 += o24;
        t25 += o25;
        t26 += o26;
        t27 += o27;
        t28 += o28;
        t29 += o29;
        t30 += o30;
        t31 += o31;
        t32 += o32;
        t33 += o33;
        t34 += o34;
        t35 += o35;
    }
    outputs[0] = t0;
    outputs[1] = t1;
    outputs[2] = t2;
    outputs[3] = t3;
    outputs[4] = t4;
    outputs[5] = t5;
    outputs[6] = t6;
    outputs[7] = t7;
    outputs[8] = t8;
    outputs[9] = t9;
    outputs[10] = t10;
    outputs[11] = t11;
    outputs[12] = t12;
    outputs[13] = t13;
    outputs[14] = t14;
    outputs[15] = t15;
    outputs[16] = t16;
    outputs[17] = t17;
    outputs[18] = t18;
    outputs[19] = t19;
    outputs[20] = t20;
    outputs[21] = t21;
    outputs[22] = t22;
    outputs[23] = t23;
    outputs[24] = t24;
    outputs[25] = t25;
    outputs[26] = t26;
    outputs[27] = t27;
    outputs[28] = t28;
    outputs[29] = t29;
    outputs[30] = t30;
    outputs[31] = t31;
    outputs[32] = t32;
    outputs[33] = t33;
    outputs[34] = t34;
    outputs[35] = t35;
    return 1;
}
