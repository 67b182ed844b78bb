//! `isophote replay --verify`: whether repeated fits equal the recorded ones bit for bit.

use std::io::Write;

use isophote_machine::program_checksum;
use isophote_wire::{EstimateView, LoggedBuild, RecordedFrames};
use serde::Serialize;
use serde_json::Value;

use super::arguments::ReplayArgs;
use super::log::RecordedLog;
use super::session::{RecordedSession, Repeated};
use crate::failure::Failure;
use crate::output;

/// Fields that do not depend on the fit.
const OUTSIDE: [&str; 11] = [
    "session",
    "node",
    "epoch",
    "file",
    "capture_ns",
    "capture_unix_ns",
    "time_s",
    "publish_ns",
    "dropped",
    "truth",
    "timing_us",
];

/// Result of the comparison.
#[derive(Debug, Default, Serialize)]
struct Verdict {
    file: String,
    fits: u64,
    swaps: u64,
    snapshots: u64,
    /// Fits not repeated: their pixels were not recorded.
    left_out: u64,
    is_equal: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    difference: Option<Difference>,
    /// Possible causes of a difference.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    reasons: Vec<String>,
}

/// The first difference.
#[derive(Debug, PartialEq, Serialize)]
struct Difference {
    frame: u64,
    field: String,
    recorded: Value,
    repeated: Value,
}

/// `isophote replay --verify`.
pub fn run(args: &ReplayArgs, log: RecordedLog, out: &mut dyn Write) -> Result<(), Failure> {
    let name = args.file.display();
    match log.session.frames {
        RecordedFrames::Raw => {}
        RecordedFrames::Jpeg => {
            let reason = "its frames were packed as JPEG, which changes pixels; record with \"frames\": \"raw\"";
            return Err(Failure::Other(format!("{name}: the fits cannot be repeated bit for bit: {reason}")));
        }
        RecordedFrames::None => {
            let reason = "it has no pixels; record with \"frames\": \"raw\"";
            return Err(Failure::Other(format!("{name}: the fits cannot be repeated: {reason}")));
        }
    }
    let mut verdict =
        Verdict { file: name.to_string(), reasons: other_build(&log.session.build), ..Verdict::default() };
    let (mut session, mut frame) = (RecordedSession::new(log), 0);
    while let Some(repeated) = session.next()? {
        verdict.difference = match repeated {
            Repeated::Swap => {
                verdict.swaps += 1;
                None
            }
            Repeated::Snapshot(logged, now) => {
                verdict.snapshots += 1;
                now.and_then(|now| first("memory", &logged.snapshot, &now, &[])).map(|found| found.in_frame(frame))
            }
            Repeated::Fit(fit, again) => {
                frame = fit.fit.frame;
                verdict.fits += 1;
                match again {
                    Some(again) => {
                        let again: Vec<EstimateView> = again.into_iter().map(|(view, _)| view).collect();
                        estimates(&fit.estimates, &again)?.map(|found| found.in_frame(frame))
                    }
                    None => {
                        verdict.left_out += 1;
                        None
                    }
                }
            }
        };
        if verdict.difference.is_some() {
            break;
        }
    }
    verdict.swaps = verdict.swaps.saturating_sub(1); // the first is the initial model
    verdict.is_equal = verdict.difference.is_none() && verdict.left_out == 0 && verdict.fits > 0;
    report(args, &verdict, out)
}

fn report(args: &ReplayArgs, verdict: &Verdict, out: &mut dyn Write) -> Result<(), Failure> {
    if args.json {
        output::json(out, verdict)?;
    }
    let Verdict { file, fits, swaps, snapshots, left_out, .. } = verdict;
    let reasons = match verdict.reasons.join("; ") {
        none if none.is_empty() => String::new(),
        reasons => format!(" ({reasons})"),
    };
    if let Some(Difference { frame, field, recorded, repeated }) = &verdict.difference {
        let what = format!("{field} was {recorded} and is {repeated}{reasons}");
        return Err(Failure::Other(format!("{file}: frame {frame} comes out otherwise: {what}")));
    }
    if *fits == 0 {
        return Err(Failure::Other(format!("{file}: no frame was fitted")));
    }
    if *left_out > 0 {
        let missing = "their pixels, or notes before them, were not recorded: the disk was too slow";
        return Err(Failure::Other(format!(
            "{file}: {left_out} of {fits} fits cannot be repeated: {missing}; the others are equal"
        )));
    }
    if args.json {
        return Ok(());
    }
    writeln!(out, "{file}: {fits} fits, {swaps} swaps and {snapshots} snapshots are equal bit for bit{reasons}")
        .map_err(Failure::output)
}

