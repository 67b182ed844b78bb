//! `SearchQuota`: limits concurrent whole-frame searches of all sessions whose frames do not wait for their fits.
//!
//! Never blocks: a session without a slot goes on with its next frame and keeps its turn.
//!
//! A search takes many times as long as a fit. If all sessions searched at once, each search would take so long that its target
//! had moved on and was lost again: no search would succeed.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::limits::LIMITS;

/// The quota of one process, as seen by one tenant.
pub struct SearchQuota {
    places: usize,
    /// The tenant that owns these sessions.
    tenant: u64,
    state: Arc<Mutex<State>>,
}

#[derive(Default)]
struct State {
    taken: usize,
    /// Number of tenants so far.
    tenants: u64,
    /// Waiting sessions, with the time of their last request.
    queue: VecDeque<(Searcher, u64)>,
}

/// A tenant's session.
type Searcher = (u64, String);

/// A search slot, released on drop.
pub struct SearchPlace(Arc<Mutex<State>>);

impl SearchQuota {
    /// Allows half as many concurrent searches as there are processors, at least one.
    pub fn of_machine() -> SearchQuota {
        let processors = std::thread::available_parallelism().map_or(1, usize::from);
        SearchQuota::of(processors.div_ceil(2))
    }

    fn of(places: usize) -> SearchQuota {
        SearchQuota { places, tenant: 0, state: Arc::default() }
    }

    /// Shares the slots with another tenant, whose sessions may have the same names.
    pub fn of_another_tenant(&self) -> SearchQuota {
        let mut state = self.lock();
        state.tenants += 1;
        SearchQuota { places: self.places, tenant: state.tenants, state: self.state.clone() }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a slot for a session if one is free and no session has waited for longer. A session that does not ask again within
    /// `search_patience` loses its turn: it has found its target, or has ended.
    pub fn enter(&self, session: &str, now_ns: u64) -> Option<SearchPlace> {
        let mut state = self.lock();
        let patience_ns = LIMITS.search_patience.as_nanos() as u64;
        state.queue.retain(|(_, asked_ns)| now_ns.saturating_sub(*asked_ns) <= patience_ns);
        let turn = match state.queue.iter().position(|((tenant, name), _)| *tenant == self.tenant && name == session) {
            Some(turn) => {
                state.queue[turn].1 = now_ns;
                turn
            }
            None => {
                state.queue.push_back(((self.tenant, session.to_string()), now_ns));
                state.queue.len() - 1
            }
        };
        if turn >= self.places.saturating_sub(state.taken) {
            return None;
        }
        state.queue.remove(turn);
        state.taken += 1;
        Some(SearchPlace(self.state.clone()))
    }

    /// Whether all slots are taken, or a session waits for one.
    pub fn is_crowded(&self, now_ns: u64) -> bool {
        let state = self.lock();
        let patience_ns = LIMITS.search_patience.as_nanos() as u64;
        let waits = |(_, asked_ns): &(Searcher, u64)| now_ns.saturating_sub(*asked_ns) <= patience_ns;
        state.taken >= self.places || state.queue.iter().any(waits)
    }
}

impl Drop for SearchPlace {
    fn drop(&mut self) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).taken -= 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waiting_sessions_are_served_in_order_until_they_expire() {
        let quota = Arc::new(SearchQuota::of(1));
        let held = quota.enter("a", 0);
        assert!(held.is_some());
        let asks = |name: &str, now_ns| quota.enter(name, now_ns).is_some();
        assert!(!asks("b", 1) && !asks("c", 2) && !asks("a", 3), "the place is taken");
        drop(held);
        assert!(!asks("c", 4) && !asks("a", 5), "b was there before");
        assert!(asks("b", 6) && !asks("a", 7) && asks("c", 8) && asks("a", 9));

        let held = quota.enter("a", 20);
        assert!(!asks("b", 21) && !asks("c", 22));
        drop(held);
        let later = LIMITS.search_patience.as_nanos() as u64;
        assert!(!asks("c", 21 + later), "b may still come");
        assert!(asks("c", 22 + later), "b has gone");
    }

    #[test]
    fn concurrent_searches_are_limited() {
        let quota = Arc::new(SearchQuota::of(2));
        let mut held: Vec<SearchPlace> = ["a", "b", "c"].iter().filter_map(|name| quota.enter(name, 1)).collect();
        assert_eq!(held.len(), 2);
        assert!(quota.is_crowded(1));
        held.pop();
        assert!(quota.is_crowded(1), "c waits");
        assert!(!quota.is_crowded(2 + LIMITS.search_patience.as_nanos() as u64), "c has gone");
        assert!(quota.enter("d", 2).is_none() && quota.enter("c", 3).is_some());
    }
}
