//! `SharedRoom`: places or bytes that all tenants have together, and of which none can take everything.
//!
//! What comes in: how many there are. What goes out: permits, each given back when it is dropped. Where there are tokens a tenant has
//! a part of its own of every room, half of it, so that there is always something left for the others.

use std::sync::Arc;

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// What there is for one tenant, within what there is for all.
#[derive(Clone)]
pub struct SharedRoom {
    all: Limited,
    own: Limited,
}

#[derive(Clone)]
struct Limited {
    permits: Arc<Semaphore>,
    most: usize,
}

/// What was taken; free again when it is dropped.
#[derive(Debug)]
pub struct RoomTaken {
    _own: OwnedSemaphorePermit,
    _all: OwnedSemaphorePermit,
}

impl Limited {
    fn new(most: usize) -> Limited {
        Limited { permits: Arc::new(Semaphore::new(most)), most }
    }

    /// More than there is is all of it.
    fn count(&self, wanted: u32) -> u32 {
        wanted.min(u32::try_from(self.most).unwrap_or(u32::MAX))
    }
}

impl SharedRoom {
    /// So many, all of them for whoever comes.
    pub fn new(most: usize) -> SharedRoom {
        SharedRoom { all: Limited::new(most), own: Limited::new(most) }
    }

    /// What another tenant may have of the same.
    pub fn part(&self) -> SharedRoom {
        SharedRoom { all: self.all.clone(), own: Limited::new(self.all.most.div_ceil(2)) }
    }

    /// So many, if they are free now.
    pub fn try_take(&self, count: u32) -> Option<RoomTaken> {
        let own = self.own.permits.clone().try_acquire_many_owned(self.own.count(count)).ok()?;
        let all = self.all.permits.clone().try_acquire_many_owned(self.own.count(count)).ok()?;
        Some(RoomTaken { _own: own, _all: all })
    }

    /// So many, when they are free.
    pub async fn take(self, count: u32) -> RoomTaken {
        let count = self.own.count(count);
        let (Ok(own), Ok(all)) =
            (self.own.permits.acquire_many_owned(count).await, self.all.permits.acquire_many_owned(count).await)
        else {
            unreachable!("nobody closes a room")
        };
        RoomTaken { _own: own, _all: all }
    }

    /// How many are taken, by all.
    pub fn taken(&self) -> usize {
        self.all.most.saturating_sub(self.all.permits.available_permits())
    }

    /// How many there are for this one.
    pub fn most(&self) -> usize {
        self.own.most
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_part_is_never_all_of_it_and_the_whole_bounds_all_parts() {
        let machine = SharedRoom::new(10);
        let (one, other, third) = (machine.part(), machine.part(), machine.part());
        let held = one.try_take(5).unwrap();
        assert!(one.try_take(1).is_none(), "its part is taken");
        let of_other = other.try_take(5).unwrap();
        assert_eq!((machine.taken(), machine.most(), one.most()), (10, 10, 5));
        assert!(third.try_take(1).is_none(), "all of it is taken");
        let mut waiting = Box::pin(third.clone().take(2));
        let soon = std::time::Duration::from_millis(1);
        assert!(tokio::time::timeout(soon, &mut waiting).await.is_err());
        drop(held);
        drop(waiting.await);
        drop(of_other);
        assert_eq!(machine.taken(), 0);
        drop(one.try_take(100).expect("more than there is is all of it"));
    }
}
