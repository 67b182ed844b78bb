//! `Machine`: resources that the services of all tenants of one process share.
//!
//! A tenant's share is the whole divided by the number of tenants, however little the others use. Kernels are not shared: each
//! tenant has a cache of its own, so that neither its counters nor its times reveal that another tenant has the same formula.

use std::sync::{Arc, PoisonError, RwLock, Weak};

use isophote_jit::{CodeMemory, KernelCache, VectorWidth};

use crate::problem::Problem;
use crate::service::capacity::Load;
use crate::service::workshop::CompileTurns;
use crate::session::SearchQuota;
use crate::source::Drivers;
use crate::source::control::CameraNames;

/// The shared resources of one process.
pub struct Machine {
    width: VectorWidth,
    /// Permits or refuses each step of code memory; none permits all.
    pub memory: Option<Arc<dyn CodeMemory>>,
    /// Turns to derive and compile documents.
    pub turns: CompileTurns,
    /// Runs calls into cameras' drivers.
    pub drivers: Drivers,
    searches: SearchQuota,
    members: RwLock<Vec<Weak<dyn Member>>>,
}

/// The resources that one tenant uses.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Holding {
    /// Sources with a name.
    pub sources: usize,
    /// Sessions, also those that do not run.
    pub sessions: usize,
    /// Shadows of sessions.
    pub shadows: usize,
    /// Processors that realtime sessions and sources keep busy.
    pub load: f64,
}

/// A tenant that shares the machine.
pub trait Member: Send + Sync {
    /// The resources that it uses now.
    fn holding(&self) -> Holding;

    /// 409 if it has a lease on the controls of that camera.
    fn refuse_control(&self, camera: &CameraNames) -> Result<(), Problem>;
}

impl Machine {
    /// The resources of this machine, with kernels of that vector width.
    pub fn of_machine(width: VectorWidth) -> Machine {
        Machine {
            width,
            memory: None,
            turns: CompileTurns::of_machine(),
            drivers: Drivers::default(),
            searches: SearchQuota::of_machine(),
            members: RwLock::default(),
        }
    }

    /// A kernel cache for one tenant.
    pub fn new_cache(&self) -> Arc<KernelCache> {
        let cache = KernelCache::of_width(self.width);
        Arc::new(match &self.memory {
            Some(memory) => cache.in_memory(memory.clone()),
            None => cache,
        })
    }

    /// Adds a tenant, which then has a share.
    pub fn join(&self, member: Weak<dyn Member>) {
        self.members.write().unwrap_or_else(PoisonError::into_inner).push(member);
    }

    /// Turns for the searches of another tenant, whose sessions may have the same names as others'.
    pub fn searches(&self) -> SearchQuota {
        self.searches.of_another_tenant()
    }

    /// All tenants.
    pub fn members(&self) -> Vec<Arc<dyn Member>> {
        let members = self.members.read().unwrap_or_else(PoisonError::into_inner);
        members.iter().filter_map(Weak::upgrade).collect()
    }

    /// 409 if a tenant has a lease on the controls of that camera.
    pub fn refuse_control(&self, camera: &CameraNames) -> Result<(), Problem> {
        self.members().iter().try_for_each(|member| member.refuse_control(camera))
    }

    /// 429 if one more of `what` exceeds the share of a tenant that has `own`, or `most` in all.
    pub fn refuse_more(
        &self,
        what: &str,
        most: usize,
        own: Holding,
        count: fn(&Holding) -> usize,
    ) -> Result<(), Problem> {
        let members = self.members();
        let share = most.div_ceil(members.len().max(1));
        let all: usize = members.iter().map(|member| count(&member.holding())).sum();
        if count(&own) >= share || all >= most { Err(Problem::over_limit(what, share)) } else { Ok(()) }
    }

    /// 429 if `what`, which takes `added`, exceeds the capacity of the machine or the tenant's share of it. `before` is the
    /// tenant's present load, `own` its load without `what`.
    pub fn admit(&self, what: &str, (before, own): (f64, f64), added: Option<(f64, f64)>) -> Result<(), Problem> {
        let members = self.members();
        let all: f64 = members.iter().map(|member| member.holding().load).sum();
        // The tenant counts with its future load, not its present one.
        Load::of_machine((all - before).max(0.0) + own).admit(what, added)?;
        Load::of_share(own, members.len()).admit(what, added)
    }
}
