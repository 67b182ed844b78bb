//! The kernels of the thesis' spot against the same loops compiled ahead of time, and against loops made without
//! isophote.

use isophote_export::PixelType;
use isophote_jit::{Kernel, KernelOptions, PixelFormat, PlaneView, Processor, VectorWidth, Window, has_fma};
use isophote_symbolic::{Bindings, Lowering, Method, Model, Part, Precision, Program, Sink};

use super::appendix;
use super::contenders::{self, Body, CodeVariant, Function};
use super::foreign::{Compiled, Picture};
use super::frame::{HEIGHT, WIDTH, beside_truth, bytes, picture, truth};
use super::race::{Contender, ContenderTime, race, refuse_wrong, repeated, scales};
use super::windows::{Domain, small};
use crate::text;
use isophote_tracker::{over_pixels_of, plain_program};

/// Subsets of the parameters: a name for functions, one for tables, and the parameters.
pub const SUBSETS: [(&str, &str, &str); 4] = [
    ("spot_b", "b", "bx,by"),
    ("spot_a", "a", "a1,a2,a3"),
    ("spot_ab", "a, b", "bx,by,a1,a2,a3"),
    ("spot_abv", "a, b, v", "bx,by,a1,a2,a3,v0,v1"),
];

/// Results of one subset.
pub struct Race {
    /// Name of the subset in the tables.
    pub name: &'static str,
    /// The 128-bit kernel first, then those of the other widths of this machine.
    pub times: Vec<ContenderTime>,
}

/// The smaller windows, px, their domain, and the passes of one turn.
const SMALLER: [([usize; 2], Domain, usize); 3] =
    [([96, 96], Domain::Covering, 4), ([24, 24], Domain::Covering, 64), ([24, 24], Domain::Inscribed, 64)];
/// Inputs of SymPy's loops, in this order.
const SYMPY_INPUTS: [&str; 9] = ["a1", "a2", "a3", "bx", "by", "k1", "k2", "v0", "v1"];

/// A picture for all contenders, used completely.
struct Scene {
    bytes: Vec<u8>,
    size: [usize; 2],
    parameters: Vec<f64>,
    /// Passes per turn.
    passes: usize,
}

struct Case {
    name: &'static str,
    title: &'static str,
    /// One for each vector width of this machine.
    jit: Vec<Kernel>,
    optimised: Program,
    for_c: Program,
    plain: Program,
}

/// Gradient and Hessian of a subset by Newton, compiled for packed pixels.
pub fn kernel(model: &Model, subset: &str, format: PixelFormat, drop_saturated: bool, width: VectorWidth) -> Kernel {
    let ids: Vec<_> = subset.split(',').map(|n| model.parameter(n).unwrap()).collect();
    let lowering = Lowering { fma: has_fma(), drop_saturated };
    let program = model.objective(&ids, Method::Newton).unwrap().program(lowering).unwrap();
    let options = KernelOptions { width, precision: Precision::F32, formats: vec![format], packed: true };
    Kernel::compile(&program, &options).unwrap()
}

/// The vector widths of this machine, narrowest first.
pub fn widths() -> impl Iterator<Item = VectorWidth> {
    VectorWidth::ALL.into_iter().filter(|width| Processor::Host.has(*width))
}

/// Name of a kernel of a width in the tables.
fn title(width: VectorWidth) -> String {
    format!("isophote's kernel, {} bits", 8 * width.bytes())
}

impl Case {
    /// The program that a contender is compiled from. C with `-ffast-math` contracts multiply-adds on its own, and
    /// does not vectorise explicit ones.
    fn program(&self, variant: &CodeVariant) -> &Program {
        match (variant.body, variant.command[0]) {
            (Body::Unfactored, _) => &self.plain,
            (Body::Same, "cc") => &self.for_c,
            _ => &self.optimised,
        }
    }
}

