//! Exported source matches the interpreter: shipped models are exported as C and Rust, compiled by `cc` and `rustc`
//! into one program per language, and the sums compared bit for bit.
#![allow(missing_docs, clippy::unwrap_used)]

mod cases;
mod command;
mod program;

use cases::{Case, Outcome};
use isophote_export::Language;

fn compare(language: Language, cases: &[Case]) {
    let answers = program::run(language, cases);
    assert_eq!(answers.len(), cases.len());
    let mut pixels = 0;
    for (case, answer) in cases.iter().zip(&answers) {
        let expected = case.interpreted();
        pixels += expected.counts[0];
        if let Err(fault) = agree(case, &expected, answer) {
            panic!("{language:?}, {}: {fault}\n{expected:?}\n{answer:?}", case.title());
        }
    }
    assert!(pixels > 0, "no pixel took part");
}

/// Bit for bit; with elementary functions, which are the platform's, to a relative tolerance.
fn agree(case: &Case, expected: &Outcome, answer: &Outcome) -> Result<(), String> {
    if expected.counts != answer.counts {
        return Err("other pixels took part".into());
    }
    if expected.numbers.len() != answer.numbers.len() {
        return Err(format!("{} numbers instead of {}", answer.numbers.len(), expected.numbers.len()));
    }
    for (i, (a, b)) in expected.numbers.iter().zip(&answer.numbers).enumerate() {
        let same = match case.calls() {
            false => a.to_bits() == b.to_bits(),
            true => (a - b).abs() <= 1e-5 * a.abs(),
        };
        if !same {
            return Err(format!("number {i} is {b:e} instead of {a:e}"));
        }
    }
    Ok(())
}

#[test]
fn c_computes_what_the_interpreter_computes() {
    compare(Language::C, &cases::one_lane());
}

#[test]
fn rust_computes_what_the_interpreter_computes() {
    let mut cases = cases::one_lane();
    if std::is_x86_feature_detected!("avx2") && std::is_x86_feature_detected!("fma") {
        cases.extend(cases::several_lanes());
    }
    compare(Language::Rust, &cases);
}

#[test]
fn planted_sign_errors_are_detected() {
    let mut case = cases::one_lane().swap_remove(0);
    assert!(case.text(Language::C).contains("sum1 += "));
    case.planted = Some(("sum1 += ", "sum1 -= "));
    let answers = program::run(Language::C, std::slice::from_ref(&case));
    assert!(agree(&case, &case.interpreted(), &answers[0]).is_err());
    let mut last_bit = case.interpreted();
    last_bit.numbers[0] = last_bit.numbers[0].next_up();
    assert!(agree(&case, &case.interpreted(), &last_bit).is_err());
}
