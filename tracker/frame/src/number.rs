//! Numbers in messages, and how large those of documents may be.

/// Larger numbers of documents mean nothing: what is computed of them, their squares above all, is no number any more.
pub const NUMBER_MAX: f64 = 1e30;
/// Electrons, pixel values: no sensor has as many.
pub const LIGHT_MAX: f64 = 1e12;

/// As people write it: 1e300 has one digit, not 301.
pub fn plain(number: f64) -> String {
    let is_usual = (1e-5..1e16).contains(&number.abs()) || number == 0.0 || !number.is_finite();
    if is_usual { number.to_string() } else { format!("{number:e}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_numbers_are_short() {
        let shown = [0.0, -1.0, 0.25, 1e300, -2.5e-9, 1e12, f64::NAN].map(plain);
        assert_eq!(shown, ["0", "-1", "0.25", "1e300", "-2.5e-9", "1000000000000", "NaN"]);
    }
}
