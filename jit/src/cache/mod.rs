//! `KernelCache`: one shared kernel per program.
//!
//! Two programs share a kernel if their machine code must be equal: names and spans do not count.
//!
//! Kernels in use stay; of the others the least recently used are evicted when a new one exceeds the budget. No lock is
//! held during compilation; a request for a kernel being compiled waits for it, which is faster than compiling again.

mod key;

use std::collections::BTreeMap;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use isophote_symbolic::{Program, Sink, Value};

use self::key::KernelKey;
use crate::error::CompileError;
use crate::host::Processor;
use crate::kernel::Kernel;
use crate::memory::CodeMemory;
use crate::options::{KernelOptions, VectorWidth};

/// Statistics of a cache.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct CacheCounts {
    /// Requests served from the cache.
    pub hits: u64,
    /// Requests that compiled, failures included.
    pub misses: u64,
    /// Kernels evicted to meet the budget.
    pub evictions: u64,
    /// Kernels in the cache, used or not.
    pub kernels: usize,
    /// Their estimated memory: code, program, bookkeeping.
    pub bytes: usize,
}

/// Kernels by content; thread-safe.
#[derive(Debug)]
pub struct KernelCache {
    budget_bytes: usize,
    width: VectorWidth,
    memory: Option<Arc<dyn CodeMemory>>,
    shelf: Mutex<Shelf>,
    /// Signals the end of a compilation, successful or not.
    ended: Condvar,
}

#[derive(Default, Debug)]
struct Shelf {
    slots: BTreeMap<KernelKey, Slot>,
    /// Counts requests; a slot's age is its last request.
    request: u64,
    counts: CacheCounts,
}

#[derive(Debug)]
enum Slot {
    /// A thread compiles it.
    Compiling,
    Ready {
        kernel: Arc<Kernel>,
        bytes: usize,
        last_request: u64,
    },
}

impl Default for KernelCache {
    /// A cache with a budget of [`KernelCache::BUDGET_BYTES`].
    fn default() -> KernelCache {
        KernelCache::new(KernelCache::BUDGET_BYTES)
    }
}

impl KernelCache {
    /// The default budget: the kernels of some hundred models.
    pub const BUDGET_BYTES: usize = 64 << 20;

    /// A cache that evicts unused kernels when the total exceeds `budget_bytes`.
    pub fn new(budget_bytes: usize) -> KernelCache {
        let (width, memory) = (VectorWidth::default(), None);
        KernelCache { budget_bytes, width, memory, shelf: Mutex::default(), ended: Condvar::new() }
    }

    /// A cache of [`KernelCache::BUDGET_BYTES`] for vectors of that width, see [`KernelCache::get_or_compile_wide`].
    pub fn of_width(width: VectorWidth) -> KernelCache {
        KernelCache { width, ..KernelCache::default() }
    }

    /// The same cache with a [`CodeMemory`] hook.
    pub fn in_memory(self, memory: Arc<dyn CodeMemory>) -> KernelCache {
        KernelCache { memory: Some(memory), ..self }
    }

    /// The vector width of [`KernelCache::get_or_compile_wide`].
    pub fn width(&self) -> VectorWidth {
        self.width
    }

    /// The kernel of `program` with the cache's vector width in place of that of `options`, or with 128 bits where that would
    /// be too large.
    ///
    /// # Errors
    /// Those of [`Kernel::compile`].
    pub fn get_or_compile_wide(&self, program: &Program, options: &KernelOptions) -> Result<Arc<Kernel>, CompileError> {
        match self.get_or_compile(program, &KernelOptions { width: self.width, ..options.clone() }) {
            Err(CompileError::CodeTooLarge { .. } | CompileError::FrameTooLarge { .. })
                if self.width != VectorWidth::Bits128 =>
            {
                self.get_or_compile(program, &KernelOptions { width: VectorWidth::Bits128, ..options.clone() })
            }
            kernel => kernel,
        }
    }

    /// The statistics.
    pub fn counts(&self) -> CacheCounts {
        self.lock().counts
    }

