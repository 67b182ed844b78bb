//! One document under one name, with what is compiled of it.

use std::sync::{Arc, Mutex, PoisonError};

use isophote_jit::{KernelCache, VectorWidth};
use isophote_machine::Threads;
use isophote_symbolic::{Diagnostics, Model, Precision};
use isophote_tracker::{Compiled, Workers};
use isophote_wire::{ModelItem, ModelView, model_id};

use crate::name::Name;
use crate::preconditions::{EntityTag, digest};
use crate::problem::Problem;

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
    /// As a request has it.
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

/// A document as it was sent.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModelText {
    /// Of the canonical document.
    pub digest: String,
    /// How it was sent.
    pub media: Media,
    /// As it was sent, comments and all.
    pub text: Arc<str>,
}

#[derive(serde::Serialize, serde::Deserialize)]
struct TextRecord<'a> {
    media: Media,
    text: std::borrow::Cow<'a, str>,
}

impl ModelText {
    /// Where it is kept: the digest of what it says, then of its words, since the same model may be written in several.
    pub fn key(&self) -> String {
        let words = digest(self.text.as_bytes());
        format!("{}/{}{words}", self.digest, if self.media == Media::Toml { 't' } else { 'j' })
    }

    /// As it is kept.
    pub fn bytes(&self) -> serde_json::Result<Vec<u8>> {
        serde_json::to_vec(&TextRecord { media: self.media, text: (&*self.text).into() })
    }

    /// As it was kept.
    pub fn read(digest: &str, bytes: &[u8]) -> serde_json::Result<ModelText> {
        let TextRecord { media, text } = serde_json::from_slice(bytes)?;
        Ok(ModelText { digest: digest.to_string(), media, text: text.into() })
    }
}

/// The model of something that was declared: as it was then.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Pin {
    /// Its name then.
    pub name: Name,
    /// Its version then.
    pub version: u64,
    /// Of the canonical document.
    pub digest: String,
    /// Where its content is kept.
    pub content: String,
}

/// One document under one name.
pub struct ModelEntry {
    /// The name in the registry.
    pub name: Name,
    /// Counts the documents put under this name.
    pub version: u64,
    /// Of the transaction that made it the one of its name; 0 of a shipped one.
    pub revision: u64,
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
        ModelEntry { name, version, revision: 0, model, media, text, cache, programs: Mutex::default() }
    }

    /// `name@sha256:…`.
    pub fn id(&self) -> String {
        model_id(self.name.as_str(), self.model.digest())
    }

    /// The vectors that its kernels are made for.
    pub fn width(&self) -> VectorWidth {
        self.cache.width()
    }

    /// Of its representation as JSON. No two changes of a name have the same one, a return to a document included.
    pub fn tag(&self) -> EntityTag {
        let digest = self.model.digest().trim_start_matches("sha256:");
        EntityTag::new(format!("{:x}-{}", self.revision, &digest[..digest.len().min(12)]))
    }

    /// Of its text, as it was sent.
    pub fn text_tag(&self) -> EntityTag {
        EntityTag::new(format!("{}-toml", self.tag()))
    }

    /// By which writers may name it: the tags of its representations, its version, its digest.
    pub fn tags(&self) -> [EntityTag; 4] {
        [self.tag(), self.text_tag(), EntityTag::new(self.version), EntityTag::new(self.model.digest())]
    }

    /// What it says.
    pub fn content(&self) -> ModelText {
        ModelText { digest: self.model.digest().to_string(), media: self.media, text: self.text.clone() }
    }

    /// By which it is found again, whatever becomes of its name.
    pub fn pin(&self) -> Pin {
        Pin {
            name: self.name.clone(),
            version: self.version,
            digest: self.model.digest().to_string(),
            content: self.content().key(),
        }
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
