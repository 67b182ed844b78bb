//! Random documents, and every program of one: machine code equals the interpreter bit for bit, and both equal the document's
//! formulas, evaluated pixel by pixel without a program.
#![allow(dead_code, clippy::unwrap_used)]

use super::fault::planted;
use super::grammar::{Document, PARAMETERS, Variety};
use super::{Image, Planes, Random, lowerings, same, widths};
use isophote_jit::{Kernel, KernelOptions, PixelFormat, Slices, VectorWidth, Window};
use isophote_symbolic::interpreter::{self, Outcome};
use isophote_symbolic::{
    Bindings, Diagnostics, DirectSums, Lowering, Method, Model, Objective, Opcode, ParameterId, Part, Precision,
    Prediction, Program, Summand, ValueKind,
};

/// Maximum error in f64 over the sum of the absolute terms.
const TOLERANCE: f64 = 1e-12;
/// Relative changes of every number, to detect comparisons that rounding decides.
const NUDGES: [f64; 4] = [1e-9, -1e-9, 3e-8, -3e-8];
/// A larger relative change of a pixel is due to a decision, not to rounding.
const DECIDED: f64 = 1e-5;

/// Statistics of the documents.
#[derive(Default, Debug)]
pub struct Tally {
    pub documents: u64,
    /// Documents with channels in one loop.
    pub joint: u64,
    /// Documents refused: past a limit, or invalid.
    pub refused: u64,
    pub programs: u64,
    /// Programs refused: past a limit, or with formulas that are undefined everywhere.
    pub costly: u64,
    pub undefined: u64,
    /// Rows without a pixel.
    pub empty_rows: u64,
    /// Runs of machine code.
    pub runs: u64,
    /// Runs with a finite sum or pixel that was compared with the formulas.
    pub compared: u64,
    /// Runs whose formulas are not finite.
    pub infinite: u64,
    /// Runs where rounding decides a comparison.
    pub undecided: u64,
    /// The largest error over the sum of the absolute terms.
    pub worst: f64,
    pub faults: Vec<String>,
}

impl Tally {
    fn refused(&mut self, what: &str, refused: &Diagnostics) {
        match refused[0].code.as_str() {
            "limit" => self.costly += 1,
            "undefined" => self.undefined += 1,
            _ => self.faults.push(format!("{what}: {}", refused[0].message)),
        }
    }
}

/// Image, window and bindings for the programs of a document.
struct Scene {
    image: Image,
    window: Window,
    values: Vec<f64>,
    entry: Vec<f64>,
    constants: Vec<f64>,
    saturation: Vec<f64>,
    shift: [f64; 2],
}

impl Scene {
    /// Pixels about the size of the formulas' predictions, in some scenes those of a camera; every third row may be saturated, and
    /// with `has_gaps` single pixels are NaN.
    fn new(random: &mut Random, document: &Document, model: &Model, has_gaps: bool) -> Scene {
        let format = if has_gaps { PixelFormat::F64 } else { *random.pick(&PixelFormat::ALL) };
        let is_dark = random.below(4) > 0;
        let [low, high, limit] = match (is_dark, format) {
            (true, PixelFormat::U8 | PixelFormat::U16) => [0.0, 6.0, 4.5],
            (true, _) => [-1.0, 5.0, 3.9],
            (false, _) => [0.0, 255.9, 239.5],
        };
        let bright = random.below(6);
        let gaps = *random.pick(&[[0, 0], [2, 1]]);
        let image = Image::new(format, [18, 11], 2, gaps, |_, _, y| {
            if has_gaps && random.below(10) == 0 {
                return f64::NAN;
            }
            random.between(if y % 3 == bright { limit + 0.55 } else { low }, high)
        });
        let mut draw = |i: usize| match document.positive[i] {
            true => random.between(0.2, 2.5),
            false => random.between(-2.0, 2.0),
        };
        let values: Vec<f64> = (0..PARAMETERS).map(&mut draw).take(model.parameters().len()).collect();
        let entry = match random.below(2) {
            0 => values.clone(),
            _ => values.iter().map(|p| p * random.between(0.9, 1.1)).collect(),
        };
        let height = 1 + random.below(7);
        let window =
            Window { x: random.below(5), y: random.below(4), width: 1 + random.below(13), height, slices: Slices::ONE };
        Scene {
            image,
            window,
            values,
            entry,
            // The document's own, and the share of defects where pixels at their limit are censored.
            constants: vec![random.between(0.1, 0.9), 1e-3],
            saturation: vec![limit, limit + 0.25],
            shift: [random.between(-0.4, 0.4), random.between(-0.4, 0.4)],
        }
    }

