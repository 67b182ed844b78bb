//! `Registry`: models, stored by content, under names whose versions are kept. Changed only on the compile thread, read from
//! any thread.
//!
//! A name is one record of the store, with all its versions and the current one, so a change of it is atomic.

mod entry;
mod files;
mod history;
mod import;
mod shipped;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, PoisonError, RwLock};

use isophote_jit::KernelCache;
use isophote_machine::unix_ms;
use isophote_wire::VersionList;

use crate::http::preconditions::Preconditions;
use crate::limits::LIMITS;
use crate::name::Name;
use crate::problem::Problem;
use crate::service::compiler::Owner;
use crate::store::{RecordTable, Store, StoreError, Transaction};
pub use entry::{Media, ModelEntry, ModelText, Pin};
pub use files::{ModelFile, models_in};
use history::ModelRecord;
pub use import::imported;
use shipped::{refused, shipped};

/// All models.
pub struct Registry {
    /// The kernels of all models and sessions of this tenant.
    cache: Arc<KernelCache>,
    store: Arc<dyn Store>,
    /// Shipped models, present unless their names were put or removed.
    shipped: BTreeMap<Name, Arc<ModelEntry>>,
    state: RwLock<State>,
    /// Disables the collection of contents.
    keeps_all: bool,
}

#[derive(Default)]
struct State {
    entries: BTreeMap<Name, Arc<ModelEntry>>,
    /// Records of names that were put or removed, with their revisions.
    records: BTreeMap<Name, (u64, ModelRecord)>,
    /// Keys of all stored contents.
    contents: BTreeSet<String>,
}

/// A name before a change.
struct Before {
    revision: Option<u64>,
    record: ModelRecord,
    /// Content of a shipped model, which is not stored yet.
    contents: Vec<ModelText>,
}

/// A document that became current.
pub struct Placed {
    /// Whether the name is new.
    pub is_new: bool,
    /// The document.
    pub entry: Arc<ModelEntry>,
    /// Versions collected for it.
    pub collected: Vec<u64>,
}

impl Registry {
    /// Loads the shipped models and those of the store, which take precedence. Logs and skips a stored document that this build
    /// refuses.
    pub fn open(store: Arc<dyn Store>, cache: Arc<KernelCache>) -> Result<Registry, StoreError> {
        let shipped = shipped(&cache);
        let contents = store.list(RecordTable::Contents)?.into_iter().map(|(key, _)| key).collect();
        let state = State { entries: shipped.clone(), records: BTreeMap::new(), contents };
        let mut registry = Registry { cache, store, shipped, state: RwLock::new(state), keeps_all: false };
        let mut is_unread = false;
        for (key, record) in registry.store.list(RecordTable::Models)? {
            let Some(name) = Name::parse(&key) else { continue };
            let known = serde_json::from_slice::<ModelRecord>(&record.bytes).unwrap_or_else(|error| {
                tracing::warn!("the record of the model `{key}` cannot be read, left alone: {error}");
                is_unread = true;
                ModelRecord::default()
            });
            let entry = known
                .current()
                .map(|version| registry.restored(&name, version.version, &version.digest, &version.content));
            let mut state = registry.write();
            state.entries.remove(&name);
            match entry {
                Some(Ok(mut entry)) => {
                    entry.revision = record.revision;
                    state.entries.insert(name.clone(), Arc::new(entry));
                }
                Some(Err(problem)) => refused(&format!("the stored model `{name}`"), &problem.detail),
                None => {}
            }
            state.records.insert(name, (record.revision, known));
        }
        registry.keeps_all = is_unread;
        Ok(registry)
    }

    /// Stops the collection of unreferenced contents: a record that cannot be read may need them.
    pub fn keep_all(&mut self) {
        self.keeps_all = true;
    }

    /// The kernels of all models and sessions.
    pub fn cache(&self) -> &Arc<KernelCache> {
        &self.cache
    }

    /// Whether a model of that name is shipped with the service.
    pub fn is_shipped(&self, name: &Name) -> bool {
        self.shipped.contains_key(name)
    }

    /// The document of that name.
    pub fn get(&self, name: &str) -> Result<Arc<ModelEntry>, Problem> {
        let found = Name::parse(name).and_then(|name| self.read().entries.get(&name).cloned());
        found.ok_or_else(|| Problem::unknown("model", name))
    }

    /// All documents, by name.
    pub fn list(&self) -> Vec<Arc<ModelEntry>> {
        self.read().entries.values().cloned().collect()
    }

    /// The versions of a name.
    pub fn versions(&self, name: &str) -> Result<VersionList, Problem> {
        let entry = self.get(name)?;
        Ok(self.before(&entry.name).record.list())
    }