    /// The kernel of `program`, compiled if necessary. Its names and spans may be those of an equal program.
    ///
    /// # Errors
    /// Those of [`Kernel::compile`]. A failure is not cached: the next request tries again.
    pub fn get_or_compile(&self, program: &Program, options: &KernelOptions) -> Result<Arc<Kernel>, CompileError> {
        let key = KernelKey::new(program, options);
        let mut shelf = self.lock();
        loop {
            shelf.request += 1;
            let request = shelf.request;
            match shelf.slots.get_mut(&key) {
                Some(Slot::Ready { kernel, last_request, .. }) => {
                    *last_request = request;
                    let kernel = kernel.clone();
                    shelf.counts.hits += 1;
                    return Ok(kernel);
                }
                Some(Slot::Compiling) => {
                    shelf = self.ended.wait(shelf).unwrap_or_else(PoisonError::into_inner);
                }
                None => break,
            }
        }
        shelf.counts.misses += 1;
        shelf.slots.insert(key.clone(), Slot::Compiling);
        drop(shelf);
        let claim = Claim { cache: self, key };
        let kernel = Arc::new(self.compile(program, options)?);
        claim.fulfil(&kernel);
        Ok(kernel)
    }

    /// Compiles a kernel outside of the cache.
    ///
    /// # Errors
    /// Those of [`Kernel::compile`].
    pub fn compile(&self, program: &Program, options: &KernelOptions) -> Result<Kernel, CompileError> {
        Kernel::compile_into(self.memory.clone(), Processor::Host, program, options)
    }

    fn lock(&self) -> MutexGuard<'_, Shelf> {
        self.shelf.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The claim to compile the kernel of a key. Dropped without a kernel, it lets the next request compile.
struct Claim<'a> {
    cache: &'a KernelCache,
    key: KernelKey,
}

impl Claim<'_> {
    fn fulfil(self, kernel: &Arc<Kernel>) {
        let bytes = memory_bytes(kernel) + 2 * self.key.bytes();
        let mut shelf = self.cache.lock();
        let slot = Slot::Ready { kernel: kernel.clone(), bytes, last_request: shelf.request };
        shelf.slots.insert(self.key.clone(), slot);
        shelf.counts.bytes += bytes;
        shelf.counts.kernels += 1;
        let gone = shelf.make_room(self.cache.budget_bytes);
        drop(shelf);
        drop(gone); // unmaps memory: not under the lock
    }
}

impl Drop for Claim<'_> {
    fn drop(&mut self) {
        let mut shelf = self.cache.lock();
        if let Some(Slot::Compiling) = shelf.slots.get(&self.key) {
            shelf.slots.remove(&self.key);
        }
        drop(shelf);
        self.cache.ended.notify_all();
    }
}

impl Shelf {
    /// Removes unused kernels, the least recently used first, until the rest fits the budget.
    fn make_room(&mut self, budget_bytes: usize) -> Vec<Arc<Kernel>> {
        let mut gone = Vec::new();
        while self.counts.bytes > budget_bytes {
            let unused = self.slots.iter().filter_map(|(key, slot)| match slot {
                // A count of 1 cannot grow: only this map could clone the kernel, and it is locked.
                Slot::Ready { kernel, last_request, .. } if Arc::strong_count(kernel) == 1 => Some((last_request, key)),
                _ => None,
            });
            let Some(key) = unused.min_by_key(|(last_request, _)| **last_request).map(|(_, key)| key.clone()) else {
                break;
            };
            let Some(Slot::Ready { kernel, bytes, .. }) = self.slots.remove(&key) else { break };
            self.counts.bytes -= bytes;
            self.counts.kernels -= 1;
            self.counts.evictions += 1;
            gone.push(kernel);
        }
        gone
    }
}

/// Code is rounded up to pages.
const PAGE_BYTES: usize = 4096;
/// Size of a module with one function, excluding its pages.
const MODULE_BYTES: usize = 4096;

/// Memory of a kernel: pages of code, the program with its names, the module around the code.
fn memory_bytes(kernel: &Kernel) -> usize {
    let program = kernel.program();
    let values = match program.sink() {
        Sink::Sums { accumulators, totals, outputs } => accumulators.len() + totals.len() + outputs.len(),
        Sink::Plane(_) => 0,
    };
    let names = program.names();
    let lists = [&names.coordinates, &names.channels, &names.parameters, &names.constants, &names.outputs];
    let text: usize = lists.iter().flat_map(|list| list.iter()).map(|name| size_of::<String>() + name.len()).sum();
    size_of::<Kernel>()
        + MODULE_BYTES
        + kernel.code_bytes().next_multiple_of(PAGE_BYTES)
        + size_of_val(program.instructions())
        + size_of_val(program.inputs())
        + size_of::<Value>() * values
        + text
}
