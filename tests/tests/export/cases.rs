//! Export cases: a program of a shipped model, its export options, and its pixels.

use isophote_export::{ExportOptions, Language, PixelType};
use isophote_symbolic::interpreter::{self, Pixels, Slices, Window};
use isophote_symbolic::{
    Bindings, Estimator, Lanes, Lowering, Method, Model, ParameterId, Precision, Program, Sink, Start,
};
use isophote_tests::repository;

/// Size of a plane along each coordinate, px.
pub const SIZE: [usize; 4] = [29, 23, 4, 3];
/// Widths of centred windows, in turn: some narrower than a group of pixels.
const WIDTHS: [usize; 5] = [27, 9, 5, 3, 1];
/// Saturation limit.
const LIMIT: f64 = 200.0;

/// One exported function and its arguments.
pub struct Case {
    pub model: Model,
    pub program: Program,
    pub precision: Precision,
    pub pixel: PixelType,
    pub packed: bool,
    pub lanes: usize,
    /// A fault to plant in the text.
    pub planted: Option<(&'static str, &'static str)>,
    pub name: String,
}

/// Result of a run: outputs, or all pixels of a rendering.
#[derive(Debug)]
pub struct Outcome {
    pub numbers: Vec<f64>,
    /// Pixels used, and pixels skipped as saturated.
    pub counts: [u64; 2],
}

/// Names that clash with the languages or the exported text, numbers beyond f32, functions of constants.
const AWKWARD: &str = r#"
name = "awkward"
description = "*/ // \u202e turned"
coordinates = ["x", "y"]
channels = ["uint8_t"]
[parameters]
nearest = { start = 0.5 }
None = { start = 1.5 }
sqrtf = { start = 2.5 }
total = { start = 0.25 }
NAN = { start = 3.0 }
[model]
intensity = "nearest * if(x * y < 1e39, x, y) + total * (x - None)^2 + 2^sqrtf * y + atan2(1, total) + NAN"
domain = "(x - 14)^2 + (y - 11)^2 <= 90"
"#;

/// Rows outside of its mask have NaN values.
const EMPTY_ROWS: &str = r#"
name = "empty-rows"
coordinates = ["x", "y"]
channels = ["phi"]
[parameters]
bx = { start = 14.3 }
by = { start = 11.2 }
v1 = { start = 9.0 }
[model]
intensity = "v1 * sqrt(36 - (y - by)^2) / (1 + (x - bx)^2)"
domain = "(x - bx)^2 + (y - by)^2 < 36"
"#;

/// Functions that a language's library lacks, and their derivatives, from the centre to far out.
const SPECIAL: &str = r#"
name = "special"
coordinates = ["x", "y"]
channels = ["phi"]
[parameters]
bx = { start = 14.0 }
k = { start = 0.4 }
[definitions]
u = "k * (x - bx)"
[model]
intensity = "bessel_j0(u) + bessel_j1(9 * u) + sinc(u * y) + erfc(u) + bessel_j1(u * y) * erf(u)"
"#;

/// Measured profiles over one and two axes, from the centre to beyond their ends.
const TABLES: &str = r#"
name = "tables"
coordinates = ["x", "y"]
channels = ["phi"]
[tables]
line = { first = -3.0, step = 1.25, values = [0.0, 0.4, 1.0, 0.7, 0.2, 0.05] }
plane = { first = [-6.0, -4.0], step = [3.0, 2.0], values = [[0.0, 0.1, 0.3, 0.2], [0.1, 0.5, 0.9, 0.6], [0.1, 0.6, 1.0, 0.4], [0.0, 0.1, 0.2, 0.1]] }
[parameters]
bx = { start = 14.0 }
k = { start = 0.4 }
[model]
intensity = '20 * table("line", k * (x - bx)) + 30 * table("plane", x - bx, k * y - 3)'
"#;

fn model(name: &str) -> Model {
    let text = match name {
        "awkward" => AWKWARD.into(),
        "special" => SPECIAL.into(),
        "tables" => TABLES.into(),
        "empty-rows" => EMPTY_ROWS.into(),
        shipped => std::fs::read_to_string(repository().join(format!("models/{shipped}.toml"))).unwrap(),
    };
    Model::from_toml(&text).unwrap()
}

fn objective(model: &Model, names: &str, lowering: Lowering) -> Program {
    let ids: Vec<ParameterId> = match names {
        "" => model.stages().last().unwrap().parameters.clone(),
        _ => names.split(',').map(|name| model.parameter(name).unwrap()).collect(),
    };
    model.objective(&ids, Method::Newton).unwrap().program(lowering).unwrap()
}