    /// The text of a version as sent.
    pub fn version(&self, name: &Name, version: u64) -> Result<ModelText, Problem> {
        self.get(name.as_str())?;
        let before = self.before(name);
        let found = before.record.find(version);
        let found = found.ok_or_else(|| {
            Problem::unknown(&format!("version of the model `{name}` with the number"), &version.to_string())
        })?;
        match before.contents.into_iter().find(|content| content.key() == found.content) {
            Some(shipped) => Ok(shipped),
            None => self.content(&found.digest, &found.content),
        }
    }

    /// The model that a declaration pins.
    pub fn pinned(&self, pin: &Pin) -> Result<Arc<ModelEntry>, Problem> {
        if let Ok(entry) = self.get(pin.name.as_str())
            && entry.pin() == *pin
        {
            return Ok(entry);
        }
        Ok(Arc::new(self.restored(&pin.name, pin.version, &pin.digest, &pin.content)?))
    }

    /// The content to store along with a pin of this entry, if it is not stored yet.
    pub fn unkept(&self, entry: &ModelEntry) -> Option<ModelText> {
        let content = entry.content();
        (!self.read().contents.contains(&content.key())).then_some(content)
    }

    /// Notes contents that were stored.
    pub fn kept(&self, contents: &[ModelText]) {
        self.write().contents.extend(contents.iter().map(ModelText::key));
    }

    /// Refuses early what [`Registry::put`] would refuse.
    pub fn check(&self, name: &Name, preconditions: &Preconditions) -> Result<(), Problem> {
        let state = self.read();
        let tags = state.entries.get(name).map(|entry| entry.tags());
        preconditions.check(&format!("the model `{name}`"), tags.as_ref().map_or(&[], |tags| tags))?;
        if state.entries.len() >= LIMITS.models && !state.entries.contains_key(name) {
            return Err(Problem::over_limit("models", LIMITS.models));
        }
        Ok(())
    }

    /// Puts a compiled document. Contents in `pinned` are not collected.
    pub fn put(
        &self,
        _owner: &mut Owner,
        name: &Name,
        preconditions: &Preconditions,
        mut entry: ModelEntry,
        pinned: &BTreeSet<String>,
    ) -> Result<Placed, Problem> {
        self.check(name, preconditions)?;
        let mut before = self.before(name);
        entry.version = before.record.last + 1;
        let content = entry.content();
        before.record.add(entry.version, &content, Some(unix_ms()));
        let collected = before.record.collect();
        before.contents.push(content);
        self.place(name, before, entry, pinned, collected)
    }

    /// Makes a kept version current; `entry` is its document.
    pub fn roll_back(
        &self,
        _owner: &mut Owner,
        name: &Name,
        preconditions: &Preconditions,
        mut entry: ModelEntry,
        version: u64,
        pinned: &BTreeSet<String>,
    ) -> Result<Placed, Problem> {
        self.check(name, preconditions)?;
        let mut before = self.before(name);
        if before.record.find(version).is_none() {
            return Err(Problem::unknown("version", &version.to_string()));
        }
        entry.version = version;
        before.record.current = Some(version);
        self.place(name, before, entry, pinned, Vec::new())
    }

    /// Removes a document with all its versions.
    pub fn remove(
        &self,
        _owner: &mut Owner,
        name: &Name,
        preconditions: &Preconditions,
        pinned: &BTreeSet<String>,
    ) -> Result<(), Problem> {
        self.get(name.as_str())?;
        self.check(name, preconditions)?;
        let revision = self.before(name).revision;
        // The mark keeps a shipped model removed after a restart.
        let mark = self.shipped.contains_key(name).then(ModelRecord::default);
        self.commit(name, revision, mark, &[], pinned)?;
        self.write().entries.remove(name);
        Ok(())
    }

    fn place(
        &self,
        name: &Name,
        before: Before,
        mut entry: ModelEntry,
        pinned: &BTreeSet<String>,
        collected: Vec<u64>,
    ) -> Result<Placed, Problem> {
        entry.revision = self.commit(name, before.revision, Some(before.record), &before.contents, pinned)?;
        let entry = Arc::new(entry);
        let is_new = self.write().entries.insert(name.clone(), entry.clone()).is_none();
        Ok(Placed { is_new, entry, collected })
    }

