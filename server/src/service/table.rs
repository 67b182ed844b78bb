//! `Table`: the sources or the sessions of a tenant. The entry of a name holds both its declaration, which is in the store, and
//! its state, so that the two change together.

use std::collections::BTreeMap;
use std::sync::{Arc, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

use super::compiler::Owner;
use super::declared::Declaration;
use crate::http::preconditions::digest;
use crate::name::Name;
use crate::problem::Problem;
use crate::registry::ModelText;
use crate::store::{RecordTable, Store, StoreError, Transaction};

/// Whether something runs, and why not.
#[derive(Clone)]
pub enum State<T> {
    /// It runs.
    Running(T),
    /// It waits for its turn after a start of the service.
    Starting,
    /// It was stopped on purpose.
    Stopped(String),
    /// It could not be started.
    Failed(String),
    /// This build cannot read its record. Its name counts as unknown.
    Unread,
}

/// A record as it is in the store.
#[derive(Clone)]
#[must_use = "`Table::run` or `Table::declare` enters it"]
pub struct StoredRecord<R> {
    revision: u64,
    /// Digest of its bytes.
    digest: String,
    /// `None` if this build cannot read it.
    record: Option<Arc<R>>,
}

/// A named source or session.
#[derive(Clone)]
pub struct Entry<R: Declaration> {
    /// `None` if it does not survive a restart.
    declared: Option<StoredRecord<R>>,
    /// Whether it runs.
    pub state: State<R::Running>,
}

impl<R: Declaration> Entry<R> {
    /// What runs.
    pub fn running(&self) -> Option<&R::Running> {
        match &self.state {
            State::Running(running) => Some(running),
            _ => None,
        }
    }

    /// Its declaration.
    pub fn record(&self) -> Option<&R> {
        self.declared.as_ref()?.record.as_deref()
    }

    /// The entity tag of its declaration, which each change replaces. The digest distinguishes records of stores that forget
    /// and restart their revisions.
    pub fn tag(&self) -> Option<String> {
        self.declared.as_ref().map(|StoredRecord { revision, digest, .. }| format!("{revision:x}-{digest}"))
    }

    fn is_known(&self) -> bool {
        !matches!(self.state, State::Unread)
    }
}

type Entries<R> = BTreeMap<Name, Entry<R>>;

/// All sources, or all sessions. Declarations change only after the store has committed.
pub struct Table<R: Declaration> {
    store: Arc<dyn Store>,
    entries: RwLock<Entries<R>>,
}

impl<R: Declaration> Table<R> {
    /// Loads the declarations of the store; `stopped` tells why one shall not be started. Logs and keeps those that this build
    /// cannot read.
    pub fn open(store: Arc<dyn Store>, stopped: impl Fn(&R) -> Option<String>) -> Result<Table<R>, StoreError> {
        let mut entries = BTreeMap::new();
        for (key, record) in store.list(R::TABLE)? {
            let Some(name) = Name::parse(&key) else { continue };
            let read = serde_json::from_slice::<R>(&record.bytes);
            if let Err(error) = &read {
                tracing::warn!("the record `{key}` of {} cannot be read, left alone: {error}", R::TABLE.name());
            }
            let state = match &read {
                Ok(record) => stopped(record).map_or(State::Starting, State::Stopped),
                Err(_) => State::Unread,
            };
            let (revision, digest) = (record.revision, digest(&record.bytes));
            let declared = Some(StoredRecord { revision, digest, record: read.ok().map(Arc::new) });
            entries.insert(name, Entry { declared, state });
        }
        Ok(Table { store, entries: RwLock::new(entries) })
    }

    /// Whether a record could not be read.
    pub fn has_unread(&self) -> bool {
        self.read().values().any(|entry| !entry.is_known())
    }

    /// The entry of a name, also if its record cannot be read.
    pub fn entry(&self, name: &str) -> Option<Entry<R>> {
        self.read().get(&Name::parse(name)?).cloned()
    }

    /// The entry of a known name.
    pub fn get(&self, name: &str) -> Option<Entry<R>> {
        self.entry(name).filter(Entry::is_known)
    }

    /// All entries of known names, by name.
    pub fn all(&self) -> Vec<(Name, Entry<R>)> {
        let entries = self.read();
        let known = entries.iter().filter(|(_, entry)| entry.is_known());
        known.map(|(name, entry)| (name.clone(), entry.clone())).collect()
    }

    /// Number of known names.
    pub fn count(&self) -> usize {
        self.read().values().filter(|entry| entry.is_known()).count()
    }

    /// The running thing of that name; 404, or 409 if it does not run.
    pub fn running(&self, name: &str) -> Result<R::Running, Problem> {
        let why = match self.entry(name).map(|entry| entry.state) {
            Some(State::Running(running)) => return Ok(running),
            Some(State::Starting) => "it is being started; try again".to_string(),
            Some(State::Stopped(reason)) => reason,
            Some(State::Failed(reason)) => format!("{reason}; put it again to start it"),
            Some(State::Unread) | None => return Err(Problem::unknown(R::KIND, name)),
        };
        Err(Problem::conflict("not-applicable", format!("the {} `{name}` does not run: {why}", R::KIND)))
    }

    /// All that run, by name.
    pub fn all_running(&self) -> Vec<(Name, R::Running)> {
        let entries = self.read();
        entries.iter().filter_map(|(name, entry)| Some((name.clone(), entry.running()?.clone()))).collect()
    }

    /// Keys of all pinned contents.
    pub fn contents(&self) -> Vec<String> {
        let entries = self.read();
        entries.values().filter_map(Entry::record).flat_map(R::contents).map(str::to_string).collect()
    }

    /// Stores a record for [`Table::run`] or [`Table::declare`], and the `contents` that are not kept yet. When this returns,
    /// they survive a crash.
    pub fn commit(
        &self,
        _owner: &mut Owner,
        name: &Name,
        record: R,
        contents: &[ModelText],
    ) -> Result<StoredRecord<R>, StoreError> {
        let unwritten = |error: serde_json::Error| StoreError::Failed(error.to_string());
        let bytes = serde_json::to_vec(&record).map_err(unwritten)?;
        let digest = digest(&bytes);
        let mut transaction = Transaction::default().expect(R::TABLE, name.as_str(), self.revision(name)).put(
            R::TABLE,
            name.as_str(),
            bytes,
        );
        for content in contents {
            transaction = transaction.put(RecordTable::Contents, &content.key(), content.bytes().map_err(unwritten)?);
        }
        let revision = self.store.commit(&transaction)?;
        Ok(StoredRecord { revision, digest, record: Some(Arc::new(record)) })
    }

    /// Replaces the declaration of a name by one that was stored.
    pub fn declare(&self, _owner: &mut Owner, name: &Name, stored: StoredRecord<R>) {
        if let Some(entry) = self.write().get_mut(name) {
            entry.declared = Some(stored);
        }
    }

    /// Enters a thing that now runs. Its declaration stays if none was `stored` for it.
    pub fn run(&self, _owner: &mut Owner, name: &Name, stored: Option<StoredRecord<R>>, running: R::Running) {
        let mut entries = self.write();
        let declared = stored.or_else(|| entries.remove(name)?.declared);
        entries.insert(name.clone(), Entry { declared, state: State::Running(running) });
    }

    /// Ends the waiting of one that is not started, with the reason.
    pub fn not_started(&self, name: &Name, why: State<R::Running>) {
        if let Some(entry) = self.write().get_mut(name).filter(|entry| matches!(entry.state, State::Starting)) {
            entry.state = why;
        }
    }

    /// Removes a name with its declaration.
    pub fn remove(&self, _owner: &mut Owner, name: &Name) -> Result<(), StoreError> {
        if let Some(revision) = self.revision(name) {
            let transaction = Transaction::default().expect(R::TABLE, name.as_str(), Some(revision));
            self.store.commit(&transaction.remove(R::TABLE, name.as_str()))?;
        }
        self.write().remove(name);
        Ok(())
    }

    /// The revision of a stored record.
    fn revision(&self, name: &Name) -> Option<u64> {
        self.read().get(name)?.declared.as_ref().map(|stored| stored.revision)
    }

    fn read(&self) -> RwLockReadGuard<'_, Entries<R>> {
        self.entries.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self) -> RwLockWriteGuard<'_, Entries<R>> {
        self.entries.write().unwrap_or_else(PoisonError::into_inner)
    }
}
