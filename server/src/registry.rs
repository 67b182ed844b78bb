//! The models that the service knows, by name. Changed only on the compile thread, read from anywhere.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError, RwLock};

use isophote_jit::{KernelCache, VectorWidth};
use isophote_machine::Threads;
use isophote_symbolic::{Diagnostics, Model, Precision};
use isophote_tracker::{Compiled, Workers};
use isophote_wire::{ModelItem, ModelView, model_id};

use crate::limits::LIMITS;
use crate::name::Name;
use crate::problem::Problem;
use crate::store::{Store, StoreError, Stored};

/// How a document was sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum Media {
    /// `application/toml`
    #[serde(rename = "application/toml")]
    Toml,
    /// `application/json`
    #[serde(rename = "application/json")]
    Json,
}

impl Media {
    /// Parses a document of this kind.
    pub fn model(self, text: &str) -> Result<Model, Diagnostics> {
        match self {
            Media::Toml => Model::from_toml(text),
            Media::Json => Model::from_json(text),
        }
    }
}

/// One document under one name.
pub struct ModelEntry {
    /// The name in the registry.
    pub name: Name,
    /// Counts the documents put under this name.
    pub version: u64,
    /// The checked document.
    pub model: Arc<Model>,
    /// How it was sent.
    pub media: Media,
    /// As it was sent, comments and all.
    pub text: Arc<str>,
    cache: Arc<KernelCache>,
    programs: Mutex<[Option<Compiled>; 2]>,
}

impl ModelEntry {
    /// A document that has no kernels yet; they will be in `cache`.
    pub fn new(
        name: Name,
        version: u64,
        model: Model,
        media: Media,
        text: &str,
        cache: Arc<KernelCache>,
    ) -> ModelEntry {
        let (model, text) = (Arc::new(model), text.into());
        ModelEntry { name, version, model, media, text, cache, programs: Mutex::default() }
    }

    /// `name@sha256:…`.
    pub fn id(&self) -> String {
        model_id(self.name.as_str(), self.model.digest())
    }

    /// The vectors that its kernels are made for.
    pub fn width(&self) -> VectorWidth {
        self.cache.width()
    }

    /// A strong ETag without its quotes: version and the digest's first letters, so that a name that was removed and
    /// put again has another one.
    pub fn tag(&self) -> String {
        let digest = self.model.digest().trim_start_matches("sha256:");
        format!("{}-{}", self.version, &digest[..digest.len().min(12)])
    }

    /// Kernels for one session, or for a report; its programs are derived at the first call, its kernels are those of the
    /// cache, where they are free to go when the session is done. Two who ask at the same time may both derive them.
    pub fn kernels(&self, precision: Precision) -> Result<Arc<Compiled>, Problem> {
        self.kernels_by(precision, &Threads)
    }

    /// The same, its programs derived by `workers`.
    pub fn kernels_by(&self, precision: Precision, workers: &dyn Workers) -> Result<Arc<Compiled>, Problem> {
        let slot = usize::from(precision == Precision::F64);
        let lock = || self.programs.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(programs) = &lock()[slot] {
            return Ok(Arc::new(programs.share()));
        }
        let programs = Compiled::with_cache(self.model.clone(), precision, self.cache.clone(), workers)?;
        let kernels = Arc::new(programs.share());
        lock()[slot] = Some(programs);
        Ok(kernels)
    }

    /// `GET /v1/models/{name}`.
    pub fn view(&self) -> ModelView {
        let document = self.model.document().as_object().cloned().unwrap_or_default();
        ModelView { version: self.version, digest: self.model.digest().to_string(), document }
    }

    /// One item of the list.
    pub fn item(&self) -> ModelItem {
        ModelItem {
            name: self.name.to_string(),
            version: self.version,
            digest: self.model.digest().to_string(),
            description: self.model.description().to_string(),
            parameters: self.model.parameters().iter().map(|p| p.name.clone()).collect(),
        }
    }
}

/// What a writer expects to be there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Expected {
    /// Anything: the last writer wins.
    Anything,
    /// `If-Match: *`: some document.
    Something,
    /// `If-Match`: one of these tags (`version-digest`, or a version or digest alone).
    Tags(Vec<String>),
    /// `If-None-Match: *`: no document.
    Nothing,
}

impl Expected {
    fn check(&self, name: &Name, present: Option<&ModelEntry>) -> Result<(), Problem> {
        let is_right = match self {
            Expected::Anything => true,
            Expected::Something => present.is_some(),
            Expected::Nothing => present.is_none(),
            Expected::Tags(tags) => present.is_some_and(|entry| {
                tags.iter()
                    .any(|tag| *tag == entry.tag() || *tag == entry.version.to_string() || tag == entry.model.digest())
            }),
        };
        if is_right {
            return Ok(());
        }
        Err(Problem::stale(match present {
            Some(entry) => format!("`{name}` is at version {} ({})", entry.version, entry.model.digest()),
            None => format!("there is no model `{name}`"),
        }))
    }
}

/// All models.
pub struct Registry {
    /// The kernels of all models and sessions.
    cache: Arc<KernelCache>,
    models: RwLock<BTreeMap<Name, Arc<ModelEntry>>>,
    /// The names of shipped models, which are there at a start unless they were removed.
    shipped: BTreeSet<Name>,
    store: Option<Store>,
}

