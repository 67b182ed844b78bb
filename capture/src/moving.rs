//! `Moving`: a number of a document that stands still, or that moves as a formula of time.

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
    /// Stands still.
    Number(f64),
    /// Moves.
    Formula(String),
}

impl From<f64> for Moving {
    fn from(number: f64) -> Moving {
        Moving::Number(number)
    }
}

impl FromStr for Moving {
    type Err = Infallible;
    /// What is no number is taken for a formula; whether it is one is told when it is read.
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

/// The values that a number may have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Range {
    /// Both ends included.
    Between(f64, f64),
    /// Above 0, and so much at most.
    PositiveTo(f64),
    /// 0 or above, and so much at most.
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

    /// A sentence about a value that is not in it: what it is, and what it must be.
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

/// A formula of `t`. Where it names something else, the help says that there is nothing else.
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

/// A [`Moving`] that has been read.
pub(crate) enum Law {
    /// In its range.
    Still(f64),
    /// Its values are looked at when they are known.
    Moves(Box<Formula>),
}

/// Why a [`Moving`] is wrong.
#[derive(Debug)]
pub(crate) enum MovingFault {
    /// A number out of its range, with a sentence.
    Range(String),
    /// No formula of t.
    Formula(Diagnostics),
}

impl Law {
    /// Parses a formula; looks whether a number is in its range.
    pub fn read(moving: &Moving, range: Range) -> Result<Law, MovingFault> {
        match moving {
            Moving::Number(number) if range.holds(*number) => Ok(Law::Still(*number)),
            Moving::Number(number) => Err(MovingFault::Range(range.refusal(*number, ""))),
            Moving::Formula(text) => {
                formula_of_t(text).map(|formula| Law::Moves(Box::new(formula))).map_err(MovingFault::Formula)
            }
        }
    }

    /// The value at time `t_s`; a sentence when it is out of its range then.
    pub fn at(&self, t_s: f64, range: Range) -> Result<f64, String> {
        let value = match self {
            Law::Still(number) => return Ok(*number),
            Law::Moves(formula) => formula.evaluate(&[t_s]),
        };
        if range.holds(value) { Ok(value) } else { Err(range.refusal(value, &format!(" at t = {t_s} s"))) }
    }
}
