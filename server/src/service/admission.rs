//! Admission control by the measured cost of sessions and their sources.

use std::sync::Arc;

use super::Service;
use crate::name::Name;
use crate::problem::Problem;
use crate::service::machine::Member;
use crate::session::{PreparedSession, Session};
use crate::source::Source;

impl Service {
    /// Processors that named sources keep busy.
    pub(super) fn load_of_sources(&self) -> f64 {
        self.sources().iter().map(|(_, source)| source.load()).sum()
    }

    /// 429 if the machine cannot run such a session beside the current load.
    pub(super) fn admit(&self, name: &Name, prepared: &PreparedSession) -> Result<(), Problem> {
        let Some(rate_hz) = prepared.realtime_hz else { return Ok(()) };
        let others = self.sessions().into_iter().filter(|(other, _)| other != name);
        let running = others.filter_map(|(_, session)| session.load()).sum::<f64>() + self.load_of_sources();
        let added = prepared.fit_ms.map(|fit_ms| (fit_ms, rate_hz));
        self.machine.admit(&format!("the session `{name}`"), (self.holding().load, running), added)
    }

    /// 429 if the sessions of a source at that speed would overload the machine.
    pub fn admit_speed(&self, source: &Arc<Source>, speed: Option<f64>) -> Result<(), Problem> {
        let Some(ratio) = speed.map(|speed| speed / source.speed()).filter(|ratio| *ratio > 1.0) else { return Ok(()) };
        let load = |(_, session): (Name, Arc<Session>)| {
            let load = session.load()?;
            Some(if Arc::ptr_eq(&session.source().source, source) { (load * ratio).min(1.0) } else { load })
        };
        let named = self.sources().into_iter().filter(|(_, named)| Arc::ptr_eq(named, source));
        let more = named.map(|(_, source)| source.load() * (ratio - 1.0)).sum::<f64>();
        let running = self.sessions().into_iter().filter_map(load).sum::<f64>() + self.load_of_sources() + more;
        self.machine.admit("a source at that speed", (self.holding().load, running), None)
    }
}
