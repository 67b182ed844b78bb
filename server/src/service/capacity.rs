//! Admission of realtime sessions by their measured cost.
//!
//! The costs of running sessions and their sources are measured frame by frame; a new session is refused, with the figures, if
//! the sum exceeds the capacity. Sessions whose frames wait for their fits use the remaining time and are not counted.

use axum::http::StatusCode;

use crate::limits::LIMITS;
use crate::problem::Problem;

/// Load of all processors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Load {
    /// Processors that the sessions keep busy at the rates of their sources.
    pub running: f64,
    /// Processors that they may keep busy.
    pub capacity: f64,
}

/// Processors that fits of `fit_s` keep busy at `rate_hz`; at most 1, since a session has one thread.
pub fn busy(fit_s: f64, rate_hz: f64) -> f64 {
    (fit_s * rate_hz).min(1.0)
}

/// Time constant of the mean cost, frames.
const COST_FRAMES: u64 = 16;

/// The running mean of a frame's cost, updated with one frame.
pub fn mean_cost(mean_ns: Option<u64>, frame_ns: u64) -> u64 {
    (mean_ns.unwrap_or(frame_ns) * (COST_FRAMES - 1) + frame_ns) / COST_FRAMES
}

impl Load {
    /// The load of this machine; sources, sockets and the system keep a part of its capacity.
    pub fn of_machine(running: f64) -> Load {
        let processors = std::thread::available_parallelism().map_or(1, usize::from);
        Load { running, capacity: LIMITS.load_share * processors as f64 }
    }

    /// The load relative to the share of one of `tenants` tenants.
    pub fn of_share(running: f64, tenants: usize) -> Load {
        let Load { running, capacity } = Load::of_machine(running);
        Load { running, capacity: capacity / tenants.max(1) as f64 }
    }

    /// 429 if `what` (the session `a`, or its shadow) with the fit time, ms, and rate, Hz, of `added` exceeds the capacity.
    /// `None`: the cost could not be measured.
    pub fn admit(self, what: &str, added: Option<(f64, f64)>) -> Result<(), Problem> {
        let Load { running, capacity } = self;
        let (fit_ms, rate_hz) = added.unwrap_or_default();
        let wanted = busy(fit_ms / 1e3, rate_hz);
        if running + wanted <= capacity {
            return Ok(());
        }
        let cost = match added {
            Some(_) => {
                format!("its fits of {fit_ms:.2} ms at {rate_hz} Hz would keep {wanted:.2} processors busy, and ")
            }
            None => String::new(),
        };
        let detail = format!(
            "there is no room for {what}: {cost}those that run keep {running:.2} of {capacity:.2} busy; \
             stop one, or give it a smaller window or a lower rate"
        );
        let problem = Problem::new(StatusCode::TOO_MANY_REQUESTS, "over-capacity", detail);
        let problem = problem.with_figure("load", running).with_figure("capacity", capacity);
        Err(match added {
            Some(_) => problem.with_figure("fit_ms", fit_ms).with_figure("rate_hz", rate_hz),
            None => problem,
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_session_beyond_the_capacity_is_refused() {
        let load = |running| Load { running, capacity: 1.5 };
        assert!(load(1.0).admit("a", Some((5.0, 100.0))).is_ok());
        assert!(load(1.5).admit("a", None).is_ok());
        let problem = load(1.0).admit("a", Some((5.1, 100.0))).unwrap_err();
        assert_eq!((problem.status.as_u16(), problem.code), (429, "over-capacity"));
        let figures = problem.document().figures;
        assert_eq!(
            (figures["fit_ms"], figures["rate_hz"], figures["load"], figures["capacity"]),
            (5.1, 100.0, 1.0, 1.5)
        );
        let full = load(1.6).admit("a", None).unwrap_err().document().figures;
        assert_eq!(full.keys().collect::<Vec<_>>(), ["capacity", "load"]);
    }
}