    /// Stores the new record of a name, with the contents that it needs, and removes unreferenced ones.
    fn commit(
        &self,
        name: &Name,
        revision: Option<u64>,
        record: Option<ModelRecord>,
        contents: &[ModelText],
        pinned: &BTreeSet<String>,
    ) -> Result<u64, Problem> {
        let unwritten = |error: serde_json::Error| Problem::bug(error.to_string());
        let mut transaction = Transaction::default().expect(RecordTable::Models, name.as_str(), revision);
        transaction = match &record {
            Some(record) => {
                transaction.put(RecordTable::Models, name.as_str(), serde_json::to_vec(record).map_err(unwritten)?)
            }
            None => transaction.remove(RecordTable::Models, name.as_str()),
        };
        let mut kept: BTreeSet<String> = BTreeSet::new();
        let orphans: Vec<String> = {
            let state = self.read();
            let others = state.records.iter().filter(|(other, _)| *other != name).map(|(_, (_, record))| record);
            let needed: BTreeSet<&String> =
                others.chain(&record).flat_map(|record| &record.versions).map(|one| &one.content).collect();
            for content in contents {
                let key = content.key();
                if needed.contains(&key) && !state.contents.contains(&key) && kept.insert(key.clone()) {
                    transaction = transaction.put(RecordTable::Contents, &key, content.bytes().map_err(unwritten)?);
                }
            }
            let is_orphan = |key: &&String| !self.keeps_all && !needed.contains(key) && !pinned.contains(*key);
            state.contents.iter().filter(is_orphan).cloned().collect()
        };
        for orphan in &orphans {
            transaction = transaction.remove(RecordTable::Contents, orphan);
        }
        let revision = self.store.commit(&transaction).map_err(StoreError::problem)?;
        let mut state = self.write();
        state.contents.retain(|key| !orphans.contains(key));
        state.contents.extend(kept);
        match record {
            Some(record) => state.records.insert(name.clone(), (revision, record)),
            None => state.records.remove(name),
        };
        Ok(revision)
    }

    /// The record of a name; for a shipped model that was never put, its one version.
    fn before(&self, name: &Name) -> Before {
        if let Some((revision, record)) = self.read().records.get(name) {
            return Before { revision: Some(*revision), record: record.clone(), contents: Vec::new() };
        }
        let mut record = ModelRecord::default();
        let contents: Vec<ModelText> = self.shipped.get(name).map(|entry| entry.content()).into_iter().collect();
        contents.iter().for_each(|content| record.add(1, content, None));
        Before { revision: None, record, contents }
    }

    fn restored(&self, name: &Name, version: u64, digest: &str, key: &str) -> Result<ModelEntry, Problem> {
        let content = self.content(digest, key)?;
        let model = content.media.model(&content.text).map_err(Problem::wrong_document)?;
        Ok(ModelEntry::new(name.clone(), version, model, content.media, &content.text, self.cache.clone()))
    }

    fn content(&self, digest: &str, key: &str) -> Result<ModelText, Problem> {
        let record = self.store.get(RecordTable::Contents, key).map_err(StoreError::problem)?;
        let record = record.ok_or_else(|| Problem::bug(format!("the content {key} is not kept any more")))?;
        ModelText::read(digest, &record.bytes).map_err(|error| Problem::bug(error.to_string()))
    }

    fn read(&self) -> std::sync::RwLockReadGuard<'_, State> {
        self.state.read().unwrap_or_else(PoisonError::into_inner)
    }
    fn write(&self) -> std::sync::RwLockWriteGuard<'_, State> {
        self.state.write().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::store::MemoryStore;
    use isophote_jit::PixelFormat;
    use isophote_machine::Threads;
    use isophote_symbolic::{Model, Precision};

    #[test]
    fn equal_models_share_compiled_kernels() {
        let registry = Registry::open(Arc::new(MemoryStore::default()), Arc::default()).unwrap();
        let warm = |entry: &ModelEntry| entry.kernels(Precision::F32).unwrap().warm(PixelFormat::U8, &Threads).unwrap();
        let spot = registry.get("spot").unwrap();
        warm(&spot);
        let first = registry.cache().counts();
        assert!(first.misses > 0 && first.kernels > 0);

        warm(&registry.get("thesis-spot").unwrap()); // swap away, and back
        let between = registry.cache().counts();
        assert!(between.misses > first.misses);
        warm(&spot);
        let text = format!("# the same again\n{}", spot.text);
        let model = Model::from_toml(&text).unwrap();
        let again = ModelEntry::new(spot.name.clone(), 2, model, Media::Toml, &text, registry.cache().clone());
        warm(&again);
        let last = registry.cache().counts();
        assert_eq!(last.misses, between.misses, "compiled again");
        assert!(last.hits >= between.hits + 2 * first.misses, "{last:?}");
    }
}
