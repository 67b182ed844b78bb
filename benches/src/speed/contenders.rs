//! Contenders of the JIT: the same loops, and those made without isophote, compiled by `cc` and `rustc`.
//!
//! Each way of compiling has one source file, with a function per program, and a command.

use std::fmt::Write;
use std::path::PathBuf;

use isophote_export::{ExportOptions, Language, PixelType};
use isophote_symbolic::{Model, Precision, Program, Sink};

/// The loop body of a contender.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Body {
    /// The kernel's own program.
    Same,
    /// The derivatives as differentiation yields them.
    Unfactored,
    /// SymPy's `cse` of F and the derivatives: `sympy_cse.c`.
    Sympy,
}

/// A way to compile.
#[derive(Clone, Debug)]
pub struct CodeVariant {
    /// Name in the tables.
    pub name: &'static str,
    /// Language of its source.
    pub language: Language,
    /// Pixels at a time.
    pub lanes: usize,
    /// Its loop body.
    pub body: Body,
    /// Vector width, bits; 0 for scalar code.
    pub bits: usize,
    /// Command line of the compiler.
    pub command: Vec<&'static str>,
}

const RUST: [&str; 9] = [
    "rustc",
    "--edition=2021",
    "--crate-type=cdylib",
    "-Copt-level=3",
    "-Ccodegen-units=1",
    "-Cpanic=abort",
    "-Clto=no",
    "-Adead_code",
    "-Anon_snake_case",
];
/// Keeps NaN semantics: rows outside of the domain have NaN bounds, and would not be skipped with
/// `-ffinite-math-only`.
pub(crate) const C: [&str; 8] =
    ["cc", "-fopt-info-vec-optimized", "-std=c99", "-O3", "-ffast-math", "-fno-finite-math-only", "-shared", "-fPIC"];

fn with(command: &[&'static str], more: &[&'static str]) -> Vec<&'static str> {
    [command, more].concat()
}

/// All ways that run on this machine.
pub fn variants() -> Vec<CodeVariant> {
    let variant =
        |name, language, lanes, body, bits, command| CodeVariant { name, language, lanes, body, bits, command };
    let (v3, native) = ("-Ctarget-cpu=x86-64-v3", "-march=native");
    let rust =
        |name, lanes, bits, target| variant(name, Language::Rust, lanes, Body::Same, bits, with(&RUST, &[target]));
    let c = |name, body, bits, target| {
        let width = match bits {
            128 => "-mprefer-vector-width=128",
            256 => "-mprefer-vector-width=256",
            _ => "-mprefer-vector-width=512",
        };
        variant(name, Language::C, 1, body, bits, with(&C, &[target, width]))
    };
    let mut variants = vec![
        rust("same program, Rust, scalar", 1, 0, v3),
        c("same program, C, 128 bits", Body::Same, 128, "-march=x86-64-v3"),
        c("same program, C, 256 bits", Body::Same, 256, "-march=x86-64-v3"),
        rust("same program, Rust, 128-bit vectors", 4, 128, v3),
        rust("same program, Rust, 256-bit vectors", 8, 256, v3),
        c("unfactored, C, 128 bits", Body::Unfactored, 128, native),
        c("unfactored, C, 256 bits", Body::Unfactored, 256, native),
        c("SymPy's cse, C, 128 bits", Body::Sympy, 128, native),
        c("SymPy's cse, C, 256 bits", Body::Sympy, 256, native),
    ];
    if has_widest() {
        variants.push(c("same program, C, 512 bits", Body::Same, 512, native));
        variants.push(rust("same program, Rust, 512-bit vectors", 16, 512, "-Ctarget-cpu=native"));
        variants.push(c("unfactored, C, 512 bits", Body::Unfactored, 512, native));
        variants.push(c("SymPy's cse, C, 512 bits", Body::Sympy, 512, native));
    }
    variants
}

/// Whether 512-bit vectors run; if not, they are not timed.
pub fn has_widest() -> bool {
    std::arch::is_x86_feature_detected!("avx512f")
}

/// A function of a file.
pub struct Function<'a> {
    /// Its name.
    pub name: String,
    /// Its program.
    pub program: &'a Program,
    /// Its pixel type.
    pub pixel: PixelType,
}

/// The source of all functions for one way of compiling.
pub fn source(model: &Model, variant: &CodeVariant, functions: &[Function<'_>]) -> String {
    let mut text = String::new();
    for function in functions {
        let options = ExportOptions {
            precision: Precision::F32,
            pixels: vec![function.pixel],
            packed: true,
            lanes: variant.lanes,
            name: Some(function.name.clone()),
            ..ExportOptions::new(variant.language, 1)
        };
        let exported = isophote_export::export(model, function.program, &options)
            .unwrap_or_else(|error| panic!("{}: {error}", variant.name));
        let Sink::Sums { outputs, .. } = function.program.sink() else { panic!("{} sums nothing", function.name) };
        let (name, inputs, outputs) = (&function.name, function.program.inputs().len(), outputs.len());
        match variant.language {
            Language::C => {
                let (plane, kind) = (format!("{name}_plane_{}", function.pixel.name()), c_type(function.pixel));
                write!(
                    text,
                    "{exported}\n\
                     int32_t call_{name}(const void *pixels, const size_t *plane, const size_t *window, const double *inputs, double *outputs, uint64_t *counts) {{\n\
                     \x20   const {plane} p = {{ (const {kind} *)pixels, {{ plane[0], plane[1] }}, {{ plane[2], plane[3] }} }};\n\
                     \x20   const {name}_window w = {{ {{ window[0], window[1] }}, {{ window[2], window[3] }} }};\n\
                     \x20   {name}_sums sums;\n\
                     \x20   if (!{name}(p, w, inputs, &sums)) return 0;\n\
                     \x20   for (int i = 0; i < {outputs}; i++) outputs[i] = sums.outputs[i];\n\
                     \x20   counts[0] = sums.pixels; counts[1] = sums.saturated;\n\
                     \x20   return 1;\n}}\n"
                )
            }
            Language::Rust => write!(
                text,
                "mod {name} {{\n{exported}\n\
                 #[no_mangle]\n\
                 pub unsafe extern \"C\" fn call_{name}(pixels: *const {kind}, plane: *const [usize; 4], window: *const [usize; 4], inputs: *const [f64; {inputs}], outputs: *mut [f64; {outputs}], counts: *mut [u64; 2]) -> i32 {{\n\
                 \x20   let [width, height, across, down] = *plane;\n\
                 \x20   let pixels = core::slice::from_raw_parts(pixels, width * height);\n\
                 \x20   let plane = Plane {{ pixels, size: [width, height], strides: [across, down] }};\n\
                 \x20   let [x, y, w, h] = *window;\n\
                 \x20   match {name}(plane, Window {{ first: [x, y], size: [w, h] }}, &*inputs) {{\n\
                 \x20       Some(sums) => {{ *outputs = sums.outputs; *counts = [sums.pixels, sums.saturated]; 1 }}\n\
                 \x20       None => 0,\n\
                 \x20   }}\n}}\n}}\n",
                kind = function.pixel.name()
            ),
        }
        .unwrap_or_else(|error| panic!("{error}"));
    }
    text
}

fn c_type(pixel: PixelType) -> &'static str {
    match pixel {
        PixelType::U8 => "uint8_t",
        PixelType::U16 => "uint16_t",
        PixelType::F32 => "float",
    }
}

/// Folder of compiled files.
pub fn folder() -> PathBuf {
    [env!("CARGO_MANIFEST_DIR"), "..", "target", "contenders"].iter().collect()
}
