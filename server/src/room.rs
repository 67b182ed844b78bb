//! `SharedRoom`: places or bytes that all tenants have together, and of which none can take everything.
//!
//! What comes in: how many there are. What goes out: permits, each given back when it is dropped. Where there are tokens each tenant
//! has a part of its own of every room: one of *n* has 1/*n* of it, so that there is something left for the others whatever it does,
//! and the only one has all of it. Parts become smaller as tenants come; what was taken before stays taken.

use std::sync::{Arc, Mutex, PoisonError, Weak};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// What there is for one tenant, within what there is for all.
#[derive(Clone)]
pub struct SharedRoom {
    all: Arc<Semaphore>,
    most: usize,
    parts: Arc<Mutex<Vec<Weak<Part>>>>,
    own: Arc<Part>,
}

/// What one of them may have: how many, and which of them are free. Another takes its place when it becomes smaller.
struct Part(Mutex<(usize, Arc<Semaphore>)>);

/// What was taken; free again when it is dropped.
#[derive(Debug)]
pub struct RoomTaken {
    _own: OwnedSemaphorePermit,
    _all: OwnedSemaphorePermit,
}

impl Part {
    fn new(most: usize) -> Arc<Part> {
        Arc::new(Part(Mutex::new((most, Arc::new(Semaphore::new(most))))))
    }

    /// Those who wait for the part as it was ask again.
    fn resize(&self, most: usize) {
        let before = std::mem::replace(
            &mut *self.0.lock().unwrap_or_else(PoisonError::into_inner),
            (most, Arc::new(Semaphore::new(most))),
        );
        before.1.close();
    }

    /// Of so many that are wanted those that count, and where they are: what is larger than the part is all of it.
    fn now(&self, wanted: u32) -> (u32, Arc<Semaphore>) {
        let part = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        (at_most(wanted, part.0), part.1.clone())
    }
}

fn at_most(wanted: u32, most: usize) -> u32 {
    wanted.min(u32::try_from(most).unwrap_or(u32::MAX))
}

impl SharedRoom {
    /// So many, all of them for whoever comes.
    pub fn new(most: usize) -> SharedRoom {
        SharedRoom { all: Arc::new(Semaphore::new(most)), most, parts: Arc::default(), own: Part::new(most) }
    }

    /// What one more tenant may have of the same. From now on all of them have less.
    pub fn part(&self) -> SharedRoom {
        let mut parts = self.parts.lock().unwrap_or_else(PoisonError::into_inner);
        let mut others: Vec<Arc<Part>> = parts.iter().filter_map(Weak::upgrade).collect();
        // Not rounded up: all parts together are no more than there is, so that nobody's part is taken by the others.
        let most = (self.most / (others.len() + 1)).max(1);
        others.iter().for_each(|other| other.resize(most));
        others.push(Part::new(most));
        *parts = others.iter().map(Arc::downgrade).collect();
        let own = others.swap_remove(others.len() - 1);
        SharedRoom { own, parts: self.parts.clone(), ..self.clone() }
    }

    /// So many, if they are free now.
    pub fn try_take(&self, count: u32) -> Option<RoomTaken> {
        let (own, part) = self.own.now(count);
        let own = part.try_acquire_many_owned(own).ok()?;
        let all = self.all.clone().try_acquire_many_owned(at_most(count, self.most)).ok()?;
        Some(RoomTaken { _own: own, _all: all })
    }

    /// So many, when they are free.
    pub async fn take(self, count: u32) -> RoomTaken {
        let own = loop {
            let (own, part) = self.own.now(count);
            // One that was closed has become smaller.
            if let Ok(taken) = part.acquire_many_owned(own).await {
                break taken;
            }
        };
        let Ok(all) = self.all.acquire_many_owned(at_most(count, self.most)).await else {
            unreachable!("nobody closes a room")
        };
        RoomTaken { _own: own, _all: all }
    }

    /// How many are taken, by all.
    pub fn taken(&self) -> usize {
        self.most.saturating_sub(self.all.available_permits())
    }

    /// How many there are for this one, at present.
    pub fn most(&self) -> usize {
        self.own.0.lock().unwrap_or_else(PoisonError::into_inner).0
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::time::Duration;

    use super::*;

    /// Time for what must not happen.
    const SOON: Duration = Duration::from_millis(1);

    #[tokio::test]
    async fn the_only_tenant_has_all_of_it() {
        let machine = SharedRoom::new(10);
        let one = machine.part();
        let held = one.try_take(10).expect("nobody else is there");
        assert_eq!((machine.taken(), one.most()), (10, 10));
        assert!(one.try_take(1).is_none());
        drop(held);
        drop(one.try_take(100).expect("more than there is is all of it"));
        assert_eq!(machine.taken(), 0);
    }

    /// However many tenants there are, and whatever all others take: who has taken nothing gets something.
    #[tokio::test]
    async fn each_of_many_gets_its_part_whatever_the_others_do() {
        for tenants in 2..=16 {
            let machine = SharedRoom::new(64);
            let parts: Vec<SharedRoom> = (0..tenants).map(|_| machine.part()).collect();
            let (last, others) = parts.split_last().unwrap();
            let mut held = Vec::new();
            others.iter().for_each(|other| held.extend(std::iter::from_fn(|| other.try_take(1))));
            assert_eq!(held.len(), (tenants - 1) * (64 / tenants));
            assert!(last.try_take(64 / tenants as u32).is_some(), "{tenants}");
        }
    }

    #[tokio::test]
    async fn a_part_becomes_smaller_when_another_tenant_comes() {
        let machine = SharedRoom::new(10);
        let one = machine.part();
        let held = one.try_take(8).unwrap();
        let mut waiting = Box::pin(one.clone().take(9));
        assert!(tokio::time::timeout(SOON, &mut waiting).await.is_err());
        let other = machine.part();
        assert_eq!((one.most(), other.most()), (5, 5));
        assert!(other.try_take(2).is_some() && other.try_take(3).is_none(), "what was taken before stays taken");
        assert!(tokio::time::timeout(SOON, &mut waiting).await.is_err(), "nine are not free");
        drop(held);
        // Larger than the part: alone in it, and in full of what all have.
        let taken = waiting.await;
        assert_eq!((machine.taken(), one.try_take(1).is_none()), (9, true));
        assert!(other.try_take(1).is_some() && other.try_take(2).is_none());
        drop(taken);
        assert_eq!(machine.taken(), 0);
    }
}
