//! The operation table: its text, and equal values in the interpreter and the referee.
#![allow(clippy::unwrap_used)]

use isophote_elementary::{DoubleDouble, Function1};

use crate::program::arithmetic::{Cell, Double, Number, Single};
use crate::program::op::{Kind, Op, Opcode, apply, spelled};
use crate::program::{Comparison, Value};

/// Edge cases.
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

/// Evaluates an opcode on `numbers`; `truths` makes its `Either` operands truth values.
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

/// Opcodes that read cells; the walk evaluates lookups.
fn operations() -> impl Iterator<Item = Opcode> {
    let is_leaf = |code: &Opcode| matches!(code, Opcode::Offset | Opcode::Gather(_));
    let reads = move |code: &Opcode| !code.row().operands.is_empty() && !is_leaf(code);
    Opcode::every().into_iter().filter(reads)
}

fn triples() -> impl Iterator<Item = [f64; 3]> {
    ODD.into_iter().flat_map(|a| ODD.into_iter().flat_map(move |b| ODD.into_iter().map(move |c| [a, b, c])))
}

/// False if both are NaN or equal; −0 and 0 differ where `signed`.
fn differs(a: f64, b: f64, signed: bool) -> bool {
    !(a.is_nan() && b.is_nan() || a == b && (!signed || a.to_bits() == b.to_bits()))
}

#[test]
fn interpreter_and_referee_agree_on_every_operation() {
    for code in operations() {
        // The referee's f64 rounds a · b + c twice.
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
            // For ordinary numbers f64 and f32 round the double-double value; infinities and the like are exempt.
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
fn distinct_operations_differ_in_value() {
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
            // In f64 `LogVariance` equals `Log`.
            let is_alike = [*a, *b] == [Function1::Log, Function1::LogVariance].map(Opcode::Call1);
            assert!(differ(*a, *b) != is_alike, "{a:?} and {b:?} say the same, or should");
        }
    }
}

#[test]
fn every_text_mentions_all_operands() {
    for code in operations() {
        let row = code.row();
        let mut met = Vec::new();
        let whole = spelled(row.text, |mark| {
            met.push(mark);
            String::new()
        });
        assert!(!whole.contains('$'));
        for i in 0..row.operands.len() {
            let mark = char::from(b'0' + i as u8);
            assert!(met.contains(&mark), "{code:?}: `{}` leaves out ${mark}", row.text);
        }
    }
}

#[test]
fn operations_compare_by_opcode_and_operands() {
    let [a, b] = [Value(3), Value(4)];
    assert_eq!(Opcode::Neg.of([a, b]), Opcode::Neg.of([a]), "one too many is not looked at");
    assert_ne!(Opcode::Add.of([a, b]), Opcode::Add.of([b, a]));
    assert_ne!(Opcode::number(0.0), Opcode::number(-0.0));
    assert_eq!(Opcode::number(f64::NAN), Opcode::number(f64::NAN));
    let moved: Op = Opcode::Compare(Comparison::Lt).of([a, b]).renamed(|v| Value(v.0 + 10));
    assert_eq!(moved.parts(), (Opcode::Compare(Comparison::Lt), &[Value(13), Value(14)][..]));
}