/// Possible causes: another build or processor.
fn other_build(recorded: &LoggedBuild) -> Vec<String> {
    let (mut reasons, version) = (Vec::new(), env!("CARGO_PKG_VERSION"));
    if recorded.version != version || recorded.checksum != program_checksum() {
        reasons.push(format!("it was recorded by another build, {}; this is {version}", recorded.version));
    }
    if recorded.processor != std::env::consts::ARCH {
        reasons.push(format!("it was recorded on {}; this is {}", recorded.processor, std::env::consts::ARCH));
    }
    reasons
}

/// The first difference of two values.
struct Found {
    field: String,
    recorded: Value,
    repeated: Value,
}

impl Found {
    fn in_frame(self, frame: u64) -> Difference {
        let Found { field, recorded, repeated } = self;
        Difference { frame, field, recorded, repeated }
    }
}

fn estimates(recorded: &[EstimateView], repeated: &[EstimateView]) -> Result<Option<Found>, Failure> {
    if recorded.len() != repeated.len() {
        let (recorded, repeated) = (recorded.len().into(), repeated.len().into());
        return Ok(Some(Found { field: "the number of estimates".into(), recorded, repeated }));
    }
    for (recorded, repeated) in recorded.iter().zip(repeated) {
        let name = if recorded.target == "0" { String::new() } else { format!("target {}", recorded.target) };
        let [one, other] = [recorded, repeated].map(|view| serde_json::to_value(view).map_err(Failure::other));
        if let Some(found) = first(&name, &one?, &other?, &OUTSIDE) {
            return Ok(Some(found));
        }
    }
    Ok(None)
}

/// Compares numbers by their shortest decimals, which are unique. Recursion is bounded by the depth of documents.
fn first(path: &str, recorded: &Value, repeated: &Value, left_out: &[&str]) -> Option<Found> {
    let below = |key: &str| if path.is_empty() { key.to_string() } else { format!("{path}.{key}") };
    match (recorded, repeated) {
        (Value::Object(a), Value::Object(b)) => {
            let keys = a.keys().chain(b.keys().filter(|key| !a.contains_key(*key)));
            let of = |map: &serde_json::Map<String, Value>, key: &String| map.get(key).cloned().unwrap_or(Value::Null);
            keys.filter(|key| !left_out.contains(&key.as_str()))
                .find_map(|key| first(&below(key), &of(a, key), &of(b, key), &[]))
        }
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => {
            let pairs = a.iter().zip(b).enumerate();
            pairs.into_iter().find_map(|(number, (a, b))| first(&below(&number.to_string()), a, b, &[]))
        }
        _ => {
            let (recorded, repeated) = (recorded.clone(), repeated.clone());
            // Compare as text, in which −0 differs from 0.
            let [one, other] = [&recorded, &repeated].map(Value::to_string);
            (one != other).then(|| Found { field: path.to_string(), recorded, repeated })
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use serde_json::json;

    #[test]
    fn the_first_difference_is_named() {
        let field = |a: Value, b: Value| first("", &a, &b, &OUTSIDE).map(|found| found.field);
        let estimate = json!({"frame": 3, "parameters": {"bx": 1.5, "by": 0.0}, "covariance": [[1.0, 2.0]]});
        assert_eq!(field(estimate.clone(), estimate.clone()), None);
        let mut other = estimate.clone();
        other["timing_us"] = json!({"fit": 3});
        assert_eq!(field(estimate.clone(), other.clone()), None, "a clock decides it");
        other["covariance"][0][1] = json!(2.0000000000000004);
        assert_eq!(field(estimate.clone(), other.clone()).unwrap(), "covariance.0.1");
        other["parameters"]["by"] = json!(-0.0);
        other["covariance"] = json!([[1.0]]);
        assert_eq!(field(estimate.clone(), other.clone()).unwrap(), "covariance.0");
        other["covariance"] = estimate["covariance"].clone();
        assert_eq!(field(estimate.clone(), other.clone()).unwrap(), "parameters.by");
        other["parameters"] = json!({"bx": 1.5});
        assert_eq!(field(estimate, other).unwrap(), "parameters.by");
    }
}
