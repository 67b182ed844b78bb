//! `ModelRecord`: the versions of a name, and the current one.

use isophote_machine::rfc3339;
use isophote_wire::{VersionItem, VersionList};
use serde::{Deserialize, Serialize};

use super::entry::ModelText;
use crate::limits::LIMITS;

/// The stored record of a name. Without a current version: a removed shipped model.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ModelRecord {
    /// The current version.
    pub current: Option<u64>,
    /// The newest version so far.
    pub last: u64,
    /// Number of versions collected because there were too many.
    pub collected: u64,
    /// Kept versions, oldest first.
    pub versions: Vec<VersionRecord>,
}

/// One version.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct VersionRecord {
    /// Counts the documents put under the name.
    pub version: u64,
    /// Digest of the canonical document.
    pub digest: String,
    /// Key of its content in the store.
    pub content: String,
    /// Bytes of its text.
    pub bytes: u64,
    /// When it was put, ms since 1970; `None` for a shipped version, or one older than its history.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub created_unix_ms: Option<u64>,
}

impl ModelRecord {
    /// Adds a version and makes it current.
    pub fn add(&mut self, version: u64, content: &ModelText, created_unix_ms: Option<u64>) {
        let (digest, bytes) = (content.digest.clone(), content.text.len() as u64);
        self.versions.push(VersionRecord { version, digest, content: content.key(), bytes, created_unix_ms });
        self.current = Some(version);
        self.last = version;
    }

    /// Removes the oldest versions while there are too many, but never the current one; returns those removed.
    pub fn collect(&mut self) -> Vec<u64> {
        let mut collected = Vec::new();
        loop {
            let bytes: u64 = self.versions.iter().map(|one| one.bytes).sum();
            if self.versions.len() <= LIMITS.model_versions && bytes <= LIMITS.model_bytes {
                break;
            }
            let Some(oldest) = self.versions.iter().position(|one| Some(one.version) != self.current) else { break };
            collected.push(self.versions.remove(oldest).version);
        }
        self.collected += collected.len() as u64;
        collected
    }

    /// Finds a kept version.
    pub fn find(&self, version: u64) -> Option<&VersionRecord> {
        self.versions.iter().find(|one| one.version == version)
    }

    /// The current version.
    pub fn current(&self) -> Option<&VersionRecord> {
        self.find(self.current?)
    }

    /// `GET /v1/models/{name}/versions`
    pub fn list(&self) -> VersionList {
        let item = |one: &VersionRecord| VersionItem {
            version: one.version,
            digest: one.digest.clone(),
            active: Some(one.version) == self.current,
            bytes: one.bytes,
            created_at: one.created_unix_ms.map(rfc3339),
        };
        VersionList { items: self.versions.iter().rev().map(item).collect(), collected: self.collected }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registry::Media;

    const NONE: [u64; 0] = [];

    fn put(record: &mut ModelRecord, version: u64, bytes: u64) -> Vec<u64> {
        let content = ModelText {
            digest: format!("sha256:{version}"),
            media: Media::Toml,
            text: " ".repeat(bytes as usize).into(),
        };
        record.add(version, &content, None);
        record.collect()
    }

    #[test]
    fn the_oldest_versions_are_collected_beyond_the_count_limit() {
        let (mut record, most) = (ModelRecord::default(), LIMITS.model_versions as u64);
        (1..=most).for_each(|version| assert_eq!(put(&mut record, version, 10), NONE));
        assert_eq!(put(&mut record, most + 1, 10), [1]);
        record.current = Some(2); // and the current version stays
        let content = ModelText { digest: String::new(), media: Media::Toml, text: "".into() };
        record.versions.push(VersionRecord { version: most + 2, ..record.versions[0].clone() });
        assert_eq!(record.collect(), [3]);
        assert_eq!((record.collected, record.versions.len() as u64), (2, most));
        assert_eq!(
            record.list().items.iter().filter(|item| item.active).map(|item| item.version).collect::<Vec<_>>(),
            [2]
        );
        record.add(most + 3, &content, None);
        assert_eq!(record.collect(), [2]);
    }

    #[test]
    fn the_oldest_versions_are_collected_beyond_the_byte_limit() {
        let (mut record, half) = (ModelRecord::default(), LIMITS.model_bytes / 2);
        assert_eq!(put(&mut record, 1, half), NONE);
        assert_eq!(put(&mut record, 2, half), NONE);
        assert_eq!(put(&mut record, 3, 1), [1]);
        assert_eq!(put(&mut record, 4, 2 * half + 1), [2, 3], "the current one stays, however long");
        assert_eq!(record.versions.len(), 1);
    }
}
