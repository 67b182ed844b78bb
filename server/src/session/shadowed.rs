//! The shadow of a session: prepared, started, dropped and promoted.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

use isophote_tracker::Carried;
use isophote_wire::ShadowDocument;
use tokio::sync::oneshot;

use super::change::{NewTracker, PreparedSwap, Requested};
use super::checks::wrong_options;
use super::shadow::{PreparedShadow, Shadow, ShadowPlace};
use super::swap::{Active, Swap};
use super::trial::{FitCost, TrialPair, TrialResult};
use super::{Session, exposed};
use crate::http::preconditions::{EntityTag, Preconditions};
use crate::limits::LIMITS;
use crate::problem::Problem;
use crate::registry::ModelEntry;
use crate::service::compiler::Owner;
use crate::service::turns::FairWorkers;
use crate::thread;

impl Session {
    /// Its shadow; 404 if it has none.
    pub fn shadow(&self) -> Result<Arc<Shadow>, Problem> {
        self.shared.shadow().ok_or_else(|| Problem::unknown("shadow of the session", &self.name))
    }

    /// The tag of its shadow, if it has one.
    pub fn shadow_tag(&self) -> Option<EntityTag> {
        self.shared.shadow().map(|shadow| shadow.tag().clone())
    }

    /// Checks the preconditions of a change of its shadow.
    ///
    /// # Errors
    /// 412.
    pub fn check_shadow_tag(&self, preconditions: &Preconditions) -> Result<(), Problem> {
        preconditions.check("the shadow", self.shadow_tag().as_slice())
    }

    /// Checks a model as [`Session::prepare_shadow`] does.
    pub fn check_shadow(&self, entry: &ModelEntry, workers: &FairWorkers) -> Result<(), Problem> {
        let tracker = self.new_tracker(entry, BTreeMap::new(), workers)?.tracker;
        tracker.map(drop).map_err(|error| wrong_options(&self.document, entry, &error))
    }

    /// Compiles a model and carries the session's track over, as a swap does. Measures its fit time on the newest frame.
    pub fn prepare_shadow(
        &self,
        entry: Arc<ModelEntry>,
        document: &ShadowDocument,
        workers: &FairWorkers,
    ) -> Result<PreparedShadow, Problem> {
        if let Some(name) = document.constants.keys().find(|name| entry.model.constant(name).is_none()) {
            let message = format!("the model `{}` has no constant `{name}`", entry.model.name());
            return Err(Problem::wrong_key("unknown-name", &format!("constants.{name}"), message));
        }
        let constants = document.constants.clone();
        let NewTracker { compiled, options, tracker, compile_ms } =
            self.new_tracker(&entry, constants.clone(), workers)?;
        let tracker = tracker.map_err(|error| wrong_options(&self.document, &entry, &error))?;
        let names = || entry.model.parameters().iter().map(|parameter| parameter.name.clone()).collect();
        let mut prepared = PreparedShadow {
            compiled: compiled.clone(),
            options: options.clone(),
            constants,
            tracker,
            carried: Vec::new(),
            reset: names(),
            compile_ms,
            fit_ms: None,
            entry,
        };
        // Without a frame it starts as a session does.
        let source = &self.source.source;
        let Some(sample) = source.sample(&self.shared.inbox) else { return Ok(prepared) };
        prepared.tracker = sample.tracker;
        let told = prepared.tracker.swap(compiled, options);
        (prepared.carried, prepared.reset) = (told.carried, told.reset);
        if source.realtime_hz().is_some() {
            let frames = TrialPair::of(source, &self.shared.inbox, sample.delivery);
            let measured = FitCost::measured(&prepared.tracker, &frames, workers, None);
            if let TrialResult::Fit(cost) = measured {
                prepared.fit_ms = Some(cost.milliseconds());
            }
        }
        Ok(prepared)
    }

    /// Starts the shadow; returns whether it replaced another.
    pub fn put_shadow(&self, _owner: &mut Owner, prepared: PreparedShadow) -> Result<bool, Problem> {
        let place =
            ShadowPlace { session: &self.name, run: &self.run, source: &self.source.source, quota: &self.quota };
        let shadow = Arc::new(Shadow::start(&place, prepared)?);
        let (session, model) = (self.name.as_str(), shadow.entry().id());
        tracing::info!(session, frame = self.last_frame(), model, "shadow put");
        let before = self.shared.replace_shadow(Some(shadow));
        let is_replaced = before.is_some();
        before.into_iter().for_each(|before| ending(before, "another shadow took its place"));
        Ok(is_replaced)
    }

    /// Ends the shadow.
    pub fn drop_shadow(&self, _owner: &mut Owner, why: &str) -> Result<(), Problem> {
        let shadow = self.shared.replace_shadow(None);
        let shadow = shadow.ok_or_else(|| Problem::unknown("shadow of the session", &self.name))?;
        tracing::info!(session = self.name.as_str(), frame = self.last_frame(), "{why}");
        ending(shadow, why);
        Ok(())
    }

    /// Prepares a swap to the shadow's model, which continues from the shadow's state. The shadow stays until it is dropped.
    /// Refused like any swap if the model is too slow.
    pub fn prepare_promotion(&self, entry: &ModelEntry, workers: &FairWorkers) -> Result<PreparedSwap, Problem> {
        let requested = Requested::of(&self.shared, entry.name.as_str());
        let shadow = self.shadow()?;
        let (compiled, options, tracker) = shadow.tracked()?;
        if self.document.options.exposure.control && !tracker.advises_exposure() {
            return Err(Problem::conflict("not-applicable", exposed::UNADVISED));
        }
        let names = entry.model.parameters().iter().map(|parameter| parameter.name.clone()).collect();
        let carried = match tracker.is_following() {
            true => Carried { carried: names, moving: tracker.names(), ..Carried::default() },
            false => Carried { reset: names, ..Carried::default() },
        };
        let (reply, answer) = oneshot::channel();
        let warm = Some(Box::new(tracker));
        let active = Active::new(entry, shadow.constants().clone());
        let swap = Swap { active, compiled, options, warm, carried, reply };
        self.check_cost(&swap, workers)?;
        Ok(PreparedSwap::new(swap, answer, 0.0, requested))
    }
}

/// Ends a shadow without waiting for it.
fn ending(shadow: Arc<Shadow>, why: &str) {
    shadow.leave(why);
    drop(thread::beside("shadow", move || shadow.wait(Instant::now() + LIMITS.end_time)));
}
