//! `SharedQuota`: a semaphore of connections or bytes, divided equally among tenants.
//!
//! Each of *n* tenants may hold 1/*n* of the permits, so none can starve the others; a single tenant may hold all. Parts shrink as
//! tenants are added; permits that are held stay valid. A permit is returned when it is dropped.

use std::sync::{Arc, Mutex, PoisonError, Weak};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// The part of one tenant.
#[derive(Clone)]
pub struct SharedQuota {
    all: Arc<Semaphore>,
    most: usize,
    parts: Arc<Mutex<Vec<Weak<Part>>>>,
    own: Arc<Part>,
}

/// The size of a tenant's part and its free permits; the semaphore is replaced when the part shrinks.
struct Part(Mutex<(usize, Arc<Semaphore>)>);

/// Permits that are held until this is dropped.
#[derive(Debug)]
pub struct QuotaPermit {
    _own: OwnedSemaphorePermit,
    _all: OwnedSemaphorePermit,
}

impl Part {
    fn new(most: usize) -> Arc<Part> {
        Arc::new(Part(Mutex::new((most, Arc::new(Semaphore::new(most))))))
    }

    /// Closes the old semaphore, so that waiters try again with the new one.
    fn resize(&self, most: usize) {
        let before = std::mem::replace(
            &mut *self.0.lock().unwrap_or_else(PoisonError::into_inner),
            (most, Arc::new(Semaphore::new(most))),
        );
        before.1.close();
    }

    /// The number of permits that a request takes, at most the whole part, and the semaphore to take them from.
    fn now(&self, wanted: u32) -> (u32, Arc<Semaphore>) {
        let part = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        (at_most(wanted, part.0), part.1.clone())
    }
}

fn at_most(wanted: u32, most: usize) -> u32 {
    wanted.min(u32::try_from(most).unwrap_or(u32::MAX))
}

impl SharedQuota {
    /// A quota of so many permits for a single tenant.
    pub fn new(most: usize) -> SharedQuota {
        SharedQuota { all: Arc::new(Semaphore::new(most)), most, parts: Arc::default(), own: Part::new(most) }
    }

    /// Adds a tenant: returns its part and shrinks those of the others.
    pub fn part(&self) -> SharedQuota {
        let mut parts = self.parts.lock().unwrap_or_else(PoisonError::into_inner);
        let mut others: Vec<Arc<Part>> = parts.iter().filter_map(Weak::upgrade).collect();
        // Rounded down, so that the parts together do not exceed the quota.
        let most = (self.most / (others.len() + 1)).max(1);
        others.iter().for_each(|other| other.resize(most));
        others.push(Part::new(most));
        *parts = others.iter().map(Arc::downgrade).collect();
        let own = others.swap_remove(others.len() - 1);
        SharedQuota { own, parts: self.parts.clone(), ..self.clone() }
    }

    /// Takes permits if they are free.
    pub fn try_take(&self, count: u32) -> Option<QuotaPermit> {
        let (own, part) = self.own.now(count);
        let own = part.try_acquire_many_owned(own).ok()?;
        let all = self.all.clone().try_acquire_many_owned(at_most(count, self.most)).ok()?;
        Some(QuotaPermit { _own: own, _all: all })
    }

    /// Waits for permits.
    pub async fn take(self, count: u32) -> QuotaPermit {
        let own = loop {
            let (own, part) = self.own.now(count);
            // A closed semaphore was replaced by a smaller one.
            if let Ok(taken) = part.acquire_many_owned(own).await {
                break taken;
            }
        };
        let Ok(all) = self.all.acquire_many_owned(at_most(count, self.most)).await else {
            unreachable!("nobody closes a quota")
        };
        QuotaPermit { _own: own, _all: all }
    }

    /// Permits held by all tenants.
    pub fn taken(&self) -> usize {
        self.most.saturating_sub(self.all.available_permits())
    }

    /// Permits of this tenant's part at present.
    pub fn most(&self) -> usize {
        self.own.0.lock().unwrap_or_else(PoisonError::into_inner).0
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::time::Duration;

    use super::*;

    /// Wait for what must not happen.
    const SOON: Duration = Duration::from_millis(1);

    #[tokio::test]
    async fn a_single_tenant_has_the_whole_quota() {
        let machine = SharedQuota::new(10);
        let one = machine.part();
        let held = one.try_take(10).expect("nobody else is there");
        assert_eq!((machine.taken(), one.most()), (10, 10));
        assert!(one.try_take(1).is_none());
        drop(held);
        drop(one.try_take(100).expect("more than there is is all of it"));
        assert_eq!(machine.taken(), 0);
    }

    /// Whatever the others take, a tenant that holds nothing gets its part.
    #[tokio::test]
    async fn no_tenant_can_take_the_part_of_another() {
        for tenants in 2..=16 {
            let machine = SharedQuota::new(64);
            let parts: Vec<SharedQuota> = (0..tenants).map(|_| machine.part()).collect();
            let (last, others) = parts.split_last().unwrap();
            let mut held = Vec::new();
            others.iter().for_each(|other| held.extend(std::iter::from_fn(|| other.try_take(1))));
            assert_eq!(held.len(), (tenants - 1) * (64 / tenants));
            assert!(last.try_take(64 / tenants as u32).is_some(), "{tenants}");
        }
    }

    #[tokio::test]
    async fn a_part_shrinks_when_a_tenant_is_added() {
        let machine = SharedQuota::new(10);
        let one = machine.part();
        let held = one.try_take(8).unwrap();
        let mut waiting = Box::pin(one.clone().take(9));
        assert!(tokio::time::timeout(SOON, &mut waiting).await.is_err());
        let other = machine.part();
        assert_eq!((one.most(), other.most()), (5, 5));
        assert!(other.try_take(2).is_some() && other.try_take(3).is_none(), "what was taken before stays taken");
        assert!(tokio::time::timeout(SOON, &mut waiting).await.is_err(), "nine are not free");
        drop(held);
        // A request larger than the part takes all of the part, and its full count of the shared quota.
        let taken = waiting.await;
        assert_eq!((machine.taken(), one.try_take(1).is_none()), (9, true));
        assert!(other.try_take(1).is_some() && other.try_take(2).is_none());
        drop(taken);
        assert_eq!(machine.taken(), 0);
    }
}
