//! `isophote watch`: prints estimates of a session as they arrive.

use std::io::Write;

use isophote_wire::{EstimateView, TrackState};

use crate::failure::Failure;
use crate::http::{self, RemoteService, ServiceArgs, segment};
use crate::output;

/// Maximum number of messages in flight: a slow terminal gets the newest estimates, not old ones.
const CREDIT: u32 = 8;

/// Print the estimates of a session as they arrive
#[derive(Clone, Debug, clap::Args)]
pub struct WatchArgs {
    /// Name of the session
    pub name: String,
    /// Stop after this many estimates
    #[arg(long, value_name = "N")]
    pub count: Option<u64>,
    /// Print every estimate, in order, instead of the newest ones
    #[arg(long)]
    pub all: bool,
    #[command(flatten)]
    service: ServiceArgs,
}

/// Runs until the session ends, or `--count`.
pub fn run(args: &WatchArgs, out: &mut dyn Write) -> Result<(), Failure> {
    let mode = if args.all { "all" } else { "latest" };
    let path = format!("/v1/sessions/{}/estimates?mode={mode}&credit={CREDIT}", segment(&args.name));
    let mut estimates = RemoteService::new(&args.service)?.websocket(&path)?;
    let mut left = args.count.unwrap_or(u64::MAX);
    while left > 0 {
        let Some(text) = estimates.next()? else { return Ok(()) };
        left -= 1;
        if args.service.json {
            writeln!(out, "{text}").map_err(Failure::output)?;
        } else {
            writeln!(out, "{}", line(&http::read(&text)?)).map_err(Failure::output)?;
        }
        out.flush().map_err(Failure::output)?;
        estimates.renew(1)?;
    }
    Ok(())
}

/// Frame, state, free parameters with standard deviations, fit time, and the number of dropped frames.
fn line(estimate: &EstimateView) -> String {
    let state = serde_json::to_value(estimate.state).ok().and_then(|v| v.as_str().map(str::to_string));
    let mut text = format!("{:>8}  {:<9}", estimate.frame, state.unwrap_or_default());
    if estimate.state == TrackState::Tracking {
        for (index, name) in estimate.order.iter().enumerate() {
            let Some(value) = estimate.parameters.get(name) else { continue };
            let variance = estimate.covariance.as_ref().and_then(|rows| rows.get(index)?.get(index).copied());
            text += &format!("  {name} {}", output::with_deviation(value, variance.map(f64::sqrt)));
        }
    }
    if let Some(timing) = estimate.timing_us {
        text += &format!("  {} µs", timing.fit);
    }
    if estimate.dropped > 0 {
        text += &format!("  ({} dropped)", estimate.dropped);
    }
    text
}