    fn bindings(&self) -> Bindings<'_> {
        Bindings {
            parameters: &self.values,
            entry: &self.entry,
            constants: &self.constants,
            saturation: &self.saturation,
            shift: &self.shift,
        }
    }

    fn options(&self, program: &Program, precision: Precision, width: VectorWidth) -> KernelOptions {
        let packed = self.image.strides[0] == self.image.format.bytes_per_pixel();
        KernelOptions { width, precision, formats: vec![self.image.format; program.channels()], packed }
    }

    fn interpreted(&self, program: &Program, precision: Precision, width: VectorWidth) -> Outcome {
        let order = self.options(program, precision, width).summation();
        let planes = Planes(self.image.views());
        interpreter::run(program, precision, order, &self.bindings(), &planes, self.window, None)
    }
}

/// The formulas' verdict on an outcome.
#[derive(Debug)]
enum Verdict {
    /// The error over the sum of the absolute terms.
    Right(f64),
    /// The formulas are not finite.
    Infinite,
    /// Rounding decides a comparison, or whether a pixel belongs.
    Undecided,
    Wrong(String),
}

fn judged(objective: &Objective, lowering: Lowering, scene: &Scene, found: &Outcome) -> Verdict {
    let planes = Planes(scene.image.views());
    let direct = |nudge| objective.direct(lowering, &scene.bindings(), &planes, scene.window, nudge);
    let said = direct(0.0);
    let error = |(found, [sum, terms]): (&f64, &[f64; 2])| {
        let error = if found == sum { 0.0 } else { (found - sum).abs() / terms };
        if error.is_nan() { f64::INFINITY } else { error }
    };
    let worst = said.sums.as_ref().map(|sums| found.outputs.iter().zip(sums).map(error).fold(0.0, f64::max));
    match worst {
        Some(worst) if worst <= TOLERANCE && found.pixels == said.pixels => return Verdict::Right(worst),
        // Sums over no pixel are never read.
        _ if found.pixels == 0 && said.pixels == 0 => return Verdict::Infinite,
        None if found.pixels == said.pixels => return Verdict::Infinite,
        _ => {}
    }
    // A decision changes the result by about as much as the error.
    let moved = NUDGES.map(direct);
    let is_decided = |i: usize, sums: &[[f64; 2]]| {
        let wrong = (found.outputs[i] - sums[i][0]).abs();
        let by =
            |moved: &DirectSums| moved.sums.as_ref().map_or(f64::INFINITY, |moved| (moved[i][0] - sums[i][0]).abs());
        wrong <= TOLERANCE * sums[i][1] || moved.iter().any(|moved| 3.0 * by(moved) >= wrong)
    };
    let is_decision = match (&said.sums, found.pixels == said.pixels) {
        (Some(sums), true) => (0..sums.len()).all(|i| is_decided(i, sums)),
        _ => moved.iter().any(|moved| moved.pixels != said.pixels),
    };
    match is_decision {
        true => Verdict::Undecided,
        false => Verdict::Wrong(format!("{worst:?} of the terms: {found:?} instead of {said:?}")),
    }
}

/// A program that sums, and its origin.
struct Summing {
    what: String,
    objective: Objective,
    lowering: Lowering,
    program: Program,
}