fn cases(model: &Model) -> Vec<Case> {
    let case = |(name, title, subset): (&'static str, &'static str, &str)| {
        let ids: Vec<_> = subset.split(',').map(|n| model.parameter(n).unwrap()).collect();
        let jit: Vec<Kernel> = widths().map(|width| kernel(model, subset, PixelFormat::F32, false, width)).collect();
        let optimised = jit[0].program().clone();
        let plain = plain_program(model, &ids, Method::Newton, Part::Both).unwrap();
        let plain = over_pixels_of(&plain, &optimised).unwrap();
        let unfused = Lowering { fma: false, drop_saturated: false };
        let for_c = model.objective(&ids, Method::Newton).unwrap().program(unfused).unwrap();
        Case { name, title, jit, optimised, for_c, plain }
    };
    SUBSETS.map(case).into_iter().collect()
}

fn compile(model: &Model, cases: &[Case], variant: &CodeVariant) -> Compiled {
    let function = |case: &Case| -> (String, Program) { (case.name.into(), case.program(variant).clone()) };
    let programs: Vec<(String, Program)> = cases.iter().map(function).collect();
    let functions: Vec<Function<'_>> = programs
        .iter()
        .map(|(name, program)| Function { name: name.clone(), program, pixel: PixelType::F32 })
        .collect();
    let source = match variant.body {
        Body::Sympy => include_str!("sympy_cse.c").to_string(),
        Body::Same | Body::Unfactored => contenders::source(model, variant, &functions),
    };
    let extension = if variant.command[0] == "cc" { "c" } else { "rs" };
    let file = format!("{}.{extension}", variant.name.replace([',', ' ', '\''], "_"));
    let made = Compiled::new(&contenders::folder(), &file, &source, &variant.command).unwrap();
    if variant.command[0] == "cc" {
        assert_eq!(made.loops_with_vectors(variant.bits), cases.len(), "{}: pixel loops with vectors", variant.name);
    }
    made
}

/// All subsets: over the large picture, half of which the domain covers, and over smaller ones, covered by the domain
/// or with an inscribed ellipse.
pub fn races() -> [Vec<Race>; 4] {
    let model = Model::from_toml(&text("thesis-spot")).unwrap();
    let cases = cases(&model);
    let compiled: Vec<(CodeVariant, Compiled)> = contenders::variants()
        .into_iter()
        .map(|variant| (variant.clone(), compile(&model, &cases, &variant)))
        .collect();
    let large = Scene {
        bytes: bytes(&picture(&model, &truth(&model), [WIDTH, HEIGHT])),
        size: [WIDTH, HEIGHT],
        parameters: beside_truth(&model),
        passes: 1,
    };
    let [medium, covered, ellipse] = SMALLER.map(|(size, domain, passes)| {
        let (bytes, parameters) = small(&model, size, domain);
        Scene { bytes, size, parameters, passes }
    });
    [&large, &medium, &covered, &ellipse]
        .map(|scene| cases.iter().map(|case| run(&model, case, &compiled, scene)).collect())
}

/// One subset over one picture.
fn run(model: &Model, case: &Case, compiled: &[(CodeVariant, Compiled)], scene: &Scene) -> Race {
    let Scene { bytes, size: [width, height], parameters, passes } = scene;
    let (width, height, passes) = (*width, *height, *passes);
    let bindings = Bindings { parameters, entry: parameters, ..Bindings::default() };
    let plane = PlaneView::new(PixelFormat::F32, bytes, width, height, width * 4, 4).unwrap();
    let sums = |kernel: &Kernel| {
        repeated(passes, || {
            let sums = kernel.sums(&bindings, &[plane], Window::whole(width, height)).unwrap();
            (sums.outputs, sums.pixels)
        })
    };
    let (expected, pixels) = sums(&case.jit[0]);
    let scales = scales(&expected);
    let mut contenders = Vec::new();
    for kernel in &case.jit {
        let (ours, used) = sums(kernel);
        refuse_wrong(&title(kernel.options().width), &expected, &ours, &scales, 1e-4);
        assert_eq!(used, pixels, "other pixels");
        contenders.push(Contender {
            name: title(kernel.options().width),
            turn: Box::new(|| sums(kernel)),
            code_bytes: Some(kernel.code_bytes()),
        });
    }
    for (variant, made) in compiled {
        let program = case.program(variant);
        let Sink::Sums { outputs, .. } = program.sink() else { unreachable!() };
        let inputs: Vec<f64> = match variant.body {
            Body::Sympy => SYMPY_INPUTS.map(|name| parameters[model.parameter(name).unwrap().index()]).into(),
            Body::Same | Body::Unfactored => program.gather(&bindings).collect(),
        };
        let call = format!("call_{}", case.name);
        let function = made.function(&call, inputs.len(), outputs.len(), 4).unwrap();
        let picture = Picture { bytes, width, height };
        let pass = move || function.sums(picture, [0, 0, width, height], &inputs).unwrap();
        let turn = move || repeated(passes, &pass);
        // The plain derivatives do not sum F itself.
        let from = usize::from(variant.body == Body::Unfactored);
        let (theirs, used) = turn();
        refuse_wrong(variant.name, &expected[from..], &theirs, &scales[from..], 1e-4);
        assert_eq!(used, pixels, "{}: other pixels", variant.name);
        let code_bytes = made.code_bytes(case.name).or_else(|| made.code_bytes(&call));
        contenders.push(Contender { name: variant.name.into(), turn: Box::new(turn), code_bytes });
    }
    Race { name: case.title, times: race(&contenders) }
}

