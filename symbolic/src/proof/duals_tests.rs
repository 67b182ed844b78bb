//! Compares derivatives with dual numbers: random models at random points. The reference evaluates the formulas pixel
//! by pixel in hyper-dual numbers, by its own tree, and sums the absolute terms; a program may deviate by 1e-12 of
//! those. Where rounding exceeds that, both are evaluated again in double-double, and these must agree.

use std::cell::Cell;

#[path = "grammar_tests.rs"]
mod grammar;
#[path = "duals_numbers_tests.rs"]
mod numbers;
#[path = "duals_random_tests.rs"]
mod random;

use isophote_elementary::{DoubleDouble, Function1};

use grammar::{Document, PARAMETERS, Variety};
use numbers::{Hyper, Scalar, pair};
use random::{Place, Random};

use crate::program::interpreter::{Pixels, Slices, Window, run};
use crate::program::{Bindings, Instruction, Lanes, Level, LoopNest, Op, Opcode, ParameterId, Precision, Sink, Value};
use crate::proof::evaluate::{ByLevel, Raster, evaluate_at};
use crate::proof::weighed::Weighed;
use crate::{Lowering, Method, Model};

const MODELS: u64 = 10_000;
const POINTS: usize = 16;
/// Error over the sum of the absolute terms.
const TOLERANCE: f64 = 1e-12;
/// Terms below this have lost digits to the smallest numbers of f64.
const SMALLEST: f64 = 1e-290;

/// A random model and a request for it.
struct Case {
    document: Document,
    /// The free parameters.
    subset: Vec<usize>,
    method: Method,
    variety: Variety,
    /// See [`Place::ordinary`].
    ordinary: f64,
    /// Smaller terms are not compared.
    smallest: f64,
}

impl Case {
    fn new(random: &mut Random, variety: Variety) -> Case {
        let document = Document::new(random, variety);
        // For wide pictures the square of an exponential's square must stay in the range of f64.
        let (ordinary, smallest) =
            if variety == Variety::Wide { (1e75, ROUNDED * f64::EPSILON / TOLERANCE) } else { (1e30, SMALLEST) };
        let parameters = document.scope.parameters;
        let mut subset: Vec<usize> = (0..parameters).filter(|_| !random.one_in(4)).collect();
        if subset.is_empty() {
            subset.push(0);
        }
        let method = random.pick(&[Method::Newton, Method::Newton, Method::GaussNewton, Method::LevenbergMarquardt]);
        Case { document, subset, method, variety, ordinary, smallest }
    }

    /// The free parameters as variables, the others as numbers; with `held` all as numbers, at entry.
    fn place<'a, N: Scalar>(&'a self, at: &Point, held: bool, undecided: &'a Cell<bool>) -> Place<'a, N> {
        let values = if held { &at.entry } else { &at.parameters };
        let parameter = |i: usize| match self.subset.iter().position(|&p| p == i && !held) {
            Some(free) => Hyper::variable(values[i], free),
            None => Hyper::fixed(values[i].into()),
        };
        Place {
            coordinates: [0.0; 2],
            predictor: 0.0,
            constant: at.constant,
            parameters: std::array::from_fn(parameter),
            definitions: &self.document.definitions,
            functions: &self.document.functions,
            intensity: &self.document.intensities[0],
            argument: None,
            index: 0.0,
            ordinary: self.ordinary,
            undecided,
        }
    }

    /// F, gradient and upper Hessian in the order of a program's outputs. `None`: see [`Place::undecided`].
    fn reference<N: Scalar>(&self, at: &Point) -> Option<Vec<N>> {
        let undecided = Cell::new(false);
        let (mut here, mut entry) = (self.place::<N>(at, false, &undecided), self.place::<N>(at, true, &undecided));
        let n = self.subset.len();
        let zero = N::from(0.0);
        let mut outputs = vec![zero; 1 + n + n * (n + 1) / 2];
        let mut add = |k: usize, term: N| outputs[k] = outputs[k] + term;
        let Window { x, y, width, height, .. } = at.window;
        for (x, y) in (y..y + height).flat_map(|y| (x..x + width).map(move |x| (x, y))) {
            for place in [&mut here, &mut entry] {
                place.coordinates = [x as f64, y as f64];
                place.predictor = Noise.at(1, x, y);
            }
            if self.document.domain.as_ref().is_some_and(|domain| !entry.inside(domain)) {
                continue;
            }
            let residual = Hyper::fixed(Noise.at(0, x, y).into()).sub(&here.value(&self.document.intensities[0]));
            let full = self.method == Method::Newton;
            let variance =
                self.document.noise.as_ref().map(|noise| if full { here.value(noise) } else { entry.value(noise) });
            let square = residual.mul(&residual);
            let chi = variance.map_or(square, |v| square.mul(&v.inverse()));
            let term = match variance.filter(|_| full) {
                Some(v) => chi.add(&v.call1(Function1::Log)),
                None => chi,
            };
            let weight = variance.map_or(N::from(2.0), |v| N::from(2.0) / v.value);
            add(0, term.value);
            let mut k = 1 + n;
            for i in 0..n {
                add(1 + i, term.gradient[i]);
                for j in i..n {
                    let curved = term.hessian[pair(i, j)];
                    add(k, if full { curved } else { weight * (residual.gradient[i] * residual.gradient[j]) });
                    k += 1;
                }
            }
        }
        (!undecided.get()).then_some(outputs)
    }
}

