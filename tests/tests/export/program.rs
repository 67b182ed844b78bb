//! Compiles all cases into one program, which prints the numbers of each case on a line, as bits.

use std::fmt::Write;
use std::path::Path;
use std::process::Command;

use isophote_export::{Language, PixelType};
use isophote_symbolic::Sink;

use crate::cases::{Case, Outcome, SIZE};

/// Compiles and runs the cases in a language.
pub fn run(language: Language, cases: &[Case]) -> Vec<Outcome> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("export");
    std::fs::create_dir_all(&folder).unwrap();
    let planted = if cases.iter().any(|case| case.planted.is_some()) { "planted" } else { "cases" };
    let (text, extension) = match language {
        Language::C => (c(cases), "c"),
        Language::Rust => (rust(cases), "rs"),
    };
    let source = folder.join(format!("{planted}.{extension}"));
    let program = folder.join(format!("{planted}-{extension}"));
    std::fs::write(&source, text).unwrap();
    let mut compiler = match language {
        Language::C => {
            let mut cc = Command::new("cc");
            cc.args(["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O1", "-ffp-contract=off"]);
            cc.arg("-o").arg(&program).arg(&source).arg("-lm");
            cc
        }
        Language::Rust => {
            let mut rustc = Command::new("rustc");
            rustc.args(["--edition=2021", "-Dwarnings", "-Copt-level=0", "-o"]).arg(&program).arg(&source);
            rustc
        }
    };
    let made = compiler.output().unwrap();
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let ran = Command::new(&program).output().unwrap();
    assert!(ran.status.success(), "{:?}", ran.status);
    String::from_utf8(ran.stdout).unwrap().lines().map(outcome).collect()
}

fn outcome(line: &str) -> Outcome {
    let mut words = line.split_whitespace().map(|word| u64::from_str_radix(word, 16).unwrap());
    let counts = [words.next().unwrap(), words.next().unwrap()];
    Outcome { numbers: words.map(f64::from_bits).collect(), counts }
}

fn length(case: &Case) -> usize {
    let last: usize = SIZE.iter().zip(case.strides()).take(case.dimensions()).map(|(n, stride)| (n - 1) * stride).sum();
    last + 1
}

fn list(numbers: &[usize]) -> String {
    numbers.iter().map(usize::to_string).collect::<Vec<_>>().join(", ")
}

/// Parts of a case common to both languages.
struct Parts {
    dimensions: usize,
    inputs: String,
    pixels: usize,
    outputs: usize,
}

impl Parts {
    fn of(case: &Case) -> Parts {
        let bits: Vec<String> = case.inputs().iter().map(|x| format!("{:#x}", x.to_bits())).collect();
        let outputs = if let Sink::Sums { outputs, .. } = case.program.sink() { outputs.len() } else { 0 };
        let dimensions = case.dimensions();
        Parts { dimensions, inputs: bits.join(", "), pixels: case.window().1[..dimensions].iter().product(), outputs }
    }
}

