//! `SearchRoom`: places for searches of whole frames, of all sessions whose sources do not wait.
//!
//! What comes in: sessions that have lost their target, each time that a frame shows it. What goes out: a place for one search, to
//! each in its turn. It never makes anybody wait: who gets no place goes on with the next frame, and has kept its turn.
//!
//! A search takes many times as long as a fit. Were all sessions to search at once, each of them would take so long that its
//! target has moved on when it is done, and is lost again: they would never come to an end.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::limits::LIMITS;

/// Of one process, as one of its tenants sees it.
pub struct SearchRoom {
    places: usize,
    /// Whose sessions these are.
    tenant: u64,
    state: Arc<Mutex<State>>,
}

#[derive(Default)]
struct State {
    taken: usize,
    /// Tenants so far.
    tenants: u64,
    /// Who waits, and when it asked last.
    queue: VecDeque<(Searcher, u64)>,
}

/// A tenant's session.
type Searcher = (u64, String);

/// A place, for as long as it is held.
pub struct SearchPlace(Arc<Mutex<State>>);

impl SearchRoom {
    /// So many searches at a time: half of the processors, and one at least.
    pub fn of_machine() -> SearchRoom {
        let processors = std::thread::available_parallelism().map_or(1, usize::from);
        SearchRoom::of(processors.div_ceil(2))
    }

    fn of(places: usize) -> SearchRoom {
        SearchRoom { places, tenant: 0, state: Arc::default() }
    }

    /// The same places, for sessions that may have the names of others.
    pub fn of_another_tenant(&self) -> SearchRoom {
        let mut state = self.lock();
        state.tenants += 1;
        SearchRoom { places: self.places, tenant: state.tenants, state: self.state.clone() }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A place for a session, when there is one and nobody waits for longer. Who does not ask again for a while has found its
    /// target, or has ended: its turn is over.
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

    /// Whether all places are taken, or somebody waits for one.
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
    fn each_has_its_turn_and_nobody_waits_for_who_has_gone() {
        let room = Arc::new(SearchRoom::of(1));
        let held = room.enter("a", 0);
        assert!(held.is_some());
        let asks = |name: &str, now_ns| room.enter(name, now_ns).is_some();
        assert!(!asks("b", 1) && !asks("c", 2) && !asks("a", 3), "the place is taken");
        drop(held);
        assert!(!asks("c", 4) && !asks("a", 5), "b was there before");
        assert!(asks("b", 6) && !asks("a", 7) && asks("c", 8) && asks("a", 9));

        let held = room.enter("a", 20);
        assert!(!asks("b", 21) && !asks("c", 22));
        drop(held);
        let later = LIMITS.search_patience.as_nanos() as u64;
        assert!(!asks("c", 21 + later), "b may still come");
        assert!(asks("c", 22 + later), "b has gone");
    }

    #[test]
    fn no_more_than_there_are_places() {
        let room = Arc::new(SearchRoom::of(2));
        let mut held: Vec<SearchPlace> = ["a", "b", "c"].iter().filter_map(|name| room.enter(name, 1)).collect();
        assert_eq!(held.len(), 2);
        assert!(room.is_crowded(1));
        held.pop();
        assert!(room.is_crowded(1), "c waits");
        assert!(!room.is_crowded(2 + LIMITS.search_patience.as_nanos() as u64), "c has gone");
        assert!(room.enter("d", 2).is_none() && room.enter("c", 3).is_some());
    }
}
