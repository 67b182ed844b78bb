//! Spells operations on several lanes of f32 with x86-64 intrinsics: one table.
//!
//! Truth values are vectors of all ones or all zeros; with 16 lanes they are bits of a mask.

use isophote_symbolic::{Comparison, Op, Opcode, Value};

use crate::options::PixelType;
use crate::spelling::Held;

/// Vectors of 4, 8 or 16 lanes.
#[derive(Clone, Copy)]
pub(super) struct Vectors {
    pub lanes: usize,
}

impl Vectors {
    /// Calls the intrinsic of that name.
    pub fn call(self, name: &str, arguments: &[&str]) -> String {
        let head = match self.lanes {
            4 => "_mm_",
            8 => "_mm256_",
            _ => "_mm512_",
        };
        format!("{head}{name}({})", arguments.join(", "))
    }

    /// Required processor features.
    pub fn features(self) -> &'static [&'static str] {
        if self.lanes == 16 { &["avx2", "fma", "avx512f", "avx512dq"] } else { &["avx2", "fma"] }
    }

    fn has_masks(self) -> bool {
        self.lanes == 16
    }

    /// The same number in every lane.
    pub fn splat(self, number: &str) -> String {
        self.call("set1_ps", &[number])
    }

    /// The same truth value in every lane.
    pub fn splat_truth(self, truth: &str) -> String {
        match self.lanes {
            4 => format!("_mm_castsi128_ps(_mm_set1_epi32(-i32::from({truth})))"),
            8 => format!("_mm256_castsi256_ps(_mm256_set1_epi32(-i32::from({truth})))"),
            _ => format!("if {truth} {{ u16::MAX }} else {{ 0 }}"),
        }
    }

    /// Conjunction.
    pub fn both(self, a: &str, b: &str) -> String {
        if self.has_masks() { format!("{a} & {b}") } else { self.call("and_ps", &[a, b]) }
    }

    /// Negation.
    pub fn not(self, truth: &str) -> String {
        if self.has_masks() { format!("!{truth}") } else { self.call("xor_ps", &[truth, &self.splat_truth("true")]) }
    }

    /// b and not a.
    pub fn without(self, a: &str, b: &str) -> String {
        if self.has_masks() { format!("!{a} & {b}") } else { self.call("andnot_ps", &[a, b]) }
    }

    /// Number of lanes that hold.
    pub fn count(self, truth: &str) -> String {
        match self.has_masks() {
            true => format!("{truth}.count_ones()"),
            false => format!("{}.count_ones()", self.call("movemask_ps", &[truth])),
        }
    }

    /// A sum with a value added in the lanes that hold.
    pub fn add_where(self, used: Option<&str>, sum: &str, value: &str) -> String {
        match (used, self.has_masks()) {
            (None, _) => self.call("add_ps", &[sum, value]),
            (Some(used), true) => format!("_mm512_mask_add_ps({sum}, {used}, {sum}, {value})"),
            (Some(used), false) => self.call("add_ps", &[sum, &self.call("and_ps", &[used, value])]),
        }
    }

    /// A sum with a product added, rounded once, in the lanes that hold.
    pub fn add_product_where(self, used: Option<&str>, sum: &str, [a, b]: [&str; 2]) -> String {
        let new = self.call("fmadd_ps", &[a, b, sum]);
        match (used, self.has_masks()) {
            (None, _) => new,
            (Some(used), true) => format!("_mm512_mask3_fmadd_ps({a}, {b}, {sum}, {used})"),
            (Some(used), false) => self.call("blendv_ps", &[sum, &new, used]),
        }
    }

    /// The lanes from `first` up to, but without, `end`.
    pub fn between(self, ramp: &str, first: &str, end: &str) -> String {
        let begun = self.compare(Comparison::Le, &self.splat(first), ramp);
        self.both(&begun, &self.compare(Comparison::Lt, ramp, &self.splat(end)))
    }

    /// Loads pixels from a pointer of their type.
    pub fn load(self, pixel: PixelType, pointer: &str) -> String {
        let wide = match (pixel, self.lanes) {
            (PixelType::F32, _) => return self.call("loadu_ps", &[pointer]),
            (PixelType::U8, 4) => format!("_mm_cvtsi32_si128({pointer}.cast::<i32>().read_unaligned())"),
            (PixelType::U8, 8) | (PixelType::U16, 4) => format!("_mm_loadl_epi64({pointer}.cast())"),
            (PixelType::U8, _) | (PixelType::U16, 8) => format!("_mm_loadu_si128({pointer}.cast())"),
            (PixelType::U16, _) => format!("_mm256_loadu_si256({pointer}.cast())"),
        };
        let widen = if pixel == PixelType::U8 { "cvtepu8_epi32" } else { "cvtepu16_epi32" };
        self.call("cvtepi32_ps", &[&self.call(widen, &[&wide])])
    }

    fn compare(self, comparison: Comparison, a: &str, b: &str) -> String {
        let kind = match comparison {
            Comparison::Lt => "_CMP_LT_OQ",
            Comparison::Le => "_CMP_LE_OQ",
            Comparison::Eq => "_CMP_EQ_OQ",
            Comparison::Ne => "_CMP_NEQ_UQ",
        };
        self.call(&format!("cmp_ps{}::<{kind}>", if self.has_masks() { "_mask" } else { "" }), &[a, b])
    }

    /// An operation; `a` spells its operands, and `held` is the type that a select chooses. `None` without a vector
    /// form.
    pub fn operation(self, op: Op, held: Held, a: &dyn Fn(Value) -> String) -> Option<String> {
        let (code, operands) = op.parts();
        let spelled: Vec<String> = operands.iter().map(|v| a(*v)).collect();
        let texts: Vec<&str> = spelled.iter().map(String::as_str).collect();
        let sign = self.splat("-0.0");
        Some(match (code, &texts[..]) {
            (Opcode::Neg, [x]) => self.call("xor_ps", &[x, &sign]),
            (Opcode::Abs, [x]) => self.call("andnot_ps", &[&sign, x]),
            (Opcode::Sqrt, x) => self.call("sqrt_ps", x),
            (Opcode::Add, both) => self.call("add_ps", both),
            (Opcode::Sub, both) => self.call("sub_ps", both),
            (Opcode::Mul, both) => self.call("mul_ps", both),
            (Opcode::Div, both) => self.call("div_ps", both),
            (Opcode::Fma, all) => self.call("fmadd_ps", all),
            (Opcode::Compare(comparison), [x, y]) => self.compare(comparison, x, y),
            (Opcode::And, [x, y]) => self.both(x, y),
            (Opcode::Or, [x, y]) if self.has_masks() => format!("{x} | {y}"),
            (Opcode::Or, both) => self.call("or_ps", both),
            (Opcode::Not, [x]) => self.not(x),
            (Opcode::Select, [c, x, y]) => match (self.has_masks(), held) {
                (true, Held::Truth) => format!("({c} & {x}) | (!{c} & {y})"),
                (true, Held::Number) => format!("_mm512_mask_blend_ps({c}, {y}, {x})"),
                (false, _) => self.call("blendv_ps", &[y, x, c]),
            },
            _ => return None,
        })
    }
}
