//! A row without used pixels adds nothing: its row values and row end, which may be NaN, are not evaluated. Machine code
//! and interpreter agree.
#![allow(clippy::unwrap_used)]

mod common;

use common::{Image, agree, document, lowerings, programs};
use isophote_jit::{PixelFormat, Window};
use isophote_symbolic::{Bindings, Precision};

/// A disc whose formulas contain √(r² − (y − by)²), per row, which is NaN above and below it.
fn disc(domain: &str) -> String {
    format!(
        r#"
        name = "disc"
        coordinates = ["x", "y"]
        channels = ["phi"]
        [parameters]
        bx = {{ start = 14.3 }}
        by = {{ start = 11.2 }}
        v0 = {{ start = 20.0 }}
        v1 = {{ start = 9.0 }}
        [constants]
        r = 8.0
        [definitions]
        square = "(x - bx)^2 + (y - by)^2"
        g = "sqrt(r^2 - (y - by)^2)"
        [model]
        intensity = "v0 + v1 * g * exp(-((x - bx) / 5)^2)"
        {domain}
        "#
    )
}

const VALUES: [f64; 4] = [14.3, 11.2, 20.0, 9.0];

/// Checks that every program of the document, in both precisions, has finite sums over some of the pixels.
fn is_finite(domain: &str, pixel: impl Fn(usize, usize) -> f64) {
    let model = document(&disc(domain));
    let image = Image::new(PixelFormat::U8, [31, 23], 1, [0, 0], |_, x, y| pixel(x, y));
    for lowering in lowerings() {
        for (name, program) in programs(&model, lowering) {
            for precision in [Precision::F32, Precision::F64] {
                let bindings = Bindings {
                    parameters: &VALUES,
                    entry: &VALUES,
                    constants: &[8.0],
                    saturation: &[if lowering.drop_saturated { 250.0 } else { f64::INFINITY }],
                    shift: &[],
                };
                let outcome = agree(&program, precision, &bindings, &image, Window::whole(31, 23), &name);
                assert!((1..31 * 23).contains(&outcome.pixels), "{name}: {} pixels", outcome.pixels);
                assert!(outcome.outputs.iter().all(|x| x.is_finite()), "{name}, {domain}: {:?}", outcome.outputs);
            }
        }
    }
}

#[test]
fn rows_outside_of_a_mask_add_nothing() {
    for domain in ["square < r^2", "square <= r^2 and x != bx", "square <= r^2 or (x - bx)^2 + (y - by)^2 <= 9"] {
        is_finite(&format!("domain = \"{domain}\""), |x, y| (20 + x + y) as f64);
    }
}

#[test]
fn rows_outside_of_bounds_add_nothing() {
    is_finite("domain = \"square <= r^2\"", |x, y| (20 + x + y) as f64);
}

#[test]
fn rows_of_saturated_pixels_add_nothing() {
    let model = document(&disc(""));
    let inside = |y: usize| (4..19).contains(&y);
    let image = Image::new(PixelFormat::U8, [31, 23], 1, [0, 0], |_, _, y| if inside(y) { 100.0 } else { 255.0 });
    for lowering in lowerings().into_iter().filter(|lowering| lowering.drop_saturated) {
        for (name, program) in programs(&model, lowering).into_iter().skip(2) {
            let bindings =
                Bindings { parameters: &VALUES, entry: &VALUES, constants: &[8.0], saturation: &[250.0], shift: &[] };
            let outcome = agree(&program, Precision::F32, &bindings, &image, Window::whole(31, 23), &name);
            assert_eq!((outcome.pixels, outcome.saturated), (31 * 15, 31 * 8), "{name}");
            assert!(outcome.outputs.iter().all(|x| x.is_finite()), "{name}: {:?}", outcome.outputs);
        }
    }
}
