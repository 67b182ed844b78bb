//! Native code equals the interpreter bit for bit: shipped documents and test documents, over formats, precisions, strides,
//! windows, saturation, edge-case values. Messages of failures contain the seed.
#![allow(clippy::unwrap_used)]

mod common;

use common::{Image, Random, agree, agree_with, document, lowerings, parameters, programs, shipped, widths};
use isophote_jit::{Kernel, KernelOptions, PixelFormat, Slices, VectorWidth, Window};
use isophote_symbolic::{Bindings, Lowering, Model, Precision};

const PRECISIONS: [Precision; 2] = [Precision::F32, Precision::F64];

fn arithmetics() -> impl Iterator<Item = (Precision, VectorWidth)> {
    PRECISIONS.into_iter().flat_map(|precision| widths().into_iter().map(move |width| (precision, width)))
}

/// Documents that cover every part of the lowering.
const OWN: [&str; 5] = [
    // A mask, not bounds; two channels; comparisons joined.
    r#"
    name = "masked"
    coordinates = ["x", "y"]
    channels = ["r", "g"]
    [parameters]
    bx = { start = 10.0 }
    by = { start = 7.0 }
    v0 = { start = 1.0 }
    v1 = { start = 1.0 }
    [model]
    observed = "r - 0.5 * g"
    intensity = "v0 + v1 * (x - bx) * (y - by)"
    domain = "abs(x - bx) + sin(y) <= 9 and not (x * y > 150) or y < 2"
    "#,
    // Every elementary function, in the pixel and outside.
    r#"
    name = "functions"
    coordinates = ["x", "y"]
    channels = ["phi"]
    [parameters]
    bx = { start = 10.0 }
    w = { start = 2.0 }
    v1 = { start = 1.0 }
    [definitions]
    d = "(x - bx) / w"
    e = "exp(-d^2) + log(1 + d^2) + sin(d) + cos(d * w) + tan(d / 9) + atan(d) + atan2(d, w)"
    g = "asin(d / 100) + acos(d / 100) + sinh(d / 20) + cosh(d / 20) + tanh(d) + erf(d) + sqrt(d^2 + 1) + abs(d)^1.5"
    [model]
    intensity = "v1 * (e + g) + sin(w) * y + erf(y / w)"
    "#,
    // One coordinate, two branches, minimum and maximum.
    r#"
    name = "branches"
    coordinates = ["x"]
    channels = ["phi"]
    [parameters]
    b = { start = 10.0 }
    v0 = { start = 2.0 }
    v1 = { start = 1.0 }
    [model]
    intensity = "piecewise(x < b, v0 + v1 * x, x <= b + 3, v0 * v1, max(v0, v1 * (x - b)) + min(x, b))"
    "#,
    // Weights that depend on the parameters.
    r#"
    name = "noisy"
    coordinates = ["x", "y"]
    channels = ["phi"]
    [parameters]
    bx = { start = 10.0 }
    by = { start = 7.0 }
    v0 = { start = 20.0 }
    v1 = { start = 100.0 }
    [constants]
    read_noise = 0.75
    gain = 0.05
    [definitions]
    m = "v0 + v1 * exp(-((x - bx)^2 + (y - by)^2) / 30)"
    [model]
    intensity = "m"
    domain = "(x - bx)^2 + (y - by)^2 <= 60"
    noise = "read_noise^2 + gain * max(m, 0)"
    "#,
    // Division, a domain that is a half plane, bounds that are infinite in some rows.
    r#"
    name = "rational"
    coordinates = ["x", "y"]
    channels = ["phi"]
    [parameters]
    bx = { start = 10.0 }
    by = { start = 7.0 }
    v1 = { start = 100.0 }
    [model]
    intensity = "v1 / (1 + (x - bx)^2 + abs(y - by))"
    domain = "x - bx + 0.3 * (y - by) >= -4"
    "#,
];

fn models() -> Vec<Model> {
    let names = ["thesis-spot", "spot", "rational-spot", "gaussian", "dark-disc", "profile-1d"];
    names.iter().map(|name| shipped(name)).chain(OWN.iter().map(|text| document(text))).collect()
}

