//! Shared test helpers: seeded random numbers, images in memory, and the comparison of a kernel with the interpreter.
#![allow(dead_code, clippy::unwrap_used)] // each test file uses its part

pub mod differential;
pub mod documents;
pub mod fault;
pub mod generate;
#[path = "../../../symbolic/src/proof/grammar_tests.rs"]
pub mod grammar;
pub mod soak;

use isophote_jit::{Kernel, KernelOptions, PixelFormat, PlaneView, Processor, VectorWidth, Window, has_fma};
use isophote_symbolic::interpreter::{self, Outcome, Pixels};
use isophote_symbolic::{
    Axis, Bindings, Lowering, Method, Model, ParameterId, Precision, Program, Table, Tables, ValueKind,
};

/// SplitMix64.
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }
    pub fn below(&mut self, n: usize) -> usize {
        (self.next() % n as u64) as usize
    }
    /// 0 ≤ x < 1
    pub fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }
    pub fn between(&mut self, lo: f64, hi: f64) -> f64 {
        lo + (hi - lo) * self.unit()
    }
    /// An edge-case number.
    pub fn special(&mut self) -> f64 {
        let single = |x: f32| f64::from(x);
        let magnitudes = [
            f64::NAN,
            f64::INFINITY,
            0.0,
            f64::from_bits(1),
            f64::MIN_POSITIVE / 3.0,
            f64::MIN_POSITIVE,
            single(f32::from_bits(1)),
            single(f32::MIN_POSITIVE) / 3.0,
            single(f32::MIN_POSITIVE),
            single(f32::MAX),
            f64::MAX,
            1e-200,
            1e-20,
            1e20,
            1e200,
            255.0,
            65535.0,
            16_777_217.0,
            2_147_483_648.0,
            4_503_599_627_370_497.5,
            9_007_199_254_740_993.0,
            9_223_372_036_854_775_808.0,
        ];
        let magnitude = *self.pick(&magnitudes);
        if self.below(2) == 0 { magnitude } else { -magnitude }
    }
    /// An ordinary number: about the size of coordinates, with and without a fraction.
    pub fn ordinary(&mut self) -> f64 {
        match self.below(4) {
            0 => self.below(12) as f64,
            1 => self.below(40) as f64 / 4.0 - 4.0,
            2 => self.between(-2.0, 2.0),
            _ => self.between(-20.0, 300.0),
        }
    }
    pub fn pick<'a, T>(&mut self, all: &'a [T]) -> &'a T {
        &all[self.below(all.len())]
    }
}

/// Bytes of one or more planes of one size.
pub struct Image {
    pub format: PixelFormat,
    pub width: usize,
    pub height: usize,
    pub size: [usize; 4],
    pub strides: [usize; 4],
    pub channels: Vec<Vec<u8>>,
}

impl Image {
    /// Pixels by `value(channel, x, y)`; `gap` bytes between pixels and `margin` bytes after a row hold garbage, as do the bytes
    /// before the first pixel, so that nothing is aligned.
    pub fn new(
        format: PixelFormat,
        [width, height]: [usize; 2],
        channels: usize,
        [gap, margin]: [usize; 2],
        mut value: impl FnMut(usize, usize, usize) -> f64,
    ) -> Image {
        let gaps = [gap, margin, 0, 0];
        Image::stack(format, [width, height, 1, 1], channels, gaps, |channel, [x, y, ..]| value(channel, x, y))
    }

