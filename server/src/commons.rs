//! `Commons`: what the services of all tenants of one process have together, and how much of it each of them may have.
//!
//! What comes in: services, as they are opened. What goes out: turns on the processors, and each tenant's share of what is bounded:
//! all of it divided by the number of tenants, however little the others use. Kernels are no part of it: each tenant has a cache of
//! its own, so that neither its counters nor its times tell that another has the same formula.

use std::sync::{Arc, PoisonError, RwLock, Weak};

use isophote_jit::{CodeMemory, KernelCache, VectorWidth};

use crate::capacity::Load;
use crate::problem::Problem;
use crate::session::SearchRoom;
use crate::source::Drivers;
use crate::source::control::CameraNames;
use crate::workshop::CompileTurns;

/// Of one process.
pub struct Commons {
    width: VectorWidth,
    /// What has a say in the memory of kernels' code.
    pub memory: Option<Arc<dyn CodeMemory>>,
    /// Where documents are derived and compiled.
    pub turns: CompileTurns,
    /// Calls into cameras' drivers.
    pub drivers: Drivers,
    searches: SearchRoom,
    members: RwLock<Vec<Weak<dyn Member>>>,
}

/// What one tenant has.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Holding {
    /// Sources with a name.
    pub sources: usize,
    /// Sessions, also those that do not run.
    pub sessions: usize,
    /// Shadows of sessions.
    pub shadows: usize,
    /// Processors that they keep busy.
    pub load: f64,
}

/// One of those who share.
pub trait Member: Send + Sync {
    /// What it has now.
    fn holding(&self) -> Holding;

    /// 409 where it has a lease on the knobs of that camera.
    fn refuse_control(&self, camera: &CameraNames) -> Result<(), Problem>;
}

impl Commons {
    /// Of this machine; kernels will have vectors of that width.
    pub fn of_machine(width: VectorWidth) -> Commons {
        Commons {
            width,
            memory: None,
            turns: CompileTurns::of_machine(),
            drivers: Drivers::default(),
            searches: SearchRoom::of_machine(),
            members: RwLock::default(),
        }
    }

    /// For the kernels of one tenant.
    pub fn new_cache(&self) -> Arc<KernelCache> {
        let cache = KernelCache::of_width(self.width);
        Arc::new(match &self.memory {
            Some(memory) => cache.in_memory(memory.clone()),
            None => cache,
        })
    }

    /// From now on that one has a share.
    pub fn join(&self, member: Weak<dyn Member>) {
        self.members.write().unwrap_or_else(PoisonError::into_inner).push(member);
    }

    /// Turns for the searches of one more tenant, whose sessions may have the names of others'.
    pub fn searches(&self) -> SearchRoom {
        self.searches.of_another_tenant()
    }

    /// All who share.
    pub fn members(&self) -> Vec<Arc<dyn Member>> {
        let members = self.members.read().unwrap_or_else(PoisonError::into_inner);
        members.iter().filter_map(Weak::upgrade).collect()
    }

    /// 409 where a tenant has a lease on the knobs of that camera.
    pub fn refuse_control(&self, camera: &CameraNames) -> Result<(), Problem> {
        self.members().iter().try_for_each(|member| member.refuse_control(camera))
    }

    /// 429 where one more of `what` is more than the share of a tenant that has `own`, or more than there can be.
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

    /// 429 where `what`, which takes `added`, has no room beside what runs: `own` of the tenant, and what others have.
    pub fn admit(&self, what: &str, (before, own): (f64, f64), added: Option<(f64, f64)>) -> Result<(), Problem> {
        let members = self.members();
        let all: f64 = members.iter().map(|member| member.holding().load).sum();
        // Of its own counts what will be, not what is.
        Load::of_machine((all - before).max(0.0) + own).admit(what, added)?;
        Load::of_share(own, members.len()).admit(what, added)
    }
}
