//! `Subscription`: one subscriber of a session's estimates, with its cursor.

use std::collections::BTreeMap;
use std::sync::atomic::Ordering;
use std::sync::{Arc, OnceLock};
use std::time::Instant;

use isophote_wire::{EstimateView, TraceView};

use super::{End, Hub, Last, State, lock};
use crate::access::Visitor;
use crate::http::streams::latest::ClientPace;
use crate::hub::event_id::{EventId, life};
use crate::hub::ring::RingReader;
use crate::hub::written::{SentEstimate, TraceWish, WrittenEstimate};
use crate::limits::LIMITS;
use crate::net::socket::ClientLink;

/// A subscriber's position.
pub(super) enum Cursor {
    /// In mode `all`.
    All(RingReader),
    /// In mode `latest`: the first number not handled yet.
    Latest(u64),
    /// In mode `End`: no estimates.
    End,
}

/// An estimate as JSON, or one to be written outside of the lock.
enum Found {
    Written(Arc<WrittenEstimate>),
    Last(Arc<EstimateView>, Arc<[TraceView]>, Arc<OnceLock<Arc<WrittenEstimate>>>),
}

/// The next message for a subscriber.
#[derive(Clone, Debug, PartialEq)]
pub enum Next {
    /// An estimate.
    Estimate(SentEstimate),
    /// There are no more.
    End(End),
}

/// One subscriber; dropping it unsubscribes.
pub struct Subscription {
    hub: Arc<Hub>,
    place: Cursor,
    /// By target.
    last_frames: BTreeMap<String, u64>,
    visitor: Visitor,
    wish: TraceWish,
    /// Smallest step between the numbers of frames that it gets.
    every: u64,
    /// It may reconnect for estimates it has missed.
    may_return: bool,
    pace: Option<ClientPace>,
}

impl Subscription {
    pub(super) fn new(hub: Arc<Hub>, place: Cursor) -> Subscription {
        Subscription {
            hub,
            place,
            last_frames: BTreeMap::new(),
            visitor: Visitor::Anyone,
            wish: TraceWish::Without,
            every: 1,
            may_return: false,
            pace: None,
        }
    }

    /// Ends the subscription when this visitor's token is revoked.
    pub fn of(mut self, visitor: Visitor) -> Subscription {
        self.visitor = visitor;
        self
    }

    /// Adds traces of the fits, if wanted.
    pub fn with_trace(mut self, wish: TraceWish) -> Subscription {
        if wish == TraceWish::With && self.wish == TraceWish::Without {
            self.hub.tracers.fetch_add(1, Ordering::Relaxed);
            self.wish = wish;
        }
        self
    }

    /// Sends one of so many frames.
    pub fn every(mut self, frames: u64) -> Subscription {
        self.every = frames.max(1);
        self
    }

    /// Paces mode `latest` by what its client reads; report sent messages with [`Subscription::sent`].
    pub fn paced(mut self, link: Option<Arc<ClientLink>>) -> Subscription {
        self.pace = link.filter(|_| self.is_latest()).map(ClientPace::new);
        self
    }

    /// Lets it reconnect with the id of its last event; with an `id` it continues after that event.
    pub fn returning(mut self, id: Option<EventId>) -> Subscription {
        self.may_return = true;
        let mut state = lock(&self.hub.state);
        if let Cursor::All(_) = self.place {
            state.ring.keep_had();
        }
        if let Some(id) = id.filter(|id| state.is_of(id)) {
            let is_new = |target: &str, frame: u64| frame > id.had(target);
            match &mut self.place {
                Cursor::All(reader) => state.ring.go_back(*reader, |kept| is_new(&kept.target, kept.frame)),
                Cursor::Latest(next) => {
                    let had = state.last.iter().filter(|(target, last)| !is_new(target, last.estimate.frame));
                    *next = had.map(|(_, last)| last.number + 1).max().unwrap_or(0);
                }
                Cursor::End => {}
            }
            self.last_frames = state.last.keys().map(|target| (target.clone(), id.had(target))).collect();
        }
        drop(state);
        self
    }

    /// Whether it is in mode `latest`.
    fn is_latest(&self) -> bool {
        matches!(self.place, Cursor::Latest(_))
    }

    /// The next estimate, once there is one and the client's pace permits it. Cancel-safe.
    pub async fn next(&mut self) -> Next {
        let visitor = self.visitor.clone();
        tokio::select! {
            biased;
            () = visitor.revoked() => Next::End(End::Revoked),
            next = self.published() => next,
        }
    }

    async fn published(&mut self) -> Next {
        let hub = self.hub.clone();
        loop {
            let changed = hub.changed.notified(); // registered before the check, so that no change is missed
            if let Some(pace) = &mut self.pace
                && lock(&hub.state).newest(&self.place, &self.last_frames, self.every).is_some()
                && !pace.permitted().await
            {
                return Next::End(End::Unreachable);
            }
            if let Some(next) = self.take() {
                return next;
            }
            changed.await;
        }
    }

