//! `ControlLease`: exclusive control of a source's exposure and camera controls.
//!
//! Held by a session that follows its own advice, until the session ends, or by a client, until it expires without renewal. A
//! former holder never sets anything again, not even back.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use isophote_wire::{ControlCommand, ControlView};

use crate::http::preconditions::{EntityTag, Preconditions};
use crate::problem::Problem;

/// The lease of one source.
#[derive(Default)]
pub struct ControlLease(Mutex<State>);

#[derive(Default)]
struct State {
    held: Option<Held>,
    /// The last command, by any holder, and the frame from which it shows.
    last: Option<(ControlCommand, u64)>,
}

struct Held {
    owner: String,
    /// Identifies this lease of the owner.
    id: LeaseId,
    /// `None` for a session.
    until: Option<Instant>,
    /// New each time the lease is taken, renewed or used.
    tag: EntityTag,
}

/// Identifies a lease uniquely.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LeaseId {
    /// Epoch of a session's start.
    Session(u64),
    /// Random id of a client's lease.
    Client(String),
}

impl Held {
    fn is_over(&self, now: Instant) -> bool {
        self.until.is_some_and(|until| until <= now)
    }

    /// Message with the holder and the remaining time.
    fn description(&self, now: Instant) -> String {
        match self.until {
            None => format!("the {} controls this source until it stops", self.owner),
            Some(until) => {
                let left_s = until.saturating_duration_since(now).as_secs_f64();
                format!(
                    "the client `{}` controls this source for another {left_s:.1} s, and longer if it renews",
                    self.owner
                )
            }
        }
    }
}

impl State {
    fn is_of(&self, id: &LeaseId) -> bool {
        self.held.as_ref().is_some_and(|held| held.id == *id)
    }

    fn tag(&self) -> Option<EntityTag> {
        self.held.as_ref().map(|held| held.tag.clone())
    }

    fn take(&mut self, (owner, id): (&str, &LeaseId), timeout: Option<Duration>, now: Instant) -> Result<bool, String> {
        let is_new = match &self.held {
            Some(held) if held.id != *id => return Err(held.description(now)),
            held => held.is_none(),
        };
        let until = timeout.map(|timeout| now + timeout);
        self.held = Some(Held { owner: owner.to_string(), id: id.clone(), until, tag: EntityTag::unique() });
        Ok(is_new)
    }
}