fn size(model: &Model) -> [usize; 2] {
    [23, if model.coordinates().len() == 1 { 1 } else { 17 }]
}

/// Plausible pixels, some at the limit.
fn image(model: &Model, format: PixelFormat, gaps: [usize; 2], random: &mut Random) -> Image {
    let value = |_: usize, _: usize, _: usize| if random.below(6) == 0 { 250.0 } else { random.between(0.0, 249.0) };
    Image::new(format, size(model), model.channels().len(), gaps, value)
}

fn constants(model: &Model) -> Vec<f64> {
    model.constants().iter().map(|c| c.value).collect()
}

#[test]
fn every_format_stride_and_precision() {
    let seed = 1;
    let mut random = Random(seed);
    for model in models() {
        for lowering in lowerings() {
            for (name, program) in programs(&model, lowering) {
                for precision in PRECISIONS {
                    let format = *random.pick(&PixelFormat::ALL);
                    let gaps = *random.pick(&[[0, 0], [0, 5], [1, 0], [2, 3], [7, 11]]);
                    let image = image(&model, format, gaps, &mut random);
                    let values = parameters(&model, size(&model), &mut random);
                    let entry = parameters(&model, size(&model), &mut random);
                    let constants = constants(&model);
                    let saturation = vec![250.0; model.channels().len()];
                    let bindings = Bindings {
                        parameters: &values,
                        entry: &entry,
                        constants: &constants,
                        saturation: &saturation,
                        shift: &[],
                    };
                    let window = Window::whole(image.width, image.height);
                    agree(&program, precision, &bindings, &image, window, &format!("{name}, seed {seed}"));
                }
            }
        }
    }
}

#[test]
fn all_formats_with_and_without_gaps() {
    let seed = 2;
    let mut random = Random(seed);
    for model in [shipped("spot"), document(OWN[0])] {
        let program = programs(&model, Lowering { fma: false, drop_saturated: true }).swap_remove(2).1;
        for format in PixelFormat::ALL {
            for gaps in [[0, 0], [0, 3], [3, 0], [2 * format.bytes_per_pixel(), 1]] {
                for precision in PRECISIONS {
                    let image = image(&model, format, gaps, &mut random);
                    let values = parameters(&model, size(&model), &mut random);
                    let saturation = vec![250.0; model.channels().len()];
                    let bindings = Bindings {
                        parameters: &values,
                        entry: &values,
                        saturation: &saturation,
                        ..Bindings::default()
                    };
                    let window = Window::whole(image.width, image.height);
                    let outcome = agree(&program, precision, &bindings, &image, window, &format!("seed {seed}"));
                    assert!(outcome.pixels > 0 && outcome.saturated > 0, "the case is empty");
                }
            }
        }
    }
}

#[test]
fn windows_of_every_width() {
    let seed = 3;
    let mut random = Random(seed);
    for model in [shipped("thesis-spot"), shipped("spot"), document(OWN[0]), document(OWN[4])] {
        let kinds = [(false, Precision::F32), (true, Precision::F32), (false, Precision::F64)];
        for ((drop_saturated, precision), width) in kinds.iter().flat_map(|k| widths().into_iter().map(|w| (*k, w))) {
            let program = programs(&model, Lowering { fma: false, drop_saturated }).swap_remove(2).1;
            for gaps in [[0, 0], [1, 0]] {
                let image = image(&model, PixelFormat::U8, gaps, &mut random);
                let options = KernelOptions {
                    width,
                    precision,
                    formats: vec![image.format; model.channels().len()],
                    packed: gaps == [0, 0],
                };
                let kernel = Kernel::compile(&program, &options).unwrap();
                for columns in 1..=19 {
                    for _ in 0..4 {
                        let height = 1 + random.below(image.height);
                        let window = Window {
                            x: random.below(image.width - columns + 1),
                            y: random.below(image.height - height + 1),
                            width: columns,
                            height,
                            slices: Slices::ONE,
                        };
                        let values = parameters(&model, size(&model), &mut random);
                        let saturation = vec![250.0; model.channels().len()];
                        let bindings = Bindings {
                            parameters: &values,
                            entry: &values,
                            saturation: &saturation,
                            ..Bindings::default()
                        };
                        agree_with(&kernel, &bindings, &image, window, &format!("{}, seed {seed}", model.name()));
                    }
                }
            }
        }
    }
}