    /// In mode `latest`, a further estimate to send with the one before: the newest of another target.
    pub fn more(&mut self) -> Option<SentEstimate> {
        match self.is_latest().then(|| self.take())?? {
            Next::Estimate(estimate) => Some(estimate),
            Next::End(_) => None, // the next call returns it again
        }
    }

    /// Notes that so many bytes were handed to the client's connection.
    pub fn sent(&mut self, bytes: usize) {
        self.pace.iter_mut().for_each(|pace| pace.send(bytes));
    }

    /// Waits for the end, for a subscriber without credit or in mode `End`: immediate if the service stops, else once no
    /// estimate waits.
    pub async fn end(&mut self) -> Next {
        let visitor = self.visitor.clone();
        tokio::select! {
            biased;
            () = visitor.revoked() => Next::End(End::Revoked),
            next = self.ended() => next,
        }
    }

    async fn ended(&mut self) -> Next {
        loop {
            let changed = self.hub.changed.notified();
            {
                let state = lock(&self.hub.state);
                let is_done = match &self.place {
                    Cursor::All(reader) => {
                        let is_due =
                            |kept: &WrittenEstimate| is_due(&self.last_frames, self.every, &kept.target, kept.frame);
                        !state.ring.has(*reader, is_due)
                    }
                    place => state.newest(place, &self.last_frames, self.every).is_none(),
                };
                match &state.end {
                    Some(end) if *end == End::ServiceStops || is_done => return Next::End(end.clone()),
                    _ => {}
                }
            }
            changed.await;
        }
    }

    pub(super) fn take(&mut self) -> Option<Next> {
        let mut state = lock(&self.hub.state);
        let found = match &mut self.place {
            Cursor::All(reader) => {
                let is_due = |kept: &WrittenEstimate| is_due(&self.last_frames, self.every, &kept.target, kept.frame);
                state.ring.take(*reader, is_due).map(Found::Written)
            }
            Cursor::End => None,
            place @ Cursor::Latest(_) => {
                let found = state.newest(place, &self.last_frames, self.every).map(|last| {
                    let found = Found::Last(last.estimate.clone(), last.trace.clone(), last.written.clone());
                    (last.number + 1, found)
                });
                found.map(|(next, found)| {
                    *place = Cursor::Latest(next);
                    found
                })
            }
        };
        let Some(found) = found else { return state.end.clone().map(Next::End) };
        let is_unknown = |target: &&String| !self.last_frames.contains_key(*target);
        let unknown = if self.may_return { state.last.keys().filter(is_unknown).count() } else { 0 };
        drop(state);
        let written = match found {
            Found::Written(written) => written,
            Found::Last(estimate, trace, written) => {
                written.get_or_init(|| WrittenEstimate::of(&estimate, &trace, None)).clone()
            }
        };
        let last = self.last_frames.insert(written.target.clone(), written.frame);
        let dropped = last.map_or(0, |last| written.frame.saturating_sub(last).saturating_sub(1));
        self.hub.dropped.add(dropped.saturating_sub(self.every - 1)); // frames that `every` skips are not dropped
        let before = if self.may_return {
            // Targets not sent yet count as sent up to the frame before.
            let is_first = unknown > usize::from(last.is_none());
            let before = self.last_frames.values().copied().filter(|frame| *frame < written.frame).max();
            before.or(is_first.then(|| written.frame.saturating_sub(1)))
        } else {
            None
        };
        Some(Next::Estimate(SentEstimate::new(written, dropped, self.wish, before)))
    }
}

/// Whether a subscriber with these last frames gets that one.
fn is_due(last_frames: &BTreeMap<String, u64>, every: u64, target: &str, frame: u64) -> bool {
    every == 1 || last_frames.get(target).is_none_or(|last| frame.abs_diff(*last) >= every)
}

impl State {
    /// The oldest among the newest estimates of each target that the subscriber has not had and that are due.
    fn newest(&self, place: &Cursor, last_frames: &BTreeMap<String, u64>, every: u64) -> Option<&Last> {
        let Cursor::Latest(from) = place else { return None };
        let is_due = |(target, last): &(&String, &Last)| {
            last.number >= *from && is_due(last_frames, every, target, last.estimate.frame)
        };
        self.last.iter().filter(is_due).map(|(_, last)| last).min_by_key(|last| last.number)
    }

    /// Whether an event id belongs to this life of this session.
    fn is_of(&self, id: &EventId) -> bool {
        let newest = self.last.values().max_by_key(|last| last.number).map(|last| &last.estimate);
        let is_of = |newest: &Arc<EstimateView>| {
            id.frame <= newest.frame && id.life.as_ref().is_none_or(|of| *of == life(newest))
        };
        newest.is_some_and(is_of)
    }
}

impl Drop for Subscription {
    fn drop(&mut self) {
        if self.wish == TraceWish::With {
            self.hub.tracers.fetch_sub(1, Ordering::Relaxed);
        }
        let mut state = lock(&self.hub.state);
        state.subscribers -= 1;
        if let Cursor::All(reader) = self.place {
            let until = self.may_return.then(|| Instant::now() + LIMITS.return_time);
            state.ring.leave(reader, until);
        }
    }
}
