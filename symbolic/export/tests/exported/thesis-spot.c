/*
 * thesis-spot: Elliptical light spot with a cubic radial profile (thesis, section 4.1.3)
 * Written by isophote 0.1.0 from the model sha256:cba83886b2e2a94c7c57162a24c86b7de0618d164b3476627615edf9e71ff4e7
 *
 * Sums over the pixels of a window:
 *   outputs[0]  F
 *   outputs[1]  dF/dbx
 *   outputs[2]  dF/dby
 *   outputs[3]  d2F/dbxdbx
 *   outputs[4]  d2F/dbxdby
 *   outputs[5]  d2F/dbydby
 *
 * What goes in:
 *   inputs[0]  a1 when the pass was entered: it fixes which pixels take part
 *   inputs[1]  a2 when the pass was entered: it fixes which pixels take part
 *   inputs[2]  by when the pass was entered: it fixes which pixels take part
 *   inputs[3]  bx when the pass was entered: it fixes which pixels take part
 *   inputs[4]  a3 when the pass was entered: it fixes which pixels take part
 *   inputs[5]  k2
 *   inputs[6]  k1
 *   inputs[7]  v1
 *   inputs[8]  a1
 *   inputs[9]  a2
 *   inputs[10]  by, px
 *   inputs[11]  bx, px
 *   inputs[12]  a3
 *   inputs[13]  v0
 *   plane of `phi`: u8, pixel values as stored
 *
 * Coordinates are pixels of the whole plane, centres at whole numbers, the inner loop first:
 *   `x`, `y`; a plane has size and strides along 2 of them, counted in pixels
 *
 * Arithmetic: f32 a pixel; f64 for rows and passes, 1 pixel(s) at a time. It is the interpreter's, bit for bit,
 * as long as the compiler neither contracts a * b + c (-ffp-contract=off) nor reorders sums; -ffast-math would besides lose
 * the test that leaves out rows without pixels, whose bounds are NaN: add -fno-finite-math-only to it
 *
 * Returns 1; 0, and nothing is written, for a window that is empty or leaves a plane.
 */
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* A plane: its first pixel, pixels along each coordinate, and how far it is to the next one, in pixels. */
typedef struct {
    const uint8_t *pixels;
    size_t size[2];
    size_t strides[2];
} isophote_thesis_spot_plane_u8;

/* The pixels to process: the first along each coordinate, and how many. */
typedef struct {
    size_t first[2];
    size_t size[2];
} isophote_thesis_spot_window;

typedef struct {
    double outputs[6];
    uint64_t pixels;    /* used */
    uint64_t saturated; /* left out as saturated */
} isophote_thesis_spot_sums;

int isophote_thesis_spot(isophote_thesis_spot_plane_u8 phi_plane, isophote_thesis_spot_window window, const double inputs[14], isophote_thesis_spot_sums *sums);