struct Point {
    parameters: Vec<f64>,
    entry: Vec<f64>,
    constant: f64,
    window: Window,
}

impl Point {
    fn new(random: &mut Random, case: &Case) -> Point {
        let mut draw = |i: usize| match case.document.positive[i] {
            true => random.between(0.2, 2.5),
            false => random.between(-2.0, 2.0),
        };
        let parameters: Vec<f64> = (0..PARAMETERS).map(&mut draw).collect();
        let entry = match random.one_in(2) {
            true => parameters.clone(),
            false => parameters.iter().map(|p| p * random.between(0.9, 1.1)).collect(),
        };
        let height = if case.document.scope.coordinates == 1 { 1 } else { 2 };
        let y = if case.document.scope.coordinates == 1 { 0 } else { random.below(4) };
        let is_wide = case.variety == Variety::Wide;
        let x = if is_wide { random.below(4094) >> random.below(8) } else { random.below(5) };
        let y = if is_wide && height > 1 { random.below(4094) >> random.below(8) } else { y };
        let window = Window { x, y, width: 2 + random.below(2), height, slices: Slices::ONE };
        Point { parameters, entry, constant: random.between(0.1, 0.9), window }
    }

    fn bindings<'a>(&'a self, constants: &'a [f64]) -> Bindings<'a> {
        let saturation = &[f64::INFINITY; 2];
        Bindings { parameters: &self.parameters, entry: &self.entry, constants, saturation, shift: &[] }
    }
}

/// Pixels between −1 and 4.
struct Noise;
impl Pixels for Noise {
    fn at(&self, channel: usize, x: usize, y: usize) -> f64 {
        Random((channel * 10_007 + x * 101 + y) as u64).between(-1.0, 4.0)
    }
}

/// The outputs of a sums program over the pixels of a window; empty for a plane program.
fn evaluate<N: Scalar>(program: &LoopNest, bindings: &Bindings<'_>, pixels: &dyn Pixels, window: Window) -> Vec<N> {
    let sample = Raster {
        inputs: program.gather(bindings).map(N::from).collect(),
        columns: (window.x..window.x + window.width).map(|x| N::from(x as f64)).collect(),
        rows: (window.y..window.y + window.height).map(|y| vec![N::from(y as f64)]).collect(),
        pixel: &|channel, column, row| pixels.at(channel, window.x + column, window.y + row).into(),
        every_pixel: false,
    };
    evaluate_at(&ByLevel::of(program), &sample).outputs
}

/// Counts of the points by outcome.
#[derive(Default, Debug)]
struct Tally {
    models: u64,
    refused: u64,
    points: u64,
    /// Not finite, outside of a function's domain, or without pixels.
    skipped: u64,
    /// Rounding may decide a comparison, or a part of the formula leaves the ordinary range.
    undecided: u64,
    /// Accepted by the referee: rounding, not derivation.
    rounded: u64,
    worst: f64,
}

