//! What must survive a crash: records by key, changed together or not at all.
//!
//! What comes in: a [`Transaction`], with what its author believes to stand. What goes out: [`Record`]s, and a new revision for
//! every transaction. Acknowledged means durable; refused means that nothing was changed. It must never know what a record
//! means, and nobody outside may know which database keeps it: one that is shared by several machines fits behind the same trait.

mod folder;
mod memory;
#[cfg(test)]
mod power_tests;
mod record;
mod redb;
#[cfg(test)]
mod tests;

pub use folder::{FolderError, is_read_only, open, said};
pub use memory::MemoryStore;
#[cfg(test)]
pub use memory::ReadOnlyStore;
#[cfg(test)]
pub use record::Record;
pub use record::{RecordTable, Store, StoreError, Transaction};
