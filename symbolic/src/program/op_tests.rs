//! The table, row by row: every operation is written in every language, and interpreter and referee agree on what it computes.
#![allow(clippy::unwrap_used)]

use isophote_elementary::{DoubleDouble, Function1};

use crate::program::arithmetic::{Cell, Double, Number, Single};
use crate::program::op::{Kind, Op, Opcode, apply, spelled};
use crate::program::{Comparison, Value};

/// Numbers that break careless code.
const ODD: [f64; 15] = [
    f64::NAN,
    f64::INFINITY,
    f64::NEG_INFINITY,
    0.0,
    -0.0,
    5e-324,
    -1e-310,
    1e300,
    -1e200,
    0.3,
    -0.75,
    1.0,
    -2.0,
    7.5,
    255.0,
];

/// The operation on its operands; of what it reads, numbers and truth values by turns.
fn value<N: Number>(code: Opcode, numbers: [f64; 3], truths: bool) -> Cell<N> {
    let row = code.row();
    let cell = |i: usize| match row.operands.get(i) {
        Some(Kind::Truth) => Cell::Truth(numbers[i] > 0.0),
        Some(Kind::Either) if truths => Cell::Truth(numbers[i] > 0.0),
        _ => Cell::Number(N::from(numbers.get(i).copied().unwrap_or(0.0))),
    };
    let cells = [cell(0), cell(1), cell(2)];
    let op = match row.operands.len() {
        1 => code.of([Value(0)]),
        2 => code.of([Value(0), Value(1)]),
        _ => code.of([Value(0), Value(1), Value(2)]),
    };
    apply(op, &cells, &|_| N::from(0.0))
}

/// What reads cells; what is looked up is the walk's.
fn operations() -> impl Iterator<Item = Opcode> {
    let is_leaf = |code: &Opcode| matches!(code, Opcode::Offset | Opcode::Gather(_));
    let reads = move |code: &Opcode| !code.row().operands.is_empty() && !is_leaf(code);
    Opcode::every().into_iter().filter(reads)
}

fn triples() -> impl Iterator<Item = [f64; 3]> {
    ODD.into_iter().flat_map(|a| ODD.into_iter().flat_map(move |b| ODD.into_iter().map(move |c| [a, b, c])))
}

/// Nothing where both are a NaN, or the same; −0 and 0 differ where `signed`.
fn differs(a: f64, b: f64, signed: bool) -> bool {
    !(a.is_nan() && b.is_nan() || a == b && (!signed || a.to_bits() == b.to_bits()))
}

#[test]
fn the_interpreter_and_the_referee_agree_on_every_operation() {
    for code in operations() {
        // In f64 a · b + c is rounded twice by the referee.
        let is_rounded_alike = code != Opcode::Fma;
        for (numbers, truths) in triples().flat_map(|numbers| [(numbers, false), (numbers, true)]) {
            let context = || format!("{code:?} of {numbers:?}");
            let native = value::<Double<false>>(code, numbers, truths).map(f64::from);
            match (native, value::<f64>(code, numbers, truths)) {
                (Cell::Number(a), Cell::Number(b)) => {
                    assert!(!is_rounded_alike || !differs(a, b, true), "{}: {a:?}, {b:?}", context());
                }
                (Cell::Truth(a), Cell::Truth(b)) => assert_eq!(a, b, "{}", context()),
                _ => panic!("{}: a number and a truth value", context()),
            }
            // What double-double says of ordinary numbers is what f64 and f32 round; infinities and the like it has no part in.
            let ordinary = numbers.iter().all(|x| x.is_finite() && (x.abs() < 1e3 && x.abs() > 1e-3 || *x == 0.0));
            let Cell::Number(exact) = value::<DoubleDouble>(code, numbers, truths) else { continue };
            let (Cell::Number(near), Cell::Number(far)) = (native, value::<Single<false>>(code, numbers, truths))
            else {
                panic!("{}: a number in one arithmetic only", context())
            };
            let exact = exact.to_f64();
            if ordinary && exact.is_finite() && exact.abs() < 1e30 && near.is_finite() {
                assert!((near - exact).abs() <= 1e-14 * exact.abs() + 1e-300, "{}: {near}, {exact}", context());
                let rounded = numbers.iter().all(|x| f64::from(*x as f32) == *x);
                let far = f64::from(far);
                let error = (far - exact).abs();
                assert!(!rounded || error <= 1e-6 * exact.abs() + 1e-30, "{}: {far}, {exact}", context());
            }
        }
    }
}

#[test]
fn a_wrong_meaning_would_be_seen() {
    let differ = |a: Opcode, b: Opcode| {
        triples().any(|numbers| {
            match (value::<Double<false>>(a, numbers, false).map(f64::from), value::<f64>(b, numbers, false)) {
                (Cell::Number(a), Cell::Number(b)) => differs(a, b, true),
                (Cell::Truth(a), Cell::Truth(b)) => a != b,
                _ => true,
            }
        })
    };
    let all: Vec<Opcode> = operations().collect();
    for (i, a) in all.iter().enumerate() {
        for b in all[i + 1..].iter().filter(|b| b.row().operands == a.row().operands) {
            // In f64 a variance's logarithm is the logarithm.
            let is_alike = [*a, *b] == [Function1::Log, Function1::LogVariance].map(Opcode::Call1);
            assert!(differ(*a, *b) != is_alike, "{a:?} and {b:?} say the same, or should");
        }
    }
}

#[test]
fn every_operation_is_written_with_all_of_its_operands() {
    for code in operations() {
        let row = code.row();
        let written = [row.text, row.c, row.rust].map(|text| {
            let mut met = Vec::new();
            let whole = spelled(text, |mark| {
                met.push(mark);
                String::new()
            });
            assert!(!whole.contains('$'));
            met
        });
        // An elementary function is spelled by the language's library.
        let texts = [row.text, row.c, row.rust].into_iter().zip(written);
        for (text, met) in texts.filter(|(text, _)| !(code.of([]).is_call() && text.is_empty())) {
            for i in 0..row.operands.len() {
                let mark = char::from(b'0' + i as u8);
                assert!(met.contains(&mark) || i == 0 && met.contains(&'s'), "{code:?}: `{text}` leaves out ${mark}");
            }
        }
    }
}

#[test]
fn an_operation_is_its_opcode_and_the_operands_that_it_has() {
    let [a, b] = [Value(3), Value(4)];
    assert_eq!(Opcode::Neg.of([a, b]), Opcode::Neg.of([a]), "one too many is not looked at");
    assert_ne!(Opcode::Add.of([a, b]), Opcode::Add.of([b, a]));
    assert_ne!(Opcode::number(0.0), Opcode::number(-0.0));
    assert_eq!(Opcode::number(f64::NAN), Opcode::number(f64::NAN));
    let moved: Op = Opcode::Compare(Comparison::Lt).of([a, b]).renamed(|v| Value(v.0 + 10));
    assert_eq!(moved.parts(), (Opcode::Compare(Comparison::Lt), &[Value(13), Value(14)][..]));
}
