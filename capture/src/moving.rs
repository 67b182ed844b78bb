//! `Moving`: a constant number of a document, or a formula of time.

use std::convert::Infallible;
use std::fmt;
use std::str::FromStr;

use isophote_frame::plain;
use isophote_symbolic::{Diagnostic, Diagnostics, Formula};
use serde::de::{self, Deserializer, Visitor};
use serde::{Deserialize, Serialize};

/// A number, or a formula of `t`, seconds since the first frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(untagged)]
pub enum Moving {
    /// A constant.
    Number(f64),
    /// A formula of `t`.
    Formula(String),
}

impl From<f64> for Moving {
    fn from(number: f64) -> Moving {
        Moving::Number(number)
    }
}

impl FromStr for Moving {
    type Err = Infallible;
    /// Text that is not a number becomes a formula, which is validated later.
    fn from_str(text: &str) -> Result<Moving, Infallible> {
        Ok(text.trim().parse().map_or_else(|_| Moving::Formula(text.to_string()), Moving::Number))
    }
}

impl<'de> Deserialize<'de> for Moving {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Moving, D::Error> {
        struct Either;
        impl Visitor<'_> for Either {
            type Value = Moving;
            fn expecting(&self, formatter: &mut fmt::Formatter) -> fmt::Result {
                formatter.write_str("a number or a formula of t")
            }
            fn visit_f64<E: de::Error>(self, number: f64) -> Result<Moving, E> {
                Ok(Moving::Number(number))
            }
            fn visit_i64<E: de::Error>(self, number: i64) -> Result<Moving, E> {
                Ok(Moving::Number(number as f64))
            }
            fn visit_u64<E: de::Error>(self, number: u64) -> Result<Moving, E> {
                Ok(Moving::Number(number as f64))
            }
            fn visit_str<E: de::Error>(self, formula: &str) -> Result<Moving, E> {
                Ok(Moving::Formula(formula.to_string()))
            }
        }
        deserializer.deserialize_any(Either)
    }
}

/// Allowed range of a number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Range {
    /// Both ends included.
    Between(f64, f64),
    /// Above 0, with an upper bound.
    PositiveTo(f64),
    /// At least 0, with an upper bound.
    NotNegativeTo(f64),
}

impl Range {
    fn holds(self, value: f64) -> bool {
        match self {
            Range::PositiveTo(to) => value > 0.0 && value <= to,
            Range::NotNegativeTo(to) => (0.0..=to).contains(&value),
            Range::Between(from, to) => (from..=to).contains(&value),
        }
    }

    /// Error message for a value out of range.
    fn refusal(self, value: f64, when: &str) -> String {
        let is_large = value.is_finite() && value > 0.0;
        let wanted = match self {
            Range::Between(from, to) => format!("{} to {}", plain(from), plain(to)),
            Range::PositiveTo(to) if is_large => format!("positive, and {} at most", plain(to)),
            Range::PositiveTo(_) => "positive".to_string(),
            Range::NotNegativeTo(to) if is_large => format!("0 or positive, and {} at most", plain(to)),
            Range::NotNegativeTo(_) => "0 or positive".to_string(),
        };
        format!("is {}{when}; it must be {wanted}", plain(value))
    }
}

/// Parses a formula of `t`. The help for an unknown name lists what is available.
pub(crate) fn formula_of_t(text: &str) -> Result<Formula, Diagnostics> {
    let helped = |mut diagnostic: Diagnostic| {
        if diagnostic.code == "unknown-name" {
            diagnostic.help =
                Some("only t is known, the seconds since the first frame, beside functions and pi".into());
        }
        diagnostic
    };
    Formula::parse(text, &["t"]).map_err(|diagnostics| diagnostics.into_iter().map(helped).collect())
}

/// A parsed [`Moving`].
pub(crate) enum Law {
    /// A constant, already range-checked.
    Still(f64),
    /// Range-checked when evaluated.
    Moves(Box<Formula>),
}

/// Why a [`Moving`] is invalid.
#[derive(Debug)]
pub(crate) enum MovingFault {
    /// A number out of range, with a message.
    Range(String),
    /// Not a formula of t.
    Formula(Diagnostics),
}

impl Law {
    /// Parses a formula, or range-checks a number.
    pub fn read(moving: &Moving, range: Range) -> Result<Law, MovingFault> {
        match moving {
            Moving::Number(number) if range.holds(*number) => Ok(Law::Still(*number)),
            Moving::Number(number) => Err(MovingFault::Range(range.refusal(*number, ""))),
            Moving::Formula(text) => {
                formula_of_t(text).map(|formula| Law::Moves(Box::new(formula))).map_err(MovingFault::Formula)
            }
        }
    }

    /// The value at time `t_s`; a message if it is out of range.
    pub fn at(&self, t_s: f64, range: Range) -> Result<f64, String> {
        let value = match self {
            Law::Still(number) => return Ok(*number),
            Law::Moves(formula) => formula.evaluate(&[t_s]),
        };
        if range.holds(value) { Ok(value) } else { Err(range.refusal(value, &format!(" at t = {t_s} s"))) }
    }
}