/// Every program that sums: values, derivatives in one loop and in separate loops, without blind pixels; in every lowering.
/// A refusal that indicates a bug is a fault.
fn summing(summand: &Summand, random: &mut Random, tally: &mut Tally) -> Vec<Summing> {
    let count = summand.model().parameters().len();
    let mut subset: Vec<ParameterId> = (0..count as u32).map(ParameterId).filter(|_| random.below(4) > 0).collect();
    if subset.is_empty() {
        subset.push(ParameterId(0));
    }
    let part = *random.pick(&[Part::Gradient, Part::Hessian]);
    let of_part = *random.pick(&[Method::Newton, Method::GaussNewton]);
    let gauss_newton = summand.objective(&subset, Method::GaussNewton);
    let seeing = gauss_newton.clone().map(|objective| objective.skipping_nan());
    let objectives = [
        ("value at entry".to_string(), summand.value_objective(ValueKind::Entry)),
        ("value".into(), summand.value_objective(ValueKind::Full)),
        (format!("Newton {subset:?}"), summand.objective(&subset, Method::Newton)),
        (format!("Gauss-Newton {subset:?}"), gauss_newton),
        (format!("{part:?} {of_part:?} {subset:?}"), summand.part_objective(&subset, of_part, part)),
        (format!("seeing {subset:?}"), seeing),
    ];
    let mut all = Vec::new();
    for (what, objective) in objectives {
        for lowering in lowerings() {
            let made = objective.clone().and_then(|objective| Ok((objective.program(lowering)?, objective)));
            let what = format!("{what} {lowering:?}");
            match made {
                Ok((program, objective)) => all.push(Summing { what, objective, lowering, program }),
                Err(refused) => tally.refused(&what, &refused),
            }
        }
    }
    all
}

/// Tries all programs of the document of a seed.
pub fn try_document(seed: u64, tally: &mut Tally) {
    let mut random = Random(seed);
    let document = Document::new(&mut random, Variety::Any);
    let text = document.text();
    let Ok(model) = Model::from_toml(&text) else {
        tally.refused += 1;
        return;
    };
    tally.documents += 1;
    let before = tally.faults.len();
    let mut summands = model.summands();
    let joint = Summand::joint(&summands);
    tally.joint += u64::from(joint.is_some());
    summands.extend(joint);
    for summand in summands {
        let scenes = [false, true].map(|has_gaps| Scene::new(&mut random, &document, summand.model(), has_gaps));
        try_sums(&summand, &scenes, &mut random, tally);
        try_planes(&summand, &scenes[0], &mut random, tally);
    }
    tally.faults[before..].iter_mut().for_each(|fault| *fault = format!("seed {seed}, {fault}\n{text}"));
}

fn try_sums(summand: &Summand, scenes: &[Scene; 2], random: &mut Random, tally: &mut Tally) {
    let all = summing(summand, random, tally);
    if let Some(Summing { objective, lowering, .. }) = all.first() {
        tally.empty_rows += empty_rows(objective, *lowering, &scenes[0]);
    }
    for Summing { what, objective, lowering, program } in all {
        tally.programs += 1;
        let scene = &scenes[usize::from(what.starts_with("seeing"))];
        let precision = *random.pick(&[Precision::F32, Precision::F64]);
        let width = *random.pick(&widths());
        let kernel = Kernel::compile(&program, &scene.options(&program, precision, width)).unwrap();
        let native = kernel.sums(&scene.bindings(), &scene.image.views(), scene.window).unwrap();
        let native = Outcome { outputs: native.outputs, pixels: native.pixels, saturated: native.saturated };
        let expected = scene.interpreted(&program, precision, width);
        tally.runs += 1;
        if !is_same(&native, &expected) {
            tally.faults.push(format!("{what} {precision:?} {width:?}: native {native:?}, interpreter {expected:?}"));
            continue;
        }
        let double =
            if precision == Precision::F64 { native } else { scene.interpreted(&program, Precision::F64, width) };
        match judged(&objective, lowering, scene, &double) {
            Verdict::Right(error) => {
                tally.compared += 1;
                tally.worst = tally.worst.max(error);
            }
            Verdict::Infinite => tally.infinite += 1,
            Verdict::Undecided => tally.undecided += 1,
            Verdict::Wrong(how) => tally.faults.push(format!("{what}: {how}")),
        }
    }
}