int isophote_thesis_spot(isophote_thesis_spot_plane_u8 phi_plane, isophote_thesis_spot_window window, const double inputs[14], isophote_thesis_spot_sums *sums)
{
    for (size_t i = 0; i < 2; i++) {
        if (window.size[i] == 0) return 0;
        if (window.first[i] > phi_plane.size[i]) return 0;
        if (window.size[i] > phi_plane.size[i] - window.first[i]) return 0;
    }
    uint64_t pixels = 0, saturated = 0;
    double total0 = 0.0;
    double total1 = 0.0;
    double total2 = 0.0;
    double total3 = 0.0;
    double total4 = 0.0;
    double total5 = 0.0;
    double total6 = 0.0;
    /* pass */
    const double a1_entry = inputs[0];
    /* X' * A * X */
    const double t3 = -0.5 / a1_entry;
    const double a2_entry = inputs[1];
    const double t6 = 2.0 * a2_entry;
    const double by_entry = inputs[2];
    const double t8 = -by_entry;
    const double bx_entry = inputs[3];
    const double t11 = a1_entry * bx_entry;
    const double t12 = -t11;
    const double t14 = -4.0 * a1_entry;
    const double a3_entry = inputs[4];
    const double t16 = a2_entry * bx_entry;
    const double t17 = -t16;
    const double t20 = -2.0 * t11;
    const double k2 = inputs[5];
    const double k1 = inputs[6];
    /* v0 + v1 * f */
    const double t24 = k1 + 1.0;
    /* (1 + k1 + k2) */
    const double t25 = k2 + t24;
    const double v1 = inputs[7];
    /* v0 + v1 * f */
    const double t27 = t25 * v1;
    const double a1 = inputs[8];
    /* X' * A * X */
    const double t29 = t27 * a1;
    const double t30 = t29 * a1;
    const double t31 = -3.0 * t30;
    const double t32 = 1.0 / a1;
    const double a2 = inputs[9];
    const double by = inputs[10];
    /* v0 + v1 * f */
    const double t35 = -by;
    const double bx = inputs[11];
    /* X' * A * X */
    const double t37 = a1 * bx;
    const double t38 = -t37;
    /* v0 + v1 * f */
    const double t39 = -bx;
    const double a3 = inputs[12];
    /* k2 */
    const double t41 = v1 * k2;
    /* X' * A * X */
    const double t42 = t41 * a1;
    const double t43 = 2.0 * t42;
    /* k1 */
    const double t44 = v1 * k1;
    /* X' * A * X */
    const double t46 = -6.0 * t29;
    /* v0 + v1 * f */
    const double t47 = 2.0 * t41;
    /* X' * A * X */
    const double t48 = t30 * a1;
    const double t49 = t42 * a1;
    const double t50 = -t49;
    const double t51 = t44 * a1;
    const double t52 = -t51;
    const double v0 = inputs[13];
    /* v0 + v1 * f */
    const double t54 = -v0;
    const double t55 = t54 - v1;
    const double t56 = 4.0 * a1;
    const double t57 = 4.0 * a2;
    const double t58 = 4.0 * a3;
    const double t60 = a2 * a1;
    const double t61 = 16.0 * t60;
    const double t63 = a1 * a1;
    const double t64 = 8.0 * t63;
    const double t65 = -4.0 * a1;
    const double t66 = a2 * a2;
    const double t67 = 8.0 * t66;
    const double t68 = a3 * a1;
    const double t69 = t68 + t66;
    const double t70 = 8.0 * t69;
    const double t71 = 8.0 * t60;
    const double t72 = -4.0 * a2;
    const double t73 = a3 * a2;
    const double t74 = 8.0 * t73;
    const double t75 = 16.0 * t73;
    const double t76 = -4.0 * a3;
    const double t77 = a3 * a3;
    const double t78 = 8.0 * t77;
    const float t31_f = (float)t31;
    const float t43_f = (float)t43;
    const float t44_f = (float)t44;
    const float t46_f = (float)t46;
    const float t47_f = (float)t47;
    const float t48_f = (float)t48;
    const float t50_f = (float)t50;
    const float t52_f = (float)t52;
    const float t55_f = (float)t55;
    for (size_t row = 0; row < window.size[1]; row++) {
        /* row */
        const double y = (double)(window.first[1] + row);
        /* y - by */
        const double t80 = y + t8;
        /* X' * A * X */
        const double t81 = a2_entry * t80;
        const double t82 = t81 + t12;
        const double t83 = t82 * t82;
        const double t84 = a3_entry * t80;
        const double t85 = t84 + t17;
        const double t86 = t80 * t85;
        const double t87 = bx_entry * t82;
        const double t88 = t86 - t87;
        const double t89 = t88 + -1.0;
        const double t90 = t14 * t89;
        const double t91 = 4.0 * t83;
        const double t92 = t91 + t90;
        const double t93 = sqrt(t92);
        const double t94 = t93 + t20;
        const double t95 = t6 * t80;
        const double t96 = t95 + t94;
        const double t97 = t3 * t96;
        const double t98 = t20 - t93;
        const double t99 = t95 + t98;
        const double t100 = t3 * t99;
        /* y - by */
        const double t101 = y + t35;
        /* X' * A * X */
        const double t102 = a2 * t101;
        const double t103 = t102 + t38;
        const double t104 = t32 * t103;
        /* x - bx */
        const double t105 = t39 - t104;
        /* X' * A * X */
        const double t106 = a3 * t101;
        const double t107 = a2 * t105;
        const double t108 = t107 + t106;
        const double t109 = a1 * t105;
        const double t110 = t109 + t102;
        const double t111 = t105 * t110;
        const double t112 = t108 * t101;
        const double t113 = t112 + t111;
        const double t114 = t32 * t113;
        /* v0 + v1 * f */
        const double t115 = t101 * t101;
        const float t114_f = (float)t114;
        size_t start = 0, end = window.size[0] - 1;
        /* from the first to the last pixel of the domain, if the row has any */
        const double first = (double)window.first[0], last = (double)(window.first[0] + end);
        double lo = t97, hi = t100;
        if (!(lo <= hi)) continue;
        lo = lo > first ? lo : first;
        hi = hi < last ? hi : last;
        if (!(lo <= hi)) continue;
        start = (size_t)(lo - first);
        start += (double)start < lo - first;
        end = (size_t)(hi - first);
        if (start > end) continue;
        const size_t count = end - start + 1;
        const uint8_t *const phi_plane_row = phi_plane.pixels + ((window.first[0] + start) * phi_plane.strides[0] + (window.first[1] + row) * phi_plane.strides[1]);
        const double x_first = (double)(window.first[0] + start);
        const double t116_n = rint(-(t104));
        const float t116_part = (float)(t104 + t116_n);
        float t116_at = (float)(x_first - t116_n);
        float sum0 = 0.0f;
        float sum1 = 0.0f;
        float sum2 = 0.0f;
        float sum3 = 0.0f;
        float sum4 = 0.0f;
        float sum5 = 0.0f;
        const size_t row_pixels = count;
        for (size_t i = 0; i < count; i++) {
            /* pixel */
            /* X' * A * X */
            const float t116 = t116_at + t116_part;
            const float t117 = t116 * t116;
            const float t118 = t117 + t114_f;
            const float t119 = t31_f * t118;
            const float t120 = t119 + t43_f;
            /* k[i] * s^i */
            const float t121 = t120 * t118;
            const float t122 = t121 + t44_f;
            /* v0 + v1 * f */
            const float t123 = t122 * t122;
            const float t124 = t46_f * t118;
            const float t125 = t124 + t47_f;
            /* X' * A * X */
            const float t126 = t48_f * t118;
            const float t127 = t126 + t50_f;
            const float t128 = t127 * t118;
            const float t129 = t128 + t52_f;
            const float phi = (float)phi_plane_row[i * phi_plane.strides[0]];
            /* v0 + v1 * f */
            const float t131 = phi + t55_f;
            const float t132 = t129 * t118;
            const float t133 = t132 + t131;
            const float t134 = t125 * t133;
            const float t135 = t123 - t134;
            const float t136 = t133 * t133;
            const float t137 = t122 * t133;
            /* X' * A * X */
            const float t138 = t135 * t116;
            const float t139 = t137 * t116;
            const float t140 = t138 * t116;
            sum0 += t136;
            sum1 += t137;
            sum2 += t139;
            sum3 += t135;
            sum4 += t138;
            sum5 += t140;
            t116_at += 1.0f;
        }
        pixels += row_pixels;
        /* row end */
        const double t141 = (double)sum0;
        const double t142 = (double)sum1;
        const double t143 = (double)sum2;
        /* X' * A * X */
        const double t144 = t105 * t142;
        const double t145 = t144 + t143;
        /* v0 + v1 * f */
        const double t146 = t101 * t142;
        const double t147 = (double)sum3;
        const double t148 = (double)sum4;
        const double t149 = t105 * t147;
        const double t150 = t149 + t148;
        const double t151 = t101 * t150;
        const double t152 = 2.0 * t148;
        const double t153 = t149 + t152;
        const double t154 = (double)sum5;
        const double t155 = t105 * t153;
        const double t156 = t155 + t154;
        const double t157 = t115 * t147;
        total0 += t141;
        total1 += t145;
        total2 += t146;
        total3 += t151;
        total4 += t156;
        total5 += t142;
        total6 += t157;
    }
    /* pass end */
    const double t158 = total0;
    const double t159 = total1;
    /* v0 + v1 * f */
    const double t160 = t56 * t159;
    const double t161 = total2;
    const double t162 = t57 * t161;
    const double t163 = t160 + t162;
    const double t164 = t57 * t159;
    const double t165 = t58 * t161;
    const double t166 = t164 + t165;
    const double t167 = total3;
    const double t168 = t61 * t167;
    const double t169 = total4;
    const double t170 = t64 * t169;
    const double t171 = t168 + t170;
    const double t172 = total5;
    const double t173 = t65 * t172;
    const double t174 = t171 + t173;
    const double t175 = total6;
    const double t176 = t67 * t175;
    const double t177 = t174 + t176;
    const double t178 = t70 * t167;
    const double t179 = t71 * t169;
    const double t180 = t178 + t179;
    const double t181 = t72 * t172;
    const double t182 = t180 + t181;
    const double t183 = t74 * t175;
    const double t184 = t182 + t183;
    const double t185 = t75 * t167;
    const double t186 = t67 * t169;
    const double t187 = t185 + t186;
    const double t188 = t76 * t172;
    const double t189 = t187 + t188;
    const double t190 = t78 * t175;
    const double t191 = t189 + t190;
    sums->outputs[0] = t158;
    sums->outputs[1] = t163;
    sums->outputs[2] = t166;
    sums->outputs[3] = t177;
    sums->outputs[4] = t184;
    sums->outputs[5] = t191;
    sums->pixels = pixels;
    sums->saturated = saturated;
    return 1;
}
