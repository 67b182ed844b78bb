//! Durable records by key, changed in atomic transactions.
//!
//! A [`Transaction`] states the revisions that its author expects; each commit gets a new revision. Acknowledged means durable;
//! refused means that nothing changed. The store does not interpret records, and [`Store`] hides the database: one shared by
//! several machines fits behind the same trait.

mod folder;
mod memory;
#[cfg(test)]
mod power_tests;
mod record;
mod redb;
#[cfg(test)]
mod tests;

pub use folder::{FolderError, is_read_only, open, warn};
pub use memory::MemoryStore;
#[cfg(test)]
pub use memory::ReadOnlyStore;
#[cfg(test)]
pub use record::Record;
pub use record::{RecordTable, Store, StoreError, Transaction};
