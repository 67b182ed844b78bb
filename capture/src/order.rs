//! Natural order of file names: runs of digits compare as numbers.

use std::cmp::Ordering;

/// `frame2.png` < `frame10.png`; text breaks ties of equal numbers (`02` < `2`), so the order is total.
pub(crate) fn natural(a: &str, b: &str) -> Ordering {
    let (mut left, mut right) = (a.as_bytes(), b.as_bytes());
    loop {
        match (left.first(), right.first()) {
            (None, None) => return a.cmp(b),
            (None, Some(_)) => return Ordering::Less,
            (Some(_), None) => return Ordering::Greater,
            (Some(l), Some(r)) if l.is_ascii_digit() && r.is_ascii_digit() => {
                let (l, rest_l) = number(left);
                let (r, rest_r) = number(right);
                // Without leading zeros the longer run of digits is the greater number.
                match l.len().cmp(&r.len()).then_with(|| l.cmp(r)) {
                    Ordering::Equal => (left, right) = (rest_l, rest_r),
                    other => return other,
                }
            }
            (Some(l), Some(r)) => match l.cmp(r) {
                Ordering::Equal => (left, right) = (&left[1..], &right[1..]),
                other => return other,
            },
        }
    }
}

/// The leading run of digits without its leading zeros, and what follows.
fn number(text: &[u8]) -> (&[u8], &[u8]) {
    let end = text.iter().position(|c| !c.is_ascii_digit()).unwrap_or(text.len());
    let first = text[..end].iter().position(|c| *c != b'0').unwrap_or(end);
    (&text[first..end], &text[end..])
}

#[cfg(test)]
mod tests {
    use super::natural;

    #[test]
    fn numbers_inside_names_compare_as_numbers() {
        // `a2` and `a02` are the same number; the text decides: '0' < '2'.
        let sorted = [
            "",
            "a",
            "a1.png",
            "a02.png",
            "a2.png",
            "a10.png",
            "a10b1.png",
            "a10b12.png",
            "a99999999999999999999.png",
            "b1.png",
        ];
        let mut shuffled: Vec<&str> = sorted.iter().rev().copied().collect();
        shuffled.sort_by(|a, b| natural(a, b));
        assert_eq!(shuffled, sorted);
    }
}
