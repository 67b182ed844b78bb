// thesis-spot: Elliptical light spot with a cubic radial profile (thesis, section 4.1.3)
// Written by isophote 0.1.0 from the model sha256:cba83886b2e2a94c7c57162a24c86b7de0618d164b3476627615edf9e71ff4e7
//
// Sums over the pixels of a window:
//   outputs[0]  F
//   outputs[1]  dF/dbx
//   outputs[2]  dF/dby
//   outputs[3]  d2F/dbxdbx
//   outputs[4]  d2F/dbxdby
//   outputs[5]  d2F/dbydby
//
// What goes in:
//   inputs[0]  a1 when the pass was entered: it fixes which pixels take part
//   inputs[1]  a2 when the pass was entered: it fixes which pixels take part
//   inputs[2]  by when the pass was entered: it fixes which pixels take part
//   inputs[3]  bx when the pass was entered: it fixes which pixels take part
//   inputs[4]  a3 when the pass was entered: it fixes which pixels take part
//   inputs[5]  k2
//   inputs[6]  k1
//   inputs[7]  v1
//   inputs[8]  a1
//   inputs[9]  a2
//   inputs[10]  by, px
//   inputs[11]  bx, px
//   inputs[12]  a3
//   inputs[13]  v0
//   plane of `phi`: u8, pixel values as stored
//
// Coordinates are pixels of the whole plane, centres at whole numbers, the inner loop first:
//   `x`, `y`; a plane has size and strides along 2 of them, counted in pixels
//
// Arithmetic: f32 a pixel; f64 for rows and passes, 1 pixel(s) at a time. It is the interpreter's, bit for bit,
// as long as the compiler neither contracts a * b + c (-ffp-contract=off) nor reorders sums; -ffast-math would besides lose
// the test that leaves out rows without pixels, whose bounds are NaN: add -fno-finite-math-only to it
//
// `None` for a window that is empty or leaves a plane, and for a plane whose slice is too short.

/// A plane: its pixels, how many there are along each coordinate, and how far it is to the next one, in pixels.
#[derive(Clone, Copy)]
pub struct Plane<'a, T> {
    pub pixels: &'a [T],
    pub size: [usize; 2],
    pub strides: [usize; 2],
}

impl<T> Plane<'_, T> {
    /// True when the window has pixels and all of them are in the slice.
    fn holds(&self, window: &Window) -> bool {
        let mut end = 1_usize;
        for i in 0..2 {
            let past = match window.first[i].checked_add(window.size[i]) {
                Some(past) if window.size[i] > 0 && past <= self.size[i] => past,
                _ => return false,
            };
            let stride = self.strides[i];
            end = match (past - 1).checked_mul(stride).and_then(|last| last.checked_add(end)) {
                Some(end) => end,
                None => return false,
            };
        }
        end <= self.pixels.len()
    }
}

/// The pixels to process: the first along each coordinate, and how many.
#[derive(Clone, Copy)]
pub struct Window {
    pub first: [usize; 2],
    pub size: [usize; 2],
}

/// What is handed back.
#[derive(Clone, Copy, Debug)]
pub struct Sums {
    pub outputs: [f64; 6],
    /// Used.
    pub pixels: u64,
    /// Left out as saturated.
    pub saturated: u64,
}

/// The nearest whole number, ties to even, for magnitudes below 2^51.
fn nearest(x: f64) -> f64 {
    const MAGIC: f64 = 6755399441055744.0;
    (x + MAGIC) - MAGIC
}