/// The shipped documents.
const SHIPPED: [&str; 25] = [
    include_str!("../../models/bead.toml"),
    include_str!("../../models/blob-3d.toml"),
    include_str!("../../models/blob-4d.toml"),
    include_str!("../../models/bright-disc.toml"),
    include_str!("../../models/dark-disc.toml"),
    include_str!("../../models/gaussian-pixel.toml"),
    include_str!("../../models/gaussian.toml"),
    include_str!("../../models/laser-beam.toml"),
    include_str!("../../models/moffat.toml"),
    include_str!("../../models/profile-1d.toml"),
    include_str!("../../models/raised-spot-pose.toml"),
    include_str!("../../models/rational-spot.toml"),
    include_str!("../../models/ring.toml"),
    include_str!("../../models/spot-lobe.toml"),
    include_str!("../../models/spot-motion.toml"),
    include_str!("../../models/spot-plane.toml"),
    include_str!("../../models/spot-pose.toml"),
    include_str!("../../models/spot-psf.toml"),
    include_str!("../../models/spot-quadratic.toml"),
    include_str!("../../models/spot.toml"),
    include_str!("../../models/thesis-spot.toml"),
    include_str!("../../models/three-spots-pose-lens.toml"),
    include_str!("../../models/three-spots-pose.toml"),
    include_str!("../../models/three-spots-raw.toml"),
    include_str!("../../models/three-spots.toml"),
];

impl Registry {
    /// The shipped models, and those of the folder over them. A stored document that this build refuses is reported and
    /// left where it is.
    pub fn open(data: Option<&Path>, width: VectorWidth) -> Result<Registry, StoreError> {
        let cache = Arc::new(KernelCache::of_width(width));
        let mut models = BTreeMap::new();
        for text in SHIPPED {
            match Model::from_toml(text) {
                Ok(model) => {
                    if let Some(name) = Name::parse(model.name()) {
                        let entry = ModelEntry::new(name.clone(), 1, model, Media::Toml, text, cache.clone());
                        models.insert(name, Arc::new(entry));
                    }
                }
                Err(faults) => report("a shipped model", &faults),
            }
        }
        let store = data.map(Store::open).transpose()?;
        let shipped = models.keys().cloned().collect();
        let loaded = store.as_ref().map(Store::load).transpose()?.unwrap_or_default();
        for name in loaded.removed {
            models.remove(&name);
        }
        for (name, stored) in loaded.models {
            match stored.media.model(&stored.text) {
                Ok(model) => {
                    let entry =
                        ModelEntry::new(name.clone(), stored.version, model, stored.media, &stored.text, cache.clone());
                    models.insert(name, Arc::new(entry));
                }
                Err(faults) => report(&format!("the stored model `{name}`"), &faults),
            }
        }
        Ok(Registry { cache, models: RwLock::new(models), shipped, store })
    }

    /// The kernels of all models and sessions.
    pub fn cache(&self) -> &Arc<KernelCache> {
        &self.cache
    }

    /// The document of that name.
    pub fn get(&self, name: &str) -> Result<Arc<ModelEntry>, Problem> {
        let found = Name::parse(name).and_then(|name| self.read().get(&name).cloned());
        found.ok_or_else(|| Problem::unknown("model", name))
    }

    /// Whether a model of that name is shipped with the service.
    pub fn is_shipped(&self, name: &Name) -> bool {
        self.shipped.contains(name)
    }

    /// All documents, by name.
    pub fn list(&self) -> Vec<Arc<ModelEntry>> {
        self.read().values().cloned().collect()
    }

    /// Refuses early what [`Registry::put`] would refuse.
    pub fn check(&self, name: &Name, expected: &Expected) -> Result<(), Problem> {
        let models = self.read();
        expected.check(name, models.get(name).map(Arc::as_ref))?;
        if models.len() >= LIMITS.models && !models.contains_key(name) {
            return Err(Problem::over_limit("models", LIMITS.models));
        }
        Ok(())
    }

    /// Puts a document whose kernels are made. True when the name is new. Only from the compile thread.
    pub fn put(
        &self,
        name: &Name,
        expected: &Expected,
        mut entry: ModelEntry,
    ) -> Result<(bool, Arc<ModelEntry>), Problem> {
        self.check(name, expected)?;
        let before = self.read().get(name).map(|entry| entry.version);
        entry.version = before.unwrap_or(0) + 1;
        if let Some(store) = &self.store {
            let stored = Stored { version: entry.version, media: entry.media, text: entry.text.to_string() };
            store.save(name, &stored).map_err(StoreError::problem)?;
        }
        let entry = Arc::new(entry);
        self.write().insert(name.clone(), entry.clone());
        Ok((before.is_none(), entry))
    }

    /// Removes a document. Only from the compile thread.
    pub fn remove(&self, name: &Name, expected: &Expected) -> Result<(), Problem> {
        let present = self.get(name.as_str())?;
        expected.check(name, Some(&present))?;
        if let Some(store) = &self.store {
            let is_shipped = self.shipped.contains(name);
            let removed = if is_shipped { store.remove_shipped(name) } else { store.remove(name) };
            removed.map_err(StoreError::problem)?;
        }
        self.write().remove(name);
        Ok(())
    }

    fn read(&self) -> std::sync::RwLockReadGuard<'_, BTreeMap<Name, Arc<ModelEntry>>> {
        self.models.read().unwrap_or_else(PoisonError::into_inner)
    }
    fn write(&self) -> std::sync::RwLockWriteGuard<'_, BTreeMap<Name, Arc<ModelEntry>>> {
        self.models.write().unwrap_or_else(PoisonError::into_inner)
    }
}

fn report(what: &str, faults: &Diagnostics) {
    let first = faults.first().map(|fault| format!("{} ({}:{})", fault.message, fault.line, fault.column));
    tracing::warn!("{what} is refused: {}", first.unwrap_or_default());
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use isophote_jit::PixelFormat;

    #[test]
    fn a_second_session_and_a_model_sent_again_compile_nothing() {
        let registry = Registry::open(None, VectorWidth::default()).unwrap();
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