/// Models and subsets; an empty subset is that of the last stage.
const SUBSETS: [(&str, &str); 17] = [
    ("thesis-spot", "bx,by"),
    ("thesis-spot", "a1,a2,a3"),
    ("spot", ""),
    ("rational-spot", ""),
    ("ring", ""),
    ("dark-disc", ""),
    ("moffat", ""),
    ("gaussian", ""),
    ("gaussian-pixel", ""),
    ("three-spots", "xr,yr"),
    ("profile-1d", ""),
    ("blob-3d", ""),
    ("blob-4d", ""),
    ("awkward", ""),
    ("empty-rows", ""),
    ("special", ""),
    ("tables", ""),
];

/// With and without fused multiply-adds and saturation, for all pixel types, in both precisions.
pub fn one_lane() -> Vec<Case> {
    let mut cases = Vec::new();
    for (i, (name, subset)) in SUBSETS.into_iter().enumerate() {
        for (j, precision) in [Precision::F32, Precision::F64].into_iter().enumerate() {
            let model = model(name);
            let lowering = Lowering { fma: (i + j) % 2 == 0, drop_saturated: (i + j) % 3 != 1 };
            let program = objective(&model, subset, lowering);
            let pixel = [PixelType::F32, PixelType::U8, PixelType::U16][(i + j) % 3];
            let name = format!("case_{}", cases.len());
            cases.push(Case { model, program, precision, pixel, packed: i % 2 == 1, lanes: 1, planted: None, name });
        }
    }
    for name in ["thesis-spot", "blob-3d"] {
        let model = model(name);
        let program = model.rendering(Lowering::default()).unwrap();
        let name = format!("case_{}", cases.len());
        let (precision, pixel) = (Precision::F32, PixelType::U8);
        cases.push(Case { model, program, precision, pixel, packed: true, lanes: 1, planted: None, name });
    }
    cases
}

/// Vector code, up to this machine's widest vectors.
pub fn several_lanes() -> Vec<Case> {
    let widest = if std::is_x86_feature_detected!("avx512dq") { 16 } else { 8 };
    let mut cases = Vec::new();
    for (i, (name, subset)) in SUBSETS.into_iter().enumerate() {
        for lanes in [4, 8, 16].into_iter().filter(|lanes| *lanes <= widest) {
            let model = model(name);
            let program = objective(&model, subset, Lowering { fma: true, drop_saturated: (i + lanes / 4) % 2 == 0 });
            let pixel = [PixelType::F32, PixelType::U8, PixelType::U16][(i + lanes / 4) % 3];
            let name = format!("wide_{}", cases.len());
            let precision = Precision::F32;
            let case = Case { model, program, precision, pixel, packed: i % 2 == 1, lanes, planted: None, name };
            if !case.calls() {
                cases.push(case);
            }
        }
    }
    assert!(cases.len() > 7); // two widths on a processor without AVX-512
    cases
}

impl Case {
    pub fn title(&self) -> String {
        let Case { precision, pixel, packed, lanes, .. } = self;
        format!("{} as {}: {precision:?} {pixel:?} {packed} {lanes}", self.model.name(), self.name)
    }

    /// Whether it calls elementary functions.
    pub fn calls(&self) -> bool {
        self.program.instructions().iter().any(|x| x.op.is_call())
    }

    pub fn renders(&self) -> bool {
        matches!(self.program.sink(), Sink::Plane(_))
    }

    pub fn text(&self, language: Language) -> String {
        let options = ExportOptions {
            precision: self.precision,
            pixels: vec![self.pixel; self.model.channels().len()],
            packed: self.packed,
            lanes: self.lanes,
            name: Some(self.name.clone()),
            ..ExportOptions::new(language, 0)
        };
        let text = isophote_export::export(&self.model, &self.program, &options).unwrap();
        self.planted.map_or(text.clone(), |(from, to)| text.replacen(from, to, 1))
    }

    /// The window: first pixel and count along each coordinate.
    pub fn window(&self) -> ([usize; 4], [usize; 4]) {
        let number =
            self.name.bytes().filter(u8::is_ascii_digit).fold(0, |n, digit| 10 * n + usize::from(digit - b'0'));
        let width = WIDTHS[number % WIDTHS.len()];
        ([(SIZE[0] - width) / 2, 2, 1, 1], [width, 19, 2, 2])
    }