    /// Like [`Image::new`] for slices and volumes, with gaps after each pixel, row, slice and volume.
    pub fn stack(
        format: PixelFormat,
        size: [usize; 4],
        channels: usize,
        gaps: [usize; 4],
        mut value: impl FnMut(usize, [usize; 4]) -> f64,
    ) -> Image {
        let mut strides = [format.bytes_per_pixel() + gaps[0]; 4];
        for axis in 1..4 {
            strides[axis] = size[axis - 1] * strides[axis - 1] + gaps[axis];
        }
        let at = |place: [usize; 4]| 1 + place.iter().zip(strides).map(|(at, stride)| at * stride).sum::<usize>();
        let [width, height, depth, length] = size;
        let places = || {
            let slices = (0..length).flat_map(move |w| (0..depth).map(move |z| (z, w)));
            let rows = slices.flat_map(move |(z, w)| (0..height).map(move |y| (y, z, w)));
            rows.flat_map(move |(y, z, w)| (0..width).map(move |x| [x, y, z, w]))
        };
        // The last row ends with its last pixel: a read beyond it leaves the slice.
        let bytes = at(size.map(|n| n - 1)) + format.bytes_per_pixel();
        let plane = |channel: usize| {
            let mut bytes = vec![0xEE_u8; bytes];
            for place in places() {
                let (at, value) = (at(place), value(channel, place));
                match format {
                    PixelFormat::U8 => bytes[at] = value as u8,
                    PixelFormat::U16 => bytes[at..at + 2].copy_from_slice(&(value as u16).to_ne_bytes()),
                    PixelFormat::F32 => bytes[at..at + 4].copy_from_slice(&(value as f32).to_ne_bytes()),
                    PixelFormat::F64 => bytes[at..at + 8].copy_from_slice(&value.to_ne_bytes()),
                }
            }
            bytes
        };
        Image { format, width, height, size, strides, channels: (0..channels).map(plane).collect() }
    }

    pub fn views(&self) -> Vec<PlaneView<'_>> {
        let view = |bytes| PlaneView::stack(self.format, bytes, self.size, self.strides);
        self.channels.iter().map(|bytes| view(&bytes[1..]).unwrap()).collect()
    }
}

/// The interpreter's access to the same pixels.
pub struct Planes<'a>(pub Vec<PlaneView<'a>>);

impl Pixels for Planes<'_> {
    fn at(&self, channel: usize, x: usize, y: usize) -> f64 {
        self.0[channel].pixel(x, y)
    }
    fn at_place(&self, channel: usize, place: [usize; 4]) -> f64 {
        self.0[channel].pixel_at(place)
    }
}

/// NaNs of any payload are equal; all else bit for bit.
pub fn same(a: f64, b: f64) -> bool {
    a.to_bits() == b.to_bits() || (a.is_nan() && b.is_nan())
}

/// Runs the kernel and the interpreter; panics if they differ. Returns their outcome.
pub fn agree(
    program: &Program,
    precision: Precision,
    bindings: &Bindings<'_>,
    image: &Image,
    window: Window,
    context: &str,
) -> Outcome {
    let packed = image.strides[0] == image.format.bytes_per_pixel();
    let mut outcome = None;
    for width in widths() {
        let options = KernelOptions { width, precision, formats: vec![image.format; program.channels()], packed };
        let kernel = Kernel::compile(program, &options).unwrap_or_else(|e| panic!("{context}, {width:?}: {e}"));
        outcome = Some(agree_with(&kernel, bindings, image, window, context));
    }
    outcome.unwrap()
}

/// The vector widths of this machine; reports those that it lacks.
pub fn widths() -> Vec<VectorWidth> {
    let (there, absent): (Vec<_>, Vec<_>) = VectorWidth::ALL.into_iter().partition(|width| Processor::Host.has(*width));
    static SAID: std::sync::Once = std::sync::Once::new();
    SAID.call_once(|| absent.iter().for_each(|width| eprintln!("skipped: this processor has no {width:?}")));
    there
}