/// Rows of the window without used pixels.
fn empty_rows(objective: &Objective, lowering: Lowering, scene: &Scene) -> u64 {
    let planes = Planes(scene.image.views());
    let is_empty = |y: &usize| {
        let row = Window { y: *y, height: 1, ..scene.window };
        objective.direct(lowering, &scene.bindings(), &planes, row, 0.0).pixels == 0
    };
    (scene.window.y..scene.window.y + scene.window.height).filter(is_empty).count() as u64
}

fn is_same(a: &Outcome, b: &Outcome) -> bool {
    (a.pixels, a.saturated, a.outputs.len()) == (b.pixels, b.saturated, b.outputs.len())
        && a.outputs.iter().zip(&b.outputs).all(|(a, b)| same(*a, *b))
}

/// Gauss points per side of the corrections under test.
const CORRECTED: usize = 2;

/// Tries predictions and the rendered image.
fn try_planes(summand: &Summand, scene: &Scene, random: &mut Random, tally: &mut Tally) {
    for fma in lowerings().iter().filter(|lowering| !lowering.drop_saturated).map(|lowering| lowering.fma) {
        let lowering = Lowering { fma, drop_saturated: false };
        let mut programs = vec![(None, Some(summand.rendering(lowering)))];
        for prediction in
            [Prediction::Intensity, Prediction::Unbounded, Prediction::Variance, Prediction::Correction(CORRECTED)]
        {
            programs.push((Some(prediction), summand.prediction(prediction, lowering)));
        }
        for (prediction, program) in programs {
            let what = prediction.map_or("rendering".into(), |prediction| format!("{prediction:?}"));
            let program = match program {
                Some(Ok(program)) => program,
                Some(Err(refused)) => {
                    tally.refused(&format!("{what} {lowering:?}"), &refused);
                    continue;
                }
                None => continue,
            };
            // A curve has no picture without its predictor.
            if program.instructions().iter().any(|i| matches!(i.op.code, Opcode::Channel(_))) {
                continue;
            }
            tally.programs += 1;
            let precision = *random.pick(&[Precision::F32, Precision::F64]);
            let width = *random.pick(&widths());
            let mut filled = [Vec::new(), Vec::new()];
            for (plane, precision) in filled.iter_mut().zip([precision, Precision::F64]) {
                *plane = vec![0.0; scene.window.pixels()];
                let planes = Planes(scene.image.views());
                let lanes = width.lanes(precision);
                interpreter::run(&program, precision, lanes, &scene.bindings(), &planes, scene.window, Some(plane));
            }
            let options =
                KernelOptions { formats: Vec::new(), packed: true, ..scene.options(&program, precision, width) };
            let kernel = Kernel::compile(&program, &options).unwrap();
            let mut native = vec![0.0; scene.window.pixels()];
            kernel.render(&scene.bindings(), scene.window, &mut native).unwrap();
            tally.runs += 1;
            if !native.iter().zip(&filled[0]).all(|(a, b)| same(f64::from(*a), f64::from(*b))) {
                tally.faults.push(format!("{what} {lowering:?}: native {native:?}, interpreter {:?}", filled[0]));
            }
            judge_plane(summand, scene, prediction, &filled[1], &format!("{what} {lowering:?}"), tally);
        }
    }
}