/// The first output that is wrong at a point; always calls the referee when `strict`.
fn compare(case: &Case, program: &LoopNest, at: &Point, tally: &mut Tally, strict: bool) -> Result<(), String> {
    tally.points += 1;
    let Some(expected) = case.reference::<Weighed>(at) else {
        tally.undecided += 1;
        return Ok(());
    };
    let is_usable = |x: &Weighed| x.value.abs() < 1e60 && x.terms < 1e60;
    if !expected.iter().all(is_usable) || expected.iter().all(|x| x.terms == 0.0) {
        tally.skipped += 1;
        return Ok(());
    }
    let constants = [at.constant];
    let bindings = at.bindings(&constants);
    let found = run(program, Precision::F64, Lanes::Two, &bindings, &Noise, at.window, None).outputs;
    assert_eq!(found.len(), expected.len());
    let error = |found: f64, expected: f64, terms: f64| {
        if found == expected { 0.0 } else { (found - expected).abs() / terms.max(case.smallest) }
    };
    let error_of = |i: usize| error(found[i], expected[i].value, expected[i].terms);
    let worst = (0..found.len()).map(error_of).fold(0.0, |a: f64, b| if a >= b { a } else { b });
    if worst <= TOLERANCE {
        tally.worst = tally.worst.max(worst);
        if !strict {
            return Ok(());
        }
    }
    let exact: Vec<DoubleDouble> = evaluate(program, &bindings, &Noise, at.window);
    let Some(reference) = case.reference::<DoubleDouble>(at) else { return Ok(()) };
    for (i, ((exact, reference), weighed)) in exact.iter().zip(&reference).zip(&expected).enumerate() {
        let referee = (*exact - *reference).abs().to_f64() / weighed.terms.max(case.smallest);
        let is_right = *exact == *reference || referee <= TOLERANCE;
        if !is_right {
            return Err(format!(
                "{}: {:e} instead of {:e} (double-double {:e} instead of {:e}), terms {:e}, at {:?}, entry {:?}, k {}",
                program.names().outputs[i],
                found[i],
                weighed.value,
                exact.to_f64(),
                reference.to_f64(),
                weighed.terms,
                at.parameters,
                at.entry,
                at.constant,
            ));
        }
    }
    tally.rounded += u64::from(worst > TOLERANCE);
    Ok(())
}

/// A program for a case; `None` for a refused document (its formulas may have lost all parameters).
fn lowered(case: &Case, random: &mut Random) -> Option<LoopNest> {
    let model = Model::from_toml(&case.document.text()).ok()?;
    let subset: Vec<ParameterId> = case.subset.iter().map(|&i| ParameterId(i as u32)).collect();
    let lowering = Lowering { fma: random.one_in(2), drop_saturated: random.one_in(4) };
    model.objective(&subset, case.method).ok()?.program(lowering).ok().map(|program| LoopNest::clone(&program))
}

/// Compares the program of a seed at its points, after `spoil`; the first fault.
fn check(seed: u64, tally: &mut Tally, spoil: impl FnOnce(&mut LoopNest, &mut Random)) -> Result<(), String> {
    let mut random = Random(seed);
    let case = Case::new(&mut random, Variety::Plain);
    let Some(mut program) = lowered(&case, &mut random) else {
        tally.refused += 1;
        return Ok(());
    };
    tally.models += 1;
    spoil(&mut program, &mut random);
    for i in 0..POINTS {
        let at = Point::new(&mut random, &case);
        let strict = i == 0 && seed % 10 < 2;
        compare(&case, &program, &at, tally, strict).map_err(|fault| {
            format!("seed {seed}, {:?}, parameters {:?}\n{}{fault}", case.method, case.subset, case.document.text())
        })?;
    }
    Ok(())
}

/// Checks every other seed; two tests share the work between cores.
fn check_seeds(first: u64) {
    let mut tally = Tally::default();
    let mut faults = Vec::new();
    for seed in (first..2 * MODELS).step_by(2) {
        if tally.models == MODELS / 2 {
            break;
        }
        faults.extend(check(seed, &mut tally, |_, _| ()).err());
    }
    assert!(faults.is_empty(), "{} faults; {tally:?}\n{}", faults.len(), faults[..faults.len().min(8)].join("\n\n"));
    let compared = tally.points - tally.skipped - tally.undecided;
    assert!(tally.models == MODELS / 2 && compared * 10 > tally.points * 6, "{tally:?}");
    assert!(tally.rounded * 1000 < compared, "{tally:?}");
}

#[test]
fn derivatives_agree_with_dual_numbers_at_even_seeds() {
    check_seeds(0);
}

#[test]
fn derivatives_agree_with_dual_numbers_at_odd_seeds() {
    check_seeds(1);
}

/// Number of documents whose exponentials leave the range of numbers in a wide picture, where their sums do not.
const WIDE: u64 = 150;
/// Far from a target a sum may be the difference of two that are about 1, each of some pixels: a multiple of its
/// rounding.
const ROUNDED: f64 = 10.0;
/// Error in f32 over the sum of the absolute terms.
const SINGLE: f64 = 1e-2;