impl ControlLease {
    /// Held only briefly: slow camera controls are set outside the lock.
    fn lock(&self, now: Instant) -> MutexGuard<'_, State> {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        state.held.take_if(|held| held.is_over(now));
        state
    }

    /// Takes the lease; the same id renews it. Returns whether it is new, or a message that names the holder.
    pub fn take(&self, owner: &str, id: &LeaseId, timeout: Option<Duration>, now: Instant) -> Result<bool, String> {
        self.lock(now).take((owner, id), timeout, now)
    }

    /// The same for a client.
    ///
    /// # Errors
    /// 409 if another holder has it, 412.
    pub fn take_if(
        &self,
        preconditions: &Preconditions,
        who: (&str, &LeaseId),
        timeout: Duration,
        now: Instant,
    ) -> Result<bool, Problem> {
        let mut state = self.lock(now);
        preconditions.check("the lease", state.tag().as_slice())?;
        state.take(who, Some(timeout), now).map_err(ControlLease::refused)
    }

    /// Releases a client's lease; returns whether it was theirs.
    ///
    /// # Errors
    /// 412.
    pub fn release_if(&self, preconditions: &Preconditions, id: &LeaseId, now: Instant) -> Result<bool, Problem> {
        let mut state = self.lock(now);
        let is_theirs = state.is_of(id);
        if is_theirs {
            preconditions.check("the lease", state.tag().as_slice())?;
            state.held = None;
        }
        Ok(is_theirs)
    }

    /// Runs `knob`, which must not block, if the lease is still theirs; `knob` returns the frame from which its effect shows.
    pub fn turn(&self, id: &LeaseId, command: ControlCommand, now: Instant, knob: impl FnOnce() -> u64) -> bool {
        let mut state = self.lock(now);
        let is_theirs = state.is_of(id);
        if is_theirs {
            let since_frame = knob();
            state.last = Some((command, since_frame));
            state.held.iter_mut().for_each(|held| held.tag = EntityTag::unique());
        }
        is_theirs
    }

    /// Runs `last` and releases the lease, if it is theirs; returns whether it was.
    pub fn release(&self, id: &LeaseId, now: Instant, last: impl FnOnce()) -> bool {
        let mut state = self.lock(now);
        let is_theirs = state.is_of(id);
        if is_theirs {
            last();
            state.held = None;
        }
        is_theirs
    }

    /// Whether that lease is in force.
    pub fn has(&self, id: &LeaseId, now: Instant) -> bool {
        self.lock(now).is_of(id)
    }

    /// Message that names the holder; `None` if the lease is free.
    pub fn holder(&self, now: Instant) -> Option<String> {
        self.lock(now).held.as_ref().map(|held| held.description(now))
    }

    /// 409 with a message that names the holder.
    pub fn refused(told: String) -> Problem {
        Problem::conflict("in-use", told)
    }

    /// The lease as published, with its tag, if there is one.
    pub fn view(&self, now: Instant) -> (Option<EntityTag>, ControlView) {
        let state = self.lock(now);
        let held = state.held.as_ref();
        let view = ControlView {
            owner: held.map(|held| held.owner.clone()),
            lease: None,
            expires_in_s: held.and_then(|held| held.until).map(|until| (until - now).as_secs_f64()),
            last_command: state.last.as_ref().map(|(command, _)| command.clone()),
            since_frame: state.last.as_ref().map(|(_, since_frame)| *since_frame),
        };
        (state.tag(), view)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    const SECOND: Duration = Duration::from_secs(1);

    fn client(id: &str) -> LeaseId {
        LeaseId::Client(id.to_string())
    }

    fn exposure(factor: f64) -> ControlCommand {
        ControlCommand { exposure: Some(factor), ..ControlCommand::default() }
    }

    #[test]
    fn lease_is_exclusive_until_it_expires() {
        let (lease, start) = (ControlLease::default(), Instant::now());
        let at = |s: f64| start + Duration::from_secs_f64(s);
        assert_eq!(lease.take("a", &client("1"), Some(5 * SECOND), at(0.0)), Ok(true));
        assert_eq!(lease.take("a", &client("1"), Some(5 * SECOND), at(3.0)), Ok(false), "renewed");
        let told = lease.take("b", &client("2"), Some(SECOND), at(6.0)).unwrap_err();
        assert!(told.contains("`a`") && told.contains("2.0 s"), "{told}");
        assert!(lease.take("a", &client("3"), Some(SECOND), at(7.9)).is_err(), "another of that name");
        assert_eq!(lease.view(at(6.0)).1.expires_in_s, Some(2.0));
        assert_eq!(lease.take("b", &client("2"), Some(SECOND), at(8.0)), Ok(true));
        assert!(lease.take("a", &client("1"), Some(SECOND), at(8.5)).is_err());
        assert!(!lease.release(&client("1"), at(8.5), || panic!("not its own")));
        assert!(lease.release(&client("2"), at(8.5), || ()));
        assert_eq!(lease.holder(at(8.5)), None);
    }

    #[test]
    fn lost_lease_sets_nothing() {
        let (lease, now) = (ControlLease::default(), Instant::now());
        let session = LeaseId::Session(7);
        assert_eq!(lease.take("session `one`", &session, None, now), Ok(true));
        assert!(lease.turn(&session, exposure(2.0), now + 3600 * SECOND, || 12), "it does not run out");
        let (_, view) = lease.view(now);
        assert_eq!((view.owner.as_deref(), view.expires_in_s), (Some("session `one`"), None));
        assert_eq!((view.last_command, view.since_frame), (Some(exposure(2.0)), Some(12)));
        assert!(!lease.turn(&client("1"), exposure(9.0), now, || panic!("turned")));
        assert!(lease.take("session `one`", &LeaseId::Session(8), None, now).is_err(), "its next start waits");
        let mut turned_back = 0;
        assert!(lease.release(&session, now, || turned_back += 1));
        assert_eq!(lease.take("c", &client("1"), Some(SECOND), now), Ok(true));
        assert!(!lease.release(&session, now, || turned_back += 1) && turned_back == 1);
        assert_eq!(lease.view(now).1.last_command, Some(exposure(2.0)), "what was set stays");
        // An expired lease sets nothing, even if nobody else has taken it.
        assert!(!lease.turn(&client("1"), exposure(3.0), now + SECOND, || panic!("late")));
    }
}
