//! `ModelEntry`: a model document under a name, with its compiled programs.

use std::sync::{Arc, Mutex, PoisonError};

use isophote_jit::{KernelCache, VectorWidth};
use isophote_machine::Threads;
use isophote_symbolic::{Diagnostics, Model, Precision};
use isophote_tracker::{Compiled, Workers};
use isophote_wire::{ModelItem, ModelView, model_id};

use crate::http::preconditions::{EntityTag, digest};
use crate::name::Name;
use crate::problem::Problem;

/// Media type of a document.
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
    /// The media type's name.
    pub fn name(self) -> &'static str {
        match self {
            Media::Toml => "application/toml",
            Media::Json => "application/json",
        }
    }

    /// Parses a document of this kind.
    pub fn model(self, text: &str) -> Result<Model, Diagnostics> {
        match self {
            Media::Toml => Model::from_toml(text),
            Media::Json => Model::from_json(text),
        }
    }
}

/// The text of a document.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModelText {
    /// Digest of the canonical document.
    pub digest: String,
    /// Its media type.
    pub media: Media,
    /// The text as sent, comments included.
    pub text: Arc<str>,
}

#[derive(serde::Serialize, serde::Deserialize)]
struct TextRecord<'a> {
    media: Media,
    text: std::borrow::Cow<'a, str>,
}

impl ModelText {
    /// Its key in the store: the digest of the canonical document, then of the text, since one model may be written in several
    /// ways.
    pub fn key(&self) -> String {
        let words = digest(self.text.as_bytes());
        format!("{}/{}{words}", self.digest, if self.media == Media::Toml { 't' } else { 'j' })
    }

    /// The stored form.
    pub fn bytes(&self) -> serde_json::Result<Vec<u8>> {
        serde_json::to_vec(&TextRecord { media: self.media, text: (&*self.text).into() })
    }

    /// Reads the stored form.
    pub fn read(digest: &str, bytes: &[u8]) -> serde_json::Result<ModelText> {
        let TextRecord { media, text } = serde_json::from_slice(bytes)?;
        Ok(ModelText { digest: digest.to_string(), media, text: text.into() })
    }
}

/// The model that a declaration pins, as of its time.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Pin {
    /// The model's name.
    pub name: Name,
    /// The model's version.
    pub version: u64,
    /// Digest of the canonical document.
    pub digest: String,
    /// Key of its content in the store.
    pub content: String,
}

/// A document under a name.
pub struct ModelEntry {
    /// The name in the registry.
    pub name: Name,
    /// Counts the documents put under this name.
    pub version: u64,
    /// Revision of the transaction that gave it its name; 0 for a shipped model.
    pub revision: u64,
    /// The checked document.
    pub model: Arc<Model>,
    /// Its media type.
    pub media: Media,
    /// The text as sent, comments included.
    pub text: Arc<str>,
    cache: Arc<KernelCache>,
    programs: Mutex<[Option<Compiled>; 2]>,
}

impl ModelEntry {
    /// A document without kernels yet; they will be in `cache`.
    pub fn new(
        name: Name,
        version: u64,
        model: Model,
        media: Media,
        text: &str,
        cache: Arc<KernelCache>,
    ) -> ModelEntry {
        let (model, text) = (Arc::new(model), text.into());
        ModelEntry { name, version, revision: 0, model, media, text, cache, programs: Mutex::default() }
    }

    /// `name@sha256:…`.
    pub fn id(&self) -> String {
        model_id(self.name.as_str(), self.model.digest())
    }

    /// Vector width of its kernels.
    pub fn width(&self) -> VectorWidth {
        self.cache.width()
    }

    /// Entity tag of its JSON. No two changes of a name share one, even a return to an earlier document.
    pub fn tag(&self) -> EntityTag {
        let digest = self.model.digest().trim_start_matches("sha256:");
        EntityTag::new(format!("{:x}-{}", self.revision, &digest[..digest.len().min(12)]))
    }

    /// Entity tag of its text as sent.
    pub fn text_tag(&self) -> EntityTag {
        EntityTag::new(format!("{}-toml", self.tag()))
    }

    /// All tags by which writers may name it: those of its representations, its version, its digest.
    pub fn tags(&self) -> [EntityTag; 4] {
        [self.tag(), self.text_tag(), EntityTag::new(self.version), EntityTag::new(self.model.digest())]
    }

    /// Its text.
    pub fn content(&self) -> ModelText {
        ModelText { digest: self.model.digest().to_string(), media: self.media, text: self.text.clone() }
    }

    /// A pin that finds it again, whatever its name comes to mean.
    pub fn pin(&self) -> Pin {
        Pin {
            name: self.name.clone(),
            version: self.version,
            digest: self.model.digest().to_string(),
            content: self.content().key(),
        }
    }

    /// Kernels for one session or report. The first call derives its programs; kernels are those of the cache, and evictable
    /// once the session is done. Two concurrent first calls may both derive.
    pub fn kernels(&self, precision: Precision) -> Result<Arc<Compiled>, Problem> {
        self.kernels_by(precision, &Threads)
    }

    /// The same, with programs derived by `workers`.
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