#[test]
fn exponentials_of_unbounded_arguments_stay_in_range_on_wide_pictures() {
    let mut tally = Tally::default();
    let (mut faults, mut single) = (Vec::new(), 0);
    for seed in 0..WIDE {
        let mut random = Random(seed);
        let mut case = Case::new(&mut random, Variety::Wide);
        let text = case.document.text();
        let Ok(model) = Model::from_toml(&text) else { continue };
        let subset: Vec<ParameterId> = case.subset.iter().map(|&i| ParameterId(i as u32)).collect();
        let lowering = Lowering { fma: random.one_in(2), drop_saturated: random.one_in(4) };
        let program = match model.objective(&subset, case.method).and_then(|objective| objective.program(lowering)) {
            Ok(program) => program,
            Err(refused) => {
                tally.refused += 1;
                faults
                    .extend((refused[0].code == "bug").then(|| format!("seed {seed}: {}\n{text}", refused[0].message)));
                continue;
            }
        };
        tally.models += 1;
        for _ in 0..POINTS {
            let at = Point::new(&mut random, &case);
            let fault = compare(&case, &program, &at, &mut tally, false).err();
            // Where f32 holds every part of the formulas, it holds their sums.
            case.ordinary = 1e37;
            let fault = fault.or_else(|| wrong_in_single(&case, &program, &at, &mut single));
            case.ordinary = 1e75;
            faults.extend(
                fault.map(|fault| format!("seed {seed}, {:?}, at {:?}\n{text}{fault}", case.method, at.window)),
            );
        }
    }
    assert!(faults.is_empty(), "{} faults; {tally:?}\n{}", faults.len(), faults[..faults.len().min(6)].join("\n\n"));
    assert!(tally.models * 10 > WIDE * 9 && single * 3 > tally.points, "{single}, {tally:?}");
}

fn wrong_in_single(case: &Case, program: &LoopNest, at: &Point, seen: &mut u64) -> Option<String> {
    let expected = case.reference::<Weighed>(at)?;
    // Squares of the summands must stay in range as well.
    if !expected.iter().all(|x| x.terms < 1e18) {
        return None;
    }
    *seen += 1;
    let constants = [at.constant];
    let found = run(program, Precision::F32, Lanes::Four, &at.bindings(&constants), &Noise, at.window, None).outputs;
    let is_wrong = |(found, expected): (&f64, &Weighed)| {
        let error = (found - expected.value).abs();
        error.is_nan() || error > SINGLE * expected.terms.max(ROUNDED * f64::from(f32::EPSILON) / SINGLE)
    };
    let wrong = found.iter().zip(&expected).position(is_wrong)?;
    let (name, found, expected) = (&program.names().outputs[wrong], found[wrong], expected[wrong]);
    Some(format!(
        "{name} in f32: {found:e} instead of {:e}, terms {:e}, at {:?}",
        expected.value, expected.terms, at.parameters
    ))
}

/// Flips one + or − somewhere in the program. Not every one matters (a + 0, a branch never taken).
#[test]
fn a_planted_sign_error_is_caught() {
    let flip = |program: &mut LoopNest, random: &mut Random| {
        let sums = program.instructions.iter_mut().filter(|i| matches!(i.op.code, Opcode::Add | Opcode::Sub));
        let mut sums: Vec<&mut Op> = sums.map(|i| &mut i.op).collect();
        let Some(count) = sums.len().checked_sub(1) else { return };
        let op = &mut sums[random.below(count + 1)];
        **op = match op.parts() {
            (Opcode::Add, &[a, b]) => Opcode::Sub.of([a, b]),
            (Opcode::Sub, &[a, b]) => Opcode::Add.of([a, b]),
            _ => **op,
        };
    };
    let caught = (0..300).filter(|&seed| check(seed, &mut Tally::default(), flip).is_err()).count();
    assert!(caught >= 180, "{caught}");
}

/// Flips one output's sign: caught wherever the output is not zero and was compared.
#[test]
fn a_negated_output_is_caught() {
    let (mut caught, mut missed) = (0, 0);
    for seed in 0..300 {
        let mut is_constant = true;
        let negate = |program: &mut LoopNest, random: &mut Random| {
            let Sink::Sums { outputs, .. } = &mut program.sink else { unreachable!() };
            let output = random.below(outputs.len());
            is_constant = program.instructions[outputs[output].index()].op.constant().is_some();
            let op = Opcode::Neg.of([outputs[output]]);
            outputs[output] = Value(program.instructions.len() as u32);
            program.instructions.push(Instruction { op, level: Level::PassEnd, span: None });
        };
        let mut tally = Tally::default();
        let is_caught = check(seed, &mut tally, negate).is_err();
        caught += u64::from(is_caught);
        missed += u64::from(!is_caught && !is_constant && tally.skipped + tally.undecided < tally.points);
    }
    // The missed ones are zero wherever they were compared.
    assert!(caught >= 140 && missed <= 10, "{caught} caught, {missed} missed");
}
