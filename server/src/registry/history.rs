//! The versions of a name, and which of them is the model of that name.

use isophote_machine::rfc3339;
use isophote_wire::{VersionItem, VersionList};
use serde::{Deserialize, Serialize};

use super::entry::ModelText;
use crate::limits::LIMITS;

/// What is kept of a name. Without a version: a shipped model that was removed, and stays away.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ModelRecord {
    /// The version that has the name.
    pub current: Option<u64>,
    /// The newest that there ever was.
    pub last: u64,
    /// How many were left out, because they were too many.
    pub collected: u64,
    /// Oldest first.
    pub versions: Vec<VersionRecord>,
}

/// One version.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct VersionRecord {
    /// Counts the documents put under the name.
    pub version: u64,
    /// Of the canonical document.
    pub digest: String,
    /// Where its content is kept.
    pub content: String,
    /// Of its text.
    pub bytes: u64,
    /// When it was put, ms since 1970; nothing of one that is shipped, or older than its history.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub created_unix_ms: Option<u64>,
}

impl ModelRecord {
    /// A new version, which has the name from now on.
    pub fn add(&mut self, version: u64, content: &ModelText, created_unix_ms: Option<u64>) {
        let (digest, bytes) = (content.digest.clone(), content.text.len() as u64);
        self.versions.push(VersionRecord { version, digest, content: content.key(), bytes, created_unix_ms });
        self.current = Some(version);
        self.last = version;
    }

    /// Leaves out the oldest versions for as long as there are too many, but never the one that has the name; says which.
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

    /// A version that is kept.
    pub fn find(&self, version: u64) -> Option<&VersionRecord> {
        self.versions.iter().find(|one| one.version == version)
    }

    /// The version that has the name.
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
    fn the_oldest_go_when_there_are_too_many() {
        let (mut record, most) = (ModelRecord::default(), LIMITS.model_versions as u64);
        (1..=most).for_each(|version| assert_eq!(put(&mut record, version, 10), NONE));
        assert_eq!(put(&mut record, most + 1, 10), [1]);
        record.current = Some(2); // and what has the name stays
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
    fn and_when_they_are_too_long() {
        let (mut record, half) = (ModelRecord::default(), LIMITS.model_bytes / 2);
        assert_eq!(put(&mut record, 1, half), NONE);
        assert_eq!(put(&mut record, 2, half), NONE);
        assert_eq!(put(&mut record, 3, 1), [1]);
        assert_eq!(put(&mut record, 4, 2 * half + 1), [2, 3], "the current one stays, however long");
        assert_eq!(record.versions.len(), 1);
    }
}
