//! Measures the worst error of every elementary function, in units in the last place: f32 over all arguments, f64 over
//! samples.
//!
//! `RUSTFLAGS="-C target-cpu=native" cargo run --release -p isophote-elementary --example elementary -- [stride]
//! [samples] [function …]`: a stride of 1 visits all 2³² f32. Without hardware FMA it takes hours.
#![allow(clippy::print_stdout)]

use isophote_elementary::ulps::{Arguments, allowed_for, error_double, error_single, exact1, exact2};
use isophote_elementary::{Accuracy, Function1, Function2, Plain, call1};

const MACHINES: [Plain; 2] = [Plain { fused: false }, Plain { fused: true }];
const THREADS: u64 = 2;

/// The worst error so far and its arguments, unfused and fused.
type Worst = [(f64, [f64; 2]); 2];

fn note(worst: &mut (f64, [f64; 2]), error: f64, at: [f64; 2]) {
    if error > worst.0 {
        *worst = (error, at);
    }
}

/// Divides the work among threads.
fn shared(work: impl Fn(u64) -> Worst + Sync) -> Worst {
    std::thread::scope(|scope| {
        let work = &work;
        let threads: Vec<_> = (0..THREADS).map(|thread| scope.spawn(move || work(thread))).collect();
        let mut all = Worst::default();
        for thread in threads {
            let Ok(worst) = thread.join() else { panic!("a thread has ended badly") };
            all.iter_mut().zip(worst).for_each(|(all, one)| note(all, one.0, one.1));
        }
        all
    })
}

/// Arguments per block.
const BLOCK: usize = 256;

/// Compares function `F` of f32 arguments with its own f64 form, whose error the samples of f64 show. All functions but exp,
/// log, acos and erfc use the sign of the argument only at the end: their negative arguments are visited 509 times as sparsely.
fn singles<const F: usize>(stride: u64) -> Worst {
    let function = Function1::ALL[F];
    let signed = matches!(function, Function1::Exp | Function1::Log | Function1::Acos | Function1::Erfc);
    let halves = [(0, stride), (1 << 31, if signed { stride } else { stride * 509 })];
    shared(|thread| {
        let mut worst = Worst::default();
        for (start, stride) in halves {
            let block_bits = stride * BLOCK as u64;
            let mut first = start + thread * block_bits;
            while first < start + (1 << 31) {
                block::<F>(first, stride, &mut worst);
                first += THREADS * block_bits;
            }
        }
        worst
    })
}

/// A block of arguments, from the bits `first` on, `stride` apart.
#[inline(never)]
fn block<const F: usize>(first: u64, stride: u64, worst: &mut Worst) {
    let x: [f64; BLOCK] = std::array::from_fn(|i| f64::from(f32::from_bits((first + i as u64 * stride) as u32)));
    let exact = x.map(|x| call1(&MACHINES[0], Function1::ALL[F], Accuracy::Double, x));
    let unfused = x.map(|x| call1(&MACHINES[0], Function1::ALL[F], Accuracy::Single, x) as f32);
    let fused = x.map(|x| call1(&MACHINES[1], Function1::ALL[F], Accuracy::Single, x) as f32);
    for (worst, values) in worst.iter_mut().zip([unfused, fused]) {
        // 2⁻²⁴ is less than one unit in the last place of any f32; skips values that are near enough.
        let near = worst.0 * 0.99 / f64::from(1 << 24);
        let far = |i: usize| {
            let (value, exact) = (f64::from(values[i]), exact[i]);
            let close = (value - exact).abs() <= near * exact.abs() && value.abs() > f64::from(f32::MIN_POSITIVE);
            !close
        };
        for i in (0..BLOCK).filter(|i| far(*i)) {
            let exact = [exact[i], 0.0];
            let error = allowed_for(Function1::ALL[F], x[i], exact, error_single(values[i], exact));
            note(worst, error, [x[i], 0.0]);
        }
    }
}

fn doubles(
    samples: u64,
    value: impl Fn(Plain, [f64; 2]) -> (f64, [f64; 2]) + Sync,
    allowed: impl Fn([f64; 2], [f64; 2], f64) -> f64 + Sync,
) -> Worst {
    shared(|thread| {
        let mut random = Arguments(thread);
        let mut worst = Worst::default();
        for _ in 0..samples / THREADS {
            let at = [random.argument(), random.argument()];
            let (unfused, exact) = value(MACHINES[0], at);
            note(&mut worst[0], allowed(at, exact, error_double(unfused, exact)), at);
            let (fused, _) = value(MACHINES[1], [at[0], at[1]]);
            note(&mut worst[1], allowed(at, exact, error_double(fused, exact)), at);
        }
        worst
    })
}

const ALL: [fn(u64) -> Worst; 16] = [
    singles::<0>,
    singles::<1>,
    singles::<2>,
    singles::<3>,
    singles::<4>,
    singles::<5>,
    singles::<6>,
    singles::<7>,
    singles::<8>,
    singles::<9>,
    singles::<10>,
    singles::<11>,
    singles::<12>,
    singles::<13>,
    singles::<14>,
    singles::<15>,
];

fn row(name: &str, single: Option<Worst>, double: Worst) {
    let text = |(error, at): (f64, [f64; 2])| format!("{error:.4} at {:e}, {:e}", at[0], at[1]);
    let [a, b] = single.unwrap_or_default().map(text);
    let [c, d] = double.map(text);
    println!("{name:6} f32 {a} | fused {b}\n       f64 {c} | fused {d}");
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |at: usize| arguments.get(at).and_then(|text| text.parse::<u64>().ok());
    let (stride, samples) = (number(0).unwrap_or(1).max(1), number(1).unwrap_or(10_000_000));
    let wanted = |name: &str| arguments.len() < 3 || arguments[2..].iter().any(|one| one == name);
    for function in Function1::ALL.into_iter().filter(|f| wanted(f.name())) {
        let double = doubles(
            samples,
            |machine, [x, _]| {
                let exact = if machine.fused { [0.0; 2] } else { exact1(function, x) };
                (function.value_with(machine, Accuracy::Double, x), exact)
            },
            |[x, _], exact, error| allowed_for(function, x, exact, error),
        );
        row(function.name(), Some(ALL[function as usize](stride)), double);
    }
    for function in Function2::ALL.into_iter().filter(|f| wanted(f.name())) {
        let double = doubles(
            samples,
            |machine, [a, b]| {
                let exact = if machine.fused { [0.0; 2] } else { exact2(function, a, b) };
                (function.value_with(machine, Accuracy::Double, a, b), exact)
            },
            |_, _, error| error,
        );
        row(function.name(), None, double);
    }
}