fn c(cases: &[Case]) -> String {
    let mut text: String = cases.iter().map(|case| case.text(Language::C)).collect();
    text += "#include <stdio.h>\n#include <string.h>\n#include <inttypes.h>\n\
             static double of_bits(uint64_t bits) { double x; memcpy(&x, &bits, 8); return x; }\n\
             static void show(double x) { uint64_t bits; memcpy(&bits, &x, 8); printf(\" %\" PRIx64, bits); }\n";
    let mut main = String::new();
    for case in cases {
        let (name, Parts { dimensions: d, inputs, pixels, outputs }) = (&case.name, Parts::of(case));
        let kind = match case.pixel {
            PixelType::U8 => "uint8_t",
            PixelType::U16 => "uint16_t",
            PixelType::F32 => "float",
        };
        let fraction = if case.pixel == PixelType::F32 { " + 0.25f" } else { "" };
        writeln!(main, "    run_{name}();").unwrap();
        writeln!(text, "static void run_{name}(void) {{").unwrap();
        writeln!(text, "    const uint64_t bits[] = {{ {inputs} }};").unwrap();
        writeln!(text, "    double inputs[sizeof bits / sizeof bits[0]];").unwrap();
        writeln!(text, "    for (size_t i = 0; i < sizeof bits / sizeof bits[0]; i++) inputs[i] = of_bits(bits[i]);")
            .unwrap();
        let mut planes = String::new();
        for channel in 0..case.model.channels().len() {
            let length = length(case);
            writeln!(text, "    static {kind} memory{channel}[{length}];").unwrap();
            writeln!(
                text,
                "    for (size_t k = 0; k < {length}; k++) memory{channel}[k] = ({kind})((k * 7919 + {channel} * 131) % 251){fraction};"
            )
            .unwrap();
            let (size, strides) = (list(&SIZE[..d]), list(&case.strides()[..d]));
            let plane = format!("{name}_plane_{}", case.pixel.name());
            writeln!(text, "    const {plane} plane{channel} = {{ memory{channel}, {{ {size} }}, {{ {strides} }} }};")
                .unwrap();
            planes += &format!("plane{channel}, ");
        }
        let (first, count) = case.window();
        let (first, count) = (list(&first[..d]), list(&count[..d]));
        writeln!(text, "    {name}_window window = {{ {{ {first} }}, {{ {count} }} }};").unwrap();
        writeln!(text, "    {name}_sums sums;").unwrap();
        writeln!(text, "    static float out[{pixels}];\n    (void)out;").unwrap();
        let out = if case.renders() { ", out" } else { "" };
        writeln!(text, "    if (!{name}({planes}window, inputs, &sums{out})) {{ puts(\"refused\"); return; }}")
            .unwrap();
        writeln!(text, "    printf(\"%\" PRIx64 \" %\" PRIx64, sums.pixels, sums.saturated);").unwrap();
        match case.renders() {
            true => writeln!(text, "    for (size_t i = 0; i < {pixels}; i++) show(out[i]);").unwrap(),
            false => writeln!(text, "    for (size_t i = 0; i < {outputs}; i++) show(sums.outputs[i]);").unwrap(),
        }
        writeln!(text, "    puts(\"\");").unwrap();
        // A window one pixel too large, and an empty one.
        writeln!(text, "    window.size[1] = {};", SIZE[1]).unwrap();
        writeln!(text, "    if ({name}({planes}window, inputs, &sums{out})) puts(\"left the plane\");").unwrap();
        writeln!(text, "    window.size[1] = 0;").unwrap();
        writeln!(text, "    if ({name}({planes}window, inputs, &sums{out})) puts(\"took nothing\");").unwrap();
        writeln!(text, "}}").unwrap();
    }
    text + "int main(void) {\n" + &main + "    return 0;\n}\n"
}

fn rust(cases: &[Case]) -> String {
    let (mut text, mut main) = (String::new(), String::new());
    for case in cases {
        let (name, Parts { dimensions: d, inputs, pixels, .. }) = (&case.name, Parts::of(case));
        writeln!(text, "mod {name} {{\n{}", case.text(Language::Rust)).unwrap();
        writeln!(text, "pub fn run() {{").unwrap();
        writeln!(text, "    let inputs = [{inputs}].map(f64::from_bits);").unwrap();
        let kind = case.pixel.name();
        let fraction = if case.pixel == PixelType::F32 { " + 0.25" } else { "" };
        let mut planes = String::new();
        for channel in 0..case.model.channels().len() {
            let length = length(case);
            writeln!(
                text,
                "    let memory{channel}: Vec<{kind}> = (0..{length}_usize).map(|k| ((k * 7919 + {channel} * 131) % 251) as {kind}{fraction}).collect();"
            )
            .unwrap();
            let (size, strides) = (list(&SIZE[..d]), list(&case.strides()[..d]));
            let plane = format!("Plane {{ pixels: &memory{channel}, size: [{size}], strides: [{strides}] }}");
            writeln!(text, "    let plane{channel} = {plane};").unwrap();
            planes += &format!("plane{channel}, ");
        }
        let (first, count) = case.window();
        let (first, count) = (list(&first[..d]), list(&count[..d]));
        writeln!(text, "    let mut window = Window {{ first: [{first}], size: [{count}] }};").unwrap();
        let (declare, out, numbers) = match case.renders() {
            true => {
                (format!("let mut out = vec![0.0_f32; {pixels}];"), ", &mut out", "out.iter().map(|x| f64::from(*x))")
            }
            false => (String::new(), "", "sums.outputs.into_iter()"),
        };
        writeln!(text, "    {declare}").unwrap();
        writeln!(text, "    let sums = {name}({planes}window, &inputs{out}).unwrap();").unwrap();
        writeln!(text, "    print!(\"{{:x}} {{:x}}\", sums.pixels, sums.saturated);").unwrap();
        writeln!(text, "    for x in {numbers} {{ print!(\" {{:x}}\", x.to_bits()); }}").unwrap();
        writeln!(text, "    println!();").unwrap();
        for wrong in [SIZE[1], 0] {
            writeln!(text, "    window.size[1] = {wrong};").unwrap();
            writeln!(text, "    assert!({name}({planes}window, &inputs{out}).is_none());").unwrap();
        }
        writeln!(text, "}}\n}}").unwrap();
        writeln!(main, "    {name}::run();").unwrap();
    }
    format!("{text}fn main() {{\n{main}}}\n")
}