/// Edge-case numbers.
const ODD: [f64; 16] = [
    f64::NAN,
    f64::INFINITY,
    f64::NEG_INFINITY,
    0.0,
    -0.0,
    5e-324,
    -1e-310,
    1e-40,
    -1e-45,
    f64::MAX,
    f64::MIN,
    1e300,
    3e38,
    4503599627370497.5,
    -9.3e18,
    1.0,
];

#[test]
fn odd_parameters() {
    let seed = 4;
    let mut random = Random(seed);
    for model in models() {
        for (name, program) in programs(&model, Lowering { fma: false, drop_saturated: false }) {
            for (precision, width) in arithmetics() {
                let image = image(&model, PixelFormat::U8, [0, 0], &mut random);
                let options = KernelOptions {
                    width,
                    precision,
                    formats: vec![image.format; model.channels().len()],
                    packed: true,
                };
                let kernel = Kernel::compile(&program, &options).unwrap();
                for _ in 0..12 {
                    let mut values = parameters(&model, size(&model), &mut random);
                    let mut entry = values.clone();
                    let at = random.below(values.len());
                    values[at] = *random.pick(&ODD);
                    if random.below(3) > 0 {
                        let at = random.below(values.len());
                        entry[at] = *random.pick(&ODD);
                    }
                    let constants = constants(&model);
                    let bindings =
                        Bindings { parameters: &values, entry: &entry, constants: &constants, ..Bindings::default() };
                    let window = Window::whole(image.width, image.height);
                    let context = format!("{name}, {values:?}, {entry:?}, seed {seed}");
                    agree_with(&kernel, &bindings, &image, window, &context);
                }
            }
        }
    }
}

#[test]
fn odd_pixels() {
    let seed = 5;
    let mut random = Random(seed);
    for model in models() {
        for lowering in lowerings() {
            for (name, program) in programs(&model, lowering) {
                for precision in PRECISIONS {
                    let format = *random.pick(&[PixelFormat::F32, PixelFormat::F64]);
                    let value = |_: usize, _: usize, _: usize| {
                        if random.below(9) == 0 { *random.pick(&ODD) } else { random.between(0.0, 255.0) }
                    };
                    let image = Image::new(format, size(&model), model.channels().len(), [0, 0], value);
                    let values = parameters(&model, size(&model), &mut random);
                    let constants = constants(&model);
                    let limit = *random.pick(&[250.0, f64::INFINITY, f64::NAN]);
                    let saturation = vec![limit; model.channels().len()];
                    let bindings = Bindings {
                        parameters: &values,
                        entry: &values,
                        constants: &constants,
                        saturation: &saturation,
                        shift: &[],
                    };
                    let window = Window::whole(image.width, image.height);
                    agree(&program, precision, &bindings, &image, window, &format!("{name}, seed {seed}"));
                }
            }
        }
    }
}

#[test]
fn rows_outside_the_domain_are_skipped() {
    let model = shipped("spot");
    let mut random = Random(6);
    let image = image(&model, PixelFormat::U8, [0, 0], &mut random);
    let mut values = parameters(&model, size(&model), &mut random);
    let names: Vec<&str> = model.parameters().iter().map(|p| p.name.as_str()).collect();
    let at = |name: &str| names.iter().position(|n| *n == name).unwrap();
    values[at("a1")] = 1.0 / 9.0;
    values[at("a2")] = 0.0;
    values[at("a3")] = 1.0 / 9.0;
    for (bx, by, some) in
        [(11.3, 8.2, true), (-3.9, 8.2, true), (26.2, 8.2, true), (11.3, -400.0, false), (900.0, 8.0, false)]
    {
        values[at("bx")] = bx;
        values[at("by")] = by;
        let bindings = Bindings { parameters: &values, entry: &values, ..Bindings::default() };
        for (name, program) in programs(&model, Lowering { fma: false, drop_saturated: false }) {
            for precision in PRECISIONS {
                let window = Window::whole(image.width, image.height);
                let outcome = agree(&program, precision, &bindings, &image, window, &name);
                assert_eq!(outcome.pixels > 0, some, "{name} at {bx}, {by}");
                assert!(outcome.pixels < 70, "{name} at {bx}, {by}: {}", outcome.pixels);
            }
        }
    }
}