/// Like [`agree`], with a compiled kernel.
pub fn agree_with(kernel: &Kernel, bindings: &Bindings<'_>, image: &Image, window: Window, context: &str) -> Outcome {
    let (program, options) = (kernel.program(), kernel.options());
    let native = kernel.sums(bindings, &image.views(), window).unwrap_or_else(|e| panic!("{context}: {e}"));
    let planes = Planes(image.views());
    let expected = interpreter::run(program, options.precision, options.summation(), bindings, &planes, window, None);
    let context = || format!("{context}, {options:?}, strides {:?}, {window:?}", image.strides);
    assert_eq!(native.pixels, expected.pixels, "pixels: {}", context());
    assert_eq!(native.saturated, expected.saturated, "saturated: {}", context());
    assert_eq!(native.outputs.len(), expected.outputs.len(), "outputs: {}", context());
    for (i, (a, b)) in native.outputs.iter().zip(&expected.outputs).enumerate() {
        let name = program.names().outputs.get(i).map_or("?", String::as_str);
        assert!(same(*a, *b), "{name}: native {a:?}, interpreter {b:?}: {}", context());
    }
    expected
}

/// Every lowering that this machine supports.
pub fn lowerings() -> Vec<Lowering> {
    let all = [(false, false), (false, true), (true, false), (true, true)];
    all.into_iter()
        .filter(|(fma, _)| !fma || has_fma())
        .map(|(fma, drop_saturated)| Lowering { fma, drop_saturated })
        .collect()
}

/// A shipped document.
pub fn shipped(name: &str) -> Model {
    let path = format!("{}/../models/{name}.toml", env!("CARGO_MANIFEST_DIR"));
    document(&std::fs::read_to_string(path).unwrap())
}

pub fn document(text: &str) -> Model {
    Model::from_toml(text).unwrap_or_else(|diagnostics| panic!("{diagnostics:#?}\n{text}"))
}

/// The value programs, and Newton and Gauss–Newton of all parameters and of the first two.
pub fn programs(model: &Model, lowering: Lowering) -> Vec<(String, Program)> {
    let all: Vec<ParameterId> = (0..model.parameters().len()).map(|i| ParameterId(i as u32)).collect();
    let mut programs = Vec::new();
    for kind in [ValueKind::Entry, ValueKind::Full] {
        programs.push((format!("{kind:?}"), model.value_objective(kind).unwrap()));
    }
    for subset in [&all[..], &all[..all.len().min(2)]] {
        for method in [Method::Newton, Method::GaussNewton] {
            programs.push((format!("{method:?} of {}", subset.len()), model.objective(subset, method).unwrap()));
        }
    }
    let program = |(name, objective): (String, isophote_symbolic::Objective)| {
        (format!("{} {name} {lowering:?}", model.name()), objective.program(lowering).unwrap())
    };
    programs.into_iter().map(program).collect()
}

/// A start for a model of an image of that size: by name, else near 1.
pub fn parameters(model: &Model, [width, height]: [usize; 2], random: &mut Random) -> Vec<f64> {
    let (w, h) = (width as f64, height as f64);
    let mut value = |name: &str| match name {
        "bx" | "b" => random.between(0.3, 0.7) * w,
        "by" => random.between(0.3, 0.7) * h,
        "bz" | "bt" => random.between(1.0, 4.0),
        "a1" => random.between(2.0, 20.0) / (w * w),
        "a2" => random.between(-0.5, 0.5) / (w * h),
        "a3" => random.between(2.0, 20.0) / (h * h),
        "w" => random.between(0.1, 0.3) * w,
        "k1" => -0.5,
        "k2" => -0.3,
        "v0" => random.between(5.0, 30.0),
        "v1" => random.between(50.0, 200.0),
        _ => random.between(0.2, 2.0),
    };
    model.parameters().iter().map(|p| value(&p.name)).collect()
}

/// A profile over one axis and one over two.
pub fn tables() -> Tables {
    let axis = |first: f64, step: f64, count: usize| Axis { first, step, count };
    let line: Vec<f64> = (0..7).map(|i| f64::from(i * i % 5) - 1.5).collect();
    let plane: Vec<f64> = (0..30).map(|i| f64::from(i * i % 7) + 0.25).collect();
    let tables = [
        Table::through(&[axis(-1.0, 0.5, 7)], &line),
        Table::through(&[axis(-2.0, 1.0, 6), axis(0.0, 0.75, 5)], &plane),
    ];
    Tables::of(tables.into_iter().map(Option::unwrap).collect())
}