/// Compares a plane with the formulas at single positions.
fn judge_plane(
    summand: &Summand,
    scene: &Scene,
    prediction: Option<Prediction>,
    plane: &[f32],
    what: &str,
    tally: &mut Tally,
) {
    let Window { x, y, width, height, .. } = scene.window;
    let said = |nudge: f64| -> Vec<f64> {
        let values: Vec<f64> = scene.values.iter().map(|value| value * (1.0 + nudge)).collect();
        let shift = if prediction.is_none() { scene.shift } else { [0.0; 2] };
        let axes = summand.model().coordinates().len();
        let place = |x: usize, y: usize| [x as f64 + shift[0] - nudge, y as f64 + shift[1] + nudge][..axes].to_vec();
        let places: Vec<Vec<f64>> = (y..y + height).flat_map(|y| (x..x + width).map(move |x| place(x, y))).collect();
        let samples = summand.samples(&places, &values, &scene.constants);
        let shown = |(place, sample): (&Vec<f64>, isophote_symbolic::Sample)| match prediction {
            None => summand.predicted(place, &values, &scene.constants),
            Some(Prediction::Intensity) if !sample.inside => f64::NAN,
            Some(Prediction::Intensity | Prediction::Unbounded) => sample.entries[0].0,
            Some(Prediction::Variance) => sample.entries[0].1.unwrap_or(1.0),
            Some(Prediction::Correction(_)) => {
                let node = 0.5 / 3.0_f64.sqrt();
                let corner = |number: usize| -> f64 {
                    let side = |axis: usize| if number >> axis & 1 == 0 { -node } else { node };
                    let place: Vec<f64> = place.iter().enumerate().map(|(axis, at)| at + side(axis)).collect();
                    summand.predicted(&place, &values, &scene.constants)
                };
                let mean = (0..1 << axes).map(corner).sum::<f64>() / f64::from(1 << axes);
                mean - summand.predicted(place, &values, &scene.constants)
            }
        };
        places.iter().zip(samples).map(shown).collect()
    };
    let (here, moved) = (said(0.0), NUDGES.map(said));
    // A difference of intensities is as accurate as the intensities.
    let rounded = match prediction {
        Some(Prediction::Correction(_)) => {
            let axes = summand.model().coordinates().len();
            let places =
                (y..y + height).flat_map(|y| (x..x + width).map(move |x| [x as f64, y as f64][..axes].to_vec()));
            let shown = places.map(|place| summand.predicted(&place, &scene.values, &scene.constants).abs());
            1e-12 * shown.filter(|value| value.is_finite()).fold(1.0, f64::max)
        }
        _ => 1e-30,
    };
    for (i, (found, value)) in plane.iter().zip(&here).enumerate() {
        let is_near = |others: &f64, by: f64| (f64::from(*found) - others).abs() <= by;
        let spread = moved.iter().map(|moved| (moved[i] - value).abs()).fold(0.0, f64::max);
        let is_sure = spread <= DECIDED * value.abs().max(DECIDED);
        if found.is_nan() != value.is_nan() || !is_near(value, 1e-6 * value.abs() + rounded) && !value.is_nan() {
            if is_sure && moved.iter().all(|moved| moved[i].is_nan() == value.is_nan()) && value.abs() < 1e30 {
                tally.faults.push(format!("{what}: {found} instead of {value} at pixel {i}, by nudges {spread:e}"));
                return;
            }
            tally.undecided += 1;
            return;
        }
    }
    let is_finite = here.iter().any(|value| value.is_finite());
    if is_finite { tally.compared += 1 } else { tally.infinite += 1 }
}

/// Counts wrong programs of a seed's document with visible effect in its scene: those that the formulas detect, and all.
pub fn try_faults(seed: u64) -> [u64; 2] {
    let mut random = Random(seed);
    let document = Document::new(&mut random, Variety::Any);
    let Ok(model) = Model::from_toml(&document.text()) else { return [0, 0] };
    let scene = Scene::new(&mut random, &document, &model, false);
    let mut counts = [0, 0];
    for Summing { objective, lowering, program, .. } in
        summing(&model.summands()[0], &mut random, &mut Tally::default())
    {
        let Some((_, wrong)) = planted(&program, &mut random) else { continue };
        let [right, wrong] =
            [&program, &wrong].map(|program| scene.interpreted(program, Precision::F64, VectorWidth::Bits128));
        let is_plain = matches!(judged(&objective, lowering, &scene, &right), Verdict::Right(_));
        let differs = |(a, b): (&f64, &f64)| (a - b).abs() > 1e-6 * a.abs() || a.is_nan() != b.is_nan();
        let shows = right.pixels != wrong.pixels || right.outputs.iter().zip(&wrong.outputs).any(differs);
        if is_plain && shows {
            counts[1] += 1;
            counts[0] += u64::from(!matches!(judged(&objective, lowering, &scene, &wrong), Verdict::Right(_)));
        }
    }
    counts
}