/// Three and four coordinates: bounds that slices and volumes move, a mask, a row value of each outer coordinate.
const STACKS: [&str; 3] = [
    r#"
    name = "blob"
    coordinates = ["x", "y", "z"]
    channels = ["phi"]
    [parameters]
    bx = { start = 5.0 }
    by = { start = 4.0 }
    bz = { start = 2.0 }
    a1 = { start = 0.05 }
    v0 = { start = 10.0 }
    v1 = { start = 100.0 }
    [definitions]
    s = "a1 * ((x - bx)^2 + (y - by)^2 + 2 * (z - bz)^2 + 0.3 * (x - bx) * (z - bz))"
    [model]
    intensity = "v0 + v1 * exp(-2 * s)"
    domain = "s <= 1.5"
    "#,
    r#"
    name = "moving"
    coordinates = ["x", "y", "z", "t"]
    channels = ["phi"]
    [parameters]
    bx = { start = 5.0 }
    by = { start = 4.0 }
    bz = { start = 2.0 }
    u = { start = 0.4 }
    a1 = { start = 0.05 }
    v1 = { start = 100.0 }
    [definitions]
    s = "a1 * ((x - bx - u * t)^2 + (y - by)^2 + (z - bz + 0.2 * t)^2)"
    [model]
    intensity = "v1 * (1 + t / 5) / (1 + s)^2"
    domain = "s <= 2"
    "#,
    r#"
    name = "masked"
    coordinates = ["x", "y", "z", "t"]
    channels = ["r", "g"]
    [parameters]
    bx = { start = 5.0 }
    bt = { start = 2.0 }
    v1 = { start = 100.0 }
    [model]
    observed = "r - 0.5 * g"
    intensity = "v1 * (x - bx) + sin(z) * (t - bt)^2"
    domain = "abs(x - bx) + sin(y) + z <= 9 and not (x * y * t > 60)"
    "#,
];

#[test]
fn stacks_agree_slice_by_slice() {
    let seed = 7;
    let mut random = Random(seed);
    for model in STACKS.map(document) {
        let length = if model.coordinates().len() == 4 { 4 } else { 1 };
        let size = [21, 9, 5, length];
        for lowering in lowerings() {
            for (name, program) in programs(&model, lowering) {
                for (precision, width) in arithmetics() {
                    let format = *random.pick(&PixelFormat::ALL);
                    let gaps = *random.pick(&[[0, 0, 0, 0], [0, 5, 2, 9], [1, 0, 3, 0], [7, 11, 1, 4]]);
                    let image = Image::stack(format, size, model.channels().len(), gaps, |_, _| {
                        if random.below(6) == 0 { 250.0 } else { random.between(0.0, 249.0) }
                    });
                    let packed = gaps[0] == 0;
                    let formats = vec![format; model.channels().len()];
                    let kernel =
                        Kernel::compile(&program, &KernelOptions { width, precision, formats, packed }).unwrap();
                    let saturation = vec![250.0; model.channels().len()];
                    for whole in [true, false, false] {
                        let side = |n: usize, random: &mut Random| {
                            let count = 1 + random.below(n);
                            (random.below(n - count + 1), count)
                        };
                        let sides = size.map(|n| if whole { (0, n) } else { side(n, &mut random) });
                        let [(x, width), (y, height), (z, depth), (w, length)] = sides;
                        let slices = Slices { first: [z, w], count: [depth, length] };
                        let window = Window { x, y, width, height, slices };
                        let values = parameters(&model, [13, 9], &mut random);
                        let entry = parameters(&model, [13, 9], &mut random);
                        let bindings = Bindings {
                            parameters: &values,
                            entry: &entry,
                            saturation: &saturation,
                            ..Bindings::default()
                        };
                        let context = format!("{name}, seed {seed}");
                        let outcome = agree_with(&kernel, &bindings, &image, window, &context);
                        assert!(!whole || outcome.pixels > 50, "the case is empty: {context}");
                    }
                }
            }
        }
    }
}
