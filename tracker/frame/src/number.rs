//! Number formatting for messages, and limits of numbers in documents.

/// Largest number in a document: the squares of larger ones overflow.
pub const NUMBER_MAX: f64 = 1e30;
/// Largest number of electrons or pixel value: beyond any sensor.
pub const LIGHT_MAX: f64 = 1e12;

/// Formats extreme numbers in scientific notation: 1e300 has one digit, not 301.
pub fn plain(number: f64) -> String {
    let is_usual = (1e-5..1e16).contains(&number.abs()) || number == 0.0 || !number.is_finite();
    if is_usual { number.to_string() } else { format!("{number:e}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn extreme_numbers_use_scientific_notation() {
        let shown = [0.0, -1.0, 0.25, 1e300, -2.5e-9, 1e12, f64::NAN].map(plain);
        assert_eq!(shown, ["0", "-1", "0.25", "1e300", "-2.5e-9", "1000000000000", "NaN"]);
    }
}