    pub fn dimensions(&self) -> usize {
        self.program.coordinates().max(2)
    }

    /// Stride along each coordinate, in pixels.
    pub fn strides(&self) -> [usize; 4] {
        let across = if self.packed { 1 } else { 2 };
        let down = SIZE[0] * across + 3;
        [across, down, down * SIZE[1], down * SIZE[1] * SIZE[2]]
    }

    /// Values of the program's inputs.
    pub fn inputs(&self) -> Vec<f64> {
        let (parameters, entry) = self.parameters();
        self.program.gather(&self.bindings(&parameters, &entry, &self.constants(), &[LIMIT; 8])).collect()
    }

    fn bindings<'a>(&self, p: &'a [f64], entry: &'a [f64], constants: &'a [f64], limits: &'a [f64]) -> Bindings<'a> {
        Bindings {
            parameters: p,
            entry,
            constants,
            saturation: &limits[..self.model.channels().len()],
            shift: &[0.25, -0.5],
        }
    }

    fn constants(&self) -> Vec<f64> {
        self.model.constants().iter().map(|constant| constant.value).collect()
    }

    /// Parameters at this evaluation, and at the start of the pass.
    fn parameters(&self) -> (Vec<f64>, Vec<f64>) {
        // The first spot of a pose is in the middle, at a distance of 1 m, with f = 600 px and centre (319.5, 239.5).
        let red_y = self.model.constant("red_y").map_or(0.0, |id| self.model.constants()[id.index()].value);
        let start = |start: Start| match start {
            Start::Number(number) => number,
            Start::Estimator(Estimator::Position(0)) => (SIZE[0] as f64 / 2.0 - 319.5) / 0.6,
            Start::Estimator(Estimator::Position(1)) => (SIZE[1] as f64 / 2.0 - 239.5) / 0.6 - red_y,
            Start::Estimator(Estimator::Position(_)) => 1000.0,
            Start::Estimator(Estimator::Orientation(axis)) => 0.01 * axis as f64,
            Start::Estimator(Estimator::Centroid(axis)) => SIZE[axis] as f64 / 2.0 + 0.3,
            Start::Estimator(Estimator::Extent(i, j)) if i == j => 0.012,
            Start::Estimator(Estimator::Extent(..)) => 0.001,
            Start::Estimator(Estimator::Size(_)) => 8.5,
            Start::Estimator(Estimator::Background) => 20.5,
            Start::Estimator(Estimator::Amplitude) => 150.25,
            Start::Estimator(Estimator::Frequency) => 0.08,
            Start::Estimator(Estimator::Angle | Estimator::Direction | Estimator::Phase) => 0.4,
        };
        let entry: Vec<f64> = self.model.parameters().iter().map(|parameter| start(parameter.start)).collect();
        (entry.iter().map(|value| value * 1.01).collect(), entry)
    }

    pub fn interpreted(&self) -> Outcome {
        let (parameters, entry) = self.parameters();
        let constants = self.constants();
        let bindings = self.bindings(&parameters, &entry, &constants, &[LIMIT; 8]);
        let (first, count) = self.window();
        let window = Window {
            x: first[0],
            y: first[1],
            width: count[0],
            height: count[1],
            slices: Slices { first: [first[2], first[3]], count: [count[2], count[3]] },
        };
        let mut plane = vec![0.0_f32; count[..self.dimensions()].iter().product()];
        let out = self.renders().then_some(&mut plane[..]);
        let lanes = Lanes::of(self.lanes).unwrap();
        let outcome = interpreter::run(&self.program, self.precision, lanes, &bindings, self, window, out);
        let numbers = if self.renders() { plane.into_iter().map(f64::from).collect() } else { outcome.outputs };
        Outcome { numbers, counts: [outcome.pixels, outcome.saturated] }
    }
}

/// The pixel stored at a position of a plane's memory.
pub fn stored(channel: usize, place: usize) -> usize {
    (place * 7919 + channel * 131) % 251
}

impl Pixels for Case {
    fn at(&self, channel: usize, x: usize, y: usize) -> f64 {
        self.at_place(channel, [x, y, 0, 0])
    }

    fn at_place(&self, channel: usize, place: [usize; 4]) -> f64 {
        let used = place.into_iter().zip(self.strides()).take(self.dimensions());
        let value = stored(channel, used.map(|(at, stride)| at * stride).sum()) as f64;
        if self.pixel == PixelType::F32 { value + 0.25 } else { value }
    }
}
