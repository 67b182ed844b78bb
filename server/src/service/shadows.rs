//! Shadows of sessions: their limit, and admission beside the running load.

use std::sync::Arc;

use isophote_wire::ShadowView;

use super::{Put, Service};
use crate::limits::LIMITS;
use crate::problem::Problem;
use crate::service::command::Command;
use crate::service::compiler::Owner;
use crate::service::machine::Member;
use crate::session::{PreparedShadow, Session};

impl Service {
    /// Starts the shadow of a session. Sessions never displace shadows, and admission of a session does not count shadows.
    pub fn put_shadow(
        &self,
        owner: &mut Owner,
        name: &str,
        session: &Arc<Session>,
        prepared: PreparedShadow,
    ) -> Result<(Put, ShadowView), Problem> {
        let command = Command::PutShadow { session: name.to_string(), document: prepared.document() };
        owner.change(command, |owner| {
            self.refuse_when_draining()?;
            if !Arc::ptr_eq(&self.session(name)?, session) {
                return Err(Problem::conflict("not-applicable", "the session was replaced before it had the shadow"));
            }
            let sessions = self.sessions();
            let others = sessions.iter().filter(|(other, _)| other.as_str() != name);
            let shadows: Vec<_> = others.filter_map(|(_, session)| session.shadow().ok()).collect();
            // Replacing the session's own shadow adds none.
            if session.shadow().is_err() {
                self.machine.refuse_more("shadows", LIMITS.shadows, self.holding(), |of| of.shadows)?;
            }
            if let Some(rate_hz) = session.source().source.realtime_hz() {
                let running: f64 = sessions.iter().filter_map(|(_, session)| session.load()).sum();
                let of_shadows: f64 = shadows.iter().filter_map(|shadow| shadow.load()).sum();
                let running = running + of_shadows + self.load_of_sources();
                let added = prepared.fit_ms.map(|fit_ms| (fit_ms, rate_hz));
                let what = format!("a shadow of the session `{name}`");
                self.machine.admit(&what, (self.holding().load, running), added)?;
            }
            self.counters.compile_s.observe(prepared.compile_ms / 1e3);
            let put = if session.put_shadow(owner, prepared)? { Put::Replaced } else { Put::Created };
            Ok((put, session.shadow()?.view()))
        })
    }

    /// Ends the shadow of a session.
    pub fn drop_shadow(&self, owner: &mut Owner, session: &Session, why: &str) -> Result<(), Problem> {
        let command = Command::DropShadow { session: session.name().to_string() };
        owner.change(command, |owner| session.drop_shadow(owner, why))
    }
}