/// The thesis' function for the three extents, and the kernels of the same subset, with and without saturation
/// control.
pub fn thesis() -> Vec<ContenderTime> {
    let model = Model::from_toml(&text("rational-spot")).unwrap();
    let pixels = picture(&model, &truth(&model), [WIDTH, HEIGHT]);
    let beside = beside_truth(&model);
    let named: [f64; 7] =
        ["a1", "a2", "a3", "bx", "by", "v0", "v1"].map(|name| beside[model.parameter(name).unwrap().index()]);
    let (expected, used) = appendix::referee(&pixels, WIDTH, HEIGHT, &named);
    let in_rows = bytes(&pixels);
    let in_columns = bytes(&appendix::columns(&pixels, WIDTH));
    let compiled = [true, false].map(|rows| appendix::compiled(rows).unwrap());
    let mut contenders = Vec::new();
    let scale = scales(&[&[expected[0].abs() * named[0]], &expected[..]].concat())[1..].to_vec();
    let kernels: Vec<(String, Model)> = ["rational-spot", "thesis-spot"]
        .map(|name| (format!("isophote's kernel of {name}"), Model::from_toml(&text(name)).unwrap()))
        .into();
    let plane = PlaneView::new(PixelFormat::F32, &in_rows, WIDTH, HEIGHT, WIDTH * 4, 4).unwrap();
    for (name, model) in kernels {
        let kernel = kernel(&model, "a1,a2,a3", PixelFormat::F32, true, VectorWidth::Bits128);
        let parameters = beside_truth(&model);
        let code_bytes = Some(kernel.code_bytes());
        let turn = move || {
            let bindings =
                Bindings { parameters: &parameters, entry: &parameters, saturation: &[255.0], ..Bindings::default() };
            let sums = kernel.sums(&bindings, &[plane], Window::whole(WIDTH, HEIGHT)).unwrap();
            (sums.outputs, sums.pixels)
        };
        contenders.push(Contender { name, turn: Box::new(turn), code_bytes });
    }
    for (name, made, bytes, size) in [
        ("appendix A.1, pixels in rows", &compiled[0], &in_rows, [WIDTH, HEIGHT]),
        ("appendix A.1 as printed, pixels in columns", &compiled[1], &in_columns, [HEIGHT, WIDTH]),
    ] {
        let function = made.function("call_appendix_a1", named.len(), 9, 4).unwrap();
        let picture = Picture { bytes, width: size[0], height: size[1] };
        let turn = move || (function.sums(picture, [0, 0, WIDTH, HEIGHT], &named).unwrap().0, used);
        // It sums a whole frame in f32.
        refuse_wrong(name, &expected, &turn().0, &scale, 1e-3);
        let code_bytes = made.code_bytes("call_appendix_a1");
        contenders.push(Contender { name: name.into(), turn: Box::new(turn), code_bytes });
    }
    race(&contenders)
}
