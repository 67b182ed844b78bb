//! Native code and the interpreter agree bit for bit on random programs, over edge-case numbers; and the comparison
//! detects planted faults.
#![allow(clippy::unwrap_used)]

mod common;

use std::collections::HashSet;
use std::mem::discriminant;

use common::differential::{Case, Stage, agree, first_difference};
use common::fault::planted;
use common::generate::{Variety, program};
use common::{Random, widths};
use isophote_jit::{Kernel, KernelOptions, Processor, VectorWidth};
use isophote_symbolic::interpreter::Outcome;
use isophote_symbolic::{Level, Opcode, Precision, Program};

const PROGRAMS: u64 = 2000;
const WINDOWS: usize = 1000;
/// Windows per draw of all pixels.
const WINDOWS_OF_A_DRAW: usize = 25;
/// One in so many numbers is special, for each draw in turn; 0: none.
const ODDS: [usize; 4] = [0, 3, 10, 40];

struct Subject {
    program: Program,
    precision: Precision,
    width: VectorWidth,
    stage: Stage,
    random: Random,
}

impl Subject {
    fn new(processor: Processor, width: VectorWidth, seed: u64) -> Subject {
        let mut random = Random(seed);
        let longest = *random.pick(&[4, 10, 30, 60]);
        let lengths = [longest, longest / 2, longest].map(|most| 1 + random.below(most));
        let (fma, calls) = (processor.has_fma() && random.below(2) == 0, random.below(3) == 0);
        let tables = random.below(2) == 0;
        let variety = Variety { fma, calls, tables, lengths, sums: 9 };
        let renders = random.below(8) == 0;
        let program = program(&mut random, variety, renders);
        let precision = *random.pick(&[Precision::F32, Precision::F64]);
        let stage = Stage::new(&mut random, &program, width.lanes(precision));
        Subject { program, precision, width, stage, random }
    }

    /// Calls `see` with `count` windows, until it returns false.
    fn windows(&mut self, count: usize, mut see: impl FnMut(&Subject, &Case) -> bool) {
        for window in 0..count {
            let odds = ODDS[window / WINDOWS_OF_A_DRAW % ODDS.len()];
            if window % WINDOWS_OF_A_DRAW == 0 {
                self.stage.draw(&mut self.random, odds);
            }
            let case = Case::new(&mut self.random, &self.stage, odds);
            if !see(self, &case) {
                return;
            }
        }
    }

    fn options(&self) -> KernelOptions {
        self.stage.options(self.precision, self.width)
    }

    fn interpreted(&self, program: &Program, case: &Case) -> (Outcome, Vec<f32>) {
        case.interpreted(program, &self.options(), &self.stage)
    }

    fn kernel(&self, processor: Processor, seed: u64) -> Kernel {
        let kernel = Kernel::compile_for(processor, &self.program, &self.options());
        kernel.unwrap_or_else(|error| panic!("seed {seed}: {error}"))
    }
}

/// Panics if native code for `processor` and the interpreter differ.
fn programs_agree(processor: Processor, width: VectorWidth, seeds: std::ops::Range<u64>) {
    let programs = seeds.end - seeds.start;
    let (mut cases, mut telling) = (0, 0);
    for seed in seeds {
        let mut subject = Subject::new(processor, width, seed);
        let kernel = subject.kernel(processor, seed);
        subject.windows(WINDOWS, |subject, case| {
            let Subject { program, stage, .. } = subject;
            let (native, expected) = (case.native(&kernel, stage), subject.interpreted(program, case));
            assert!(
                agree(&native, &expected),
                "seed {seed}: {}\n{native:?}\n{expected:?}\n{case:?}\n{:?}\n{program:?}",
                first_difference(program, &subject.options(), stage, case),
                subject.options(),
            );
            cases += 1;
            let numbers = expected.0.outputs.iter().copied().chain(expected.1.iter().map(|x| f64::from(*x)));
            telling += u64::from(numbers.into_iter().any(|x| x.is_finite() && x != 0.0));
            true
        });
    }
    assert_eq!(cases, programs * WINDOWS as u64);
    assert!(telling * 10 > cases * 7, "only {telling} of {cases} cases have a result that says anything");
}

#[test]
#[ignore = "long proof"]
fn two_million_cases_agree() {
    programs_agree(Processor::Host, VectorWidth::Bits128, 0..PROGRAMS);
}

#[test]
fn wide_vectors_agree() {
    for width in widths().into_iter().filter(|width| *width != VectorWidth::Bits128) {
        programs_agree(Processor::Host, width, 0..PROGRAMS);
    }
}

#[test]
fn processors_without_extensions_agree() {
    programs_agree(Processor::Baseline, VectorWidth::Bits128, PROGRAMS..PROGRAMS + PROGRAMS / 4);
}

#[test]
fn planted_faults_are_detected() {
    let (mut matter, mut noticed, mut missed) = (0, 0, Vec::new());
    for seed in 10_000..10_800 {
        let all = widths();
        let width = all[seed as usize % all.len()];
        let mut subject = Subject::new(Processor::Host, width, seed);
        let kernel = subject.kernel(Processor::Host, seed);
        let mut try_one = |_| planted(&subject.program, &mut subject.random);
        let Some((what, wrong)) = (0..20).find_map(&mut try_one) else { continue };
        // A change without effect in four times as many windows does not matter: dead code, or an equivalent program.
        let (mut seen, mut first) = (0, None);
        subject.windows(4 * WINDOWS, |subject, case| {
            let expected = subject.interpreted(&wrong, case);
            seen += 1;
            if !agree(&case.native(&kernel, &subject.stage), &expected) {
                first = Some(seen);
            }
            first.is_none()
        });
        matter += u32::from(first.is_some());
        match first {
            Some(window) if window <= WINDOWS => noticed += 1,
            Some(window) => missed.push(format!("seed {seed}: {what} is noticed in window {window} only")),
            None => {}
        }
    }
    assert!(matter > 500, "only {matter} faults matter");
    assert!(noticed * 100 >= matter * 99, "{noticed} of {matter} faults are noticed\n{}", missed.join("\n"));
}

#[test]
fn the_generator_covers_every_operation_at_every_level() {
    let mut met = HashSet::new();
    for seed in 0..PROGRAMS {
        let Subject { program, .. } = Subject::new(Processor::Host, VectorWidth::Bits128, seed);
        met.extend(program.instructions().iter().map(|i| (discriminant(&i.op.code), i.level)));
    }
    let mut places = HashSet::new();
    for code in Opcode::every().into_iter().filter(|code| *code != Opcode::Fma || Processor::Host.has_fma()) {
        let levels = [Level::Pass, Level::Row, Level::Pixel, Level::RowEnd, Level::PassEnd];
        let only = code.row().level;
        places.extend(
            levels.into_iter().filter(|l| only.is_none_or(|only| only == *l)).map(|l| (discriminant(&code), l)),
        );
    }
    assert_eq!(met, places);
}