/// Runs the loops over a window; what `inputs` and `outputs` are stands at the top.
#[allow(non_snake_case, clippy::all)]
pub fn isophote_thesis_spot(
    phi_plane: Plane<'_, u8>,
    window: Window,
    inputs: &[f64; 14],
) -> Option<Sums> {
    if !phi_plane.holds(&window) {
        return None;
    }
    let mut pixels = 0_u64;
    let saturated = 0_u64;
    let mut total0 = 0.0_f64;
    let mut total1 = 0.0_f64;
    let mut total2 = 0.0_f64;
    let mut total3 = 0.0_f64;
    let mut total4 = 0.0_f64;
    let mut total5 = 0.0_f64;
    let mut total6 = 0.0_f64;
    // pass
    let a1_entry: f64 = inputs[0];
    // X' * A * X
    let t3: f64 = -0.5 / a1_entry;
    let a2_entry: f64 = inputs[1];
    let t6: f64 = 2.0 * a2_entry;
    let by_entry: f64 = inputs[2];
    let t8: f64 = -by_entry;
    let bx_entry: f64 = inputs[3];
    let t11: f64 = a1_entry * bx_entry;
    let t12: f64 = -t11;
    let t14: f64 = -4.0 * a1_entry;
    let a3_entry: f64 = inputs[4];
    let t16: f64 = a2_entry * bx_entry;
    let t17: f64 = -t16;
    let t20: f64 = -2.0 * t11;
    let k2: f64 = inputs[5];
    let k1: f64 = inputs[6];
    // v0 + v1 * f
    let t24: f64 = k1 + 1.0;
    // (1 + k1 + k2)
    let t25: f64 = k2 + t24;
    let v1: f64 = inputs[7];
    // v0 + v1 * f
    let t27: f64 = t25 * v1;
    let a1: f64 = inputs[8];
    // X' * A * X
    let t29: f64 = t27 * a1;
    let t30: f64 = t29 * a1;
    let t31: f64 = -3.0 * t30;
    let t32: f64 = 1.0 / a1;
    let a2: f64 = inputs[9];
    let by: f64 = inputs[10];
    // v0 + v1 * f
    let t35: f64 = -by;
    let bx: f64 = inputs[11];
    // X' * A * X
    let t37: f64 = a1 * bx;
    let t38: f64 = -t37;
    // v0 + v1 * f
    let t39: f64 = -bx;
    let a3: f64 = inputs[12];
    // k2
    let t41: f64 = v1 * k2;
    // X' * A * X
    let t42: f64 = t41 * a1;
    let t43: f64 = 2.0 * t42;
    // k1
    let t44: f64 = v1 * k1;
    // X' * A * X
    let t46: f64 = -6.0 * t29;
    // v0 + v1 * f
    let t47: f64 = 2.0 * t41;
    // X' * A * X
    let t48: f64 = t30 * a1;
    let t49: f64 = t42 * a1;
    let t50: f64 = -t49;
    let t51: f64 = t44 * a1;
    let t52: f64 = -t51;
    let v0: f64 = inputs[13];
    // v0 + v1 * f
    let t54: f64 = -v0;
    let t55: f64 = t54 - v1;
    let t56: f64 = 4.0 * a1;
    let t57: f64 = 4.0 * a2;
    let t58: f64 = 4.0 * a3;
    let t60: f64 = a2 * a1;
    let t61: f64 = 16.0 * t60;
    let t63: f64 = a1 * a1;
    let t64: f64 = 8.0 * t63;
    let t65: f64 = -4.0 * a1;
    let t66: f64 = a2 * a2;
    let t67: f64 = 8.0 * t66;
    let t68: f64 = a3 * a1;
    let t69: f64 = t68 + t66;
    let t70: f64 = 8.0 * t69;
    let t71: f64 = 8.0 * t60;
    let t72: f64 = -4.0 * a2;
    let t73: f64 = a3 * a2;
    let t74: f64 = 8.0 * t73;
    let t75: f64 = 16.0 * t73;
    let t76: f64 = -4.0 * a3;
    let t77: f64 = a3 * a3;
    let t78: f64 = 8.0 * t77;
    let t31_f: f32 = t31 as f32;
    let t43_f: f32 = t43 as f32;
    let t44_f: f32 = t44 as f32;
    let t46_f: f32 = t46 as f32;
    let t47_f: f32 = t47 as f32;
    let t48_f: f32 = t48 as f32;
    let t50_f: f32 = t50 as f32;
    let t52_f: f32 = t52 as f32;
    let t55_f: f32 = t55 as f32;
    for row in 0..window.size[1] {
        // row
        let y: f64 = (window.first[1] + row) as f64;
        // y - by
        let t80: f64 = y + t8;
        // X' * A * X
        let t81: f64 = a2_entry * t80;
        let t82: f64 = t81 + t12;
        let t83: f64 = t82 * t82;
        let t84: f64 = a3_entry * t80;
        let t85: f64 = t84 + t17;
        let t86: f64 = t80 * t85;
        let t87: f64 = bx_entry * t82;
        let t88: f64 = t86 - t87;
        let t89: f64 = t88 + -1.0;
        let t90: f64 = t14 * t89;
        let t91: f64 = 4.0 * t83;
        let t92: f64 = t91 + t90;
        let t93: f64 = t92.sqrt();
        let t94: f64 = t93 + t20;
        let t95: f64 = t6 * t80;
        let t96: f64 = t95 + t94;
        let t97: f64 = t3 * t96;
        let t98: f64 = t20 - t93;
        let t99: f64 = t95 + t98;
        let t100: f64 = t3 * t99;
        // y - by
        let t101: f64 = y + t35;
        // X' * A * X
        let t102: f64 = a2 * t101;
        let t103: f64 = t102 + t38;
        let t104: f64 = t32 * t103;
        // x - bx
        let t105: f64 = t39 - t104;
        // X' * A * X
        let t106: f64 = a3 * t101;
        let t107: f64 = a2 * t105;
        let t108: f64 = t107 + t106;
        let t109: f64 = a1 * t105;
        let t110: f64 = t109 + t102;
        let t111: f64 = t105 * t110;
        let t112: f64 = t108 * t101;
        let t113: f64 = t112 + t111;
        let t114: f64 = t32 * t113;
        // v0 + v1 * f
        let t115: f64 = t101 * t101;
        let t114_f: f32 = t114 as f32;
        // from the first to the last pixel of the domain, if the row has any
        let first = window.first[0] as f64;
        let last = (window.first[0] + window.size[0] - 1) as f64;
        let (lo, hi) = (t97, t100);
        if !(lo <= hi) {
            continue;
        }
        let lo = if lo > first { lo } else { first };
        let hi = if hi < last { hi } else { last };
        if !(lo <= hi) {
            continue;
        }
        let mut start = (lo - first) as usize;
        if (start as f64) < lo - first {
            start += 1;
        }
        let end = (hi - first) as usize;
        if !(start <= end) {
            continue;
        }
        let count = end - start + 1;
        let at = (window.first[0] + start) * phi_plane.strides[0] + (window.first[1] + row) * phi_plane.strides[1];
        let phi_plane_row = &phi_plane.pixels[at..at + (count - 1) * phi_plane.strides[0] + 1];
        let x_first = (window.first[0] + start) as f64;
        let t116_n: f64 = nearest(-(t104));
        let t116_part: f32 = (t104 + t116_n) as f32;
        let mut t116_at: f32 = (x_first - t116_n) as f32;
        let mut sum0: f32 = 0.0;
        let mut sum1: f32 = 0.0;
        let mut sum2: f32 = 0.0;
        let mut sum3: f32 = 0.0;
        let mut sum4: f32 = 0.0;
        let mut sum5: f32 = 0.0;
        let row_pixels = count;
        for i in 0..count {
            // pixel
            // X' * A * X
            let t116: f32 = t116_at + t116_part;
            let t117: f32 = t116 * t116;
            let t118: f32 = t117 + t114_f;
            let t119: f32 = t31_f * t118;
            let t120: f32 = t119 + t43_f;
            // k[i] * s^i
            let t121: f32 = t120 * t118;
            let t122: f32 = t121 + t44_f;
            // v0 + v1 * f
            let t123: f32 = t122 * t122;
            let t124: f32 = t46_f * t118;
            let t125: f32 = t124 + t47_f;
            // X' * A * X
            let t126: f32 = t48_f * t118;
            let t127: f32 = t126 + t50_f;
            let t128: f32 = t127 * t118;
            let t129: f32 = t128 + t52_f;
            let phi: f32 = f32::from(phi_plane_row[i * phi_plane.strides[0]]);
            // v0 + v1 * f
            let t131: f32 = phi + t55_f;
            let t132: f32 = t129 * t118;
            let t133: f32 = t132 + t131;
            let t134: f32 = t125 * t133;
            let t135: f32 = t123 - t134;
            let t136: f32 = t133 * t133;
            let t137: f32 = t122 * t133;
            // X' * A * X
            let t138: f32 = t135 * t116;
            let t139: f32 = t137 * t116;
            let t140: f32 = t138 * t116;
            sum0 += t136;
            sum1 += t137;
            sum2 += t139;
            sum3 += t135;
            sum4 += t138;
            sum5 += t140;
            t116_at += 1.0;
        }
        pixels += row_pixels as u64;
        // row end
        let t141: f64 = f64::from(sum0);
        let t142: f64 = f64::from(sum1);
        let t143: f64 = f64::from(sum2);
        // X' * A * X
        let t144: f64 = t105 * t142;
        let t145: f64 = t144 + t143;
        // v0 + v1 * f
        let t146: f64 = t101 * t142;
        let t147: f64 = f64::from(sum3);
        let t148: f64 = f64::from(sum4);
        let t149: f64 = t105 * t147;
        let t150: f64 = t149 + t148;
        let t151: f64 = t101 * t150;
        let t152: f64 = 2.0 * t148;
        let t153: f64 = t149 + t152;
        let t154: f64 = f64::from(sum5);
        let t155: f64 = t105 * t153;
        let t156: f64 = t155 + t154;
        let t157: f64 = t115 * t147;
        total0 += t141;
        total1 += t145;
        total2 += t146;
        total3 += t151;
        total4 += t156;
        total5 += t142;
        total6 += t157;
    }
    // pass end
    let t158: f64 = total0;
    let t159: f64 = total1;
    // v0 + v1 * f
    let t160: f64 = t56 * t159;
    let t161: f64 = total2;
    let t162: f64 = t57 * t161;
    let t163: f64 = t160 + t162;
    let t164: f64 = t57 * t159;
    let t165: f64 = t58 * t161;
    let t166: f64 = t164 + t165;
    let t167: f64 = total3;
    let t168: f64 = t61 * t167;
    let t169: f64 = total4;
    let t170: f64 = t64 * t169;
    let t171: f64 = t168 + t170;
    let t172: f64 = total5;
    let t173: f64 = t65 * t172;
    let t174: f64 = t171 + t173;
    let t175: f64 = total6;
    let t176: f64 = t67 * t175;
    let t177: f64 = t174 + t176;
    let t178: f64 = t70 * t167;
    let t179: f64 = t71 * t169;
    let t180: f64 = t178 + t179;
    let t181: f64 = t72 * t172;
    let t182: f64 = t180 + t181;
    let t183: f64 = t74 * t175;
    let t184: f64 = t182 + t183;
    let t185: f64 = t75 * t167;
    let t186: f64 = t67 * t169;
    let t187: f64 = t185 + t186;
    let t188: f64 = t76 * t172;
    let t189: f64 = t187 + t188;
    let t190: f64 = t78 * t175;
    let t191: f64 = t189 + t190;
    let outputs = [t158, t163, t166, t177, t184, t191];
    Some(Sums { outputs, pixels, saturated })
}
