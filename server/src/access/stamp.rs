//! Detects changed files.

use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::sync::Arc;

use tokio::time::MissedTickBehavior;

use crate::limits::LIMITS;

/// Inode, length and times of a file; `None` if it is absent.
pub type FileStamp = Option<[i64; 6]>;

/// The stamp of the file at `path`.
pub fn stamp(path: &Path) -> FileStamp {
    let about = std::fs::metadata(path).ok()?;
    let number = |number: u64| number as i64;
    Some([
        number(about.ino()),
        number(about.len()),
        about.mtime(),
        about.mtime_nsec(),
        about.ctime(),
        about.ctime_nsec(),
    ])
}

/// Calls `look` at each interval, with its last result, for as long as this is polled.
pub async fn follow<T, S>(reader: Arc<T>, first: S, look: fn(&T, S) -> S)
where
    T: Send + Sync + 'static,
    S: Copy + Send + 'static,
{
    let mut seen = first;
    let mut ticks = tokio::time::interval(LIMITS.token_interval);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        ticks.tick().await;
        let reader = reader.clone();
        // While the disk hangs, the last result stays.
        seen = tokio::task::spawn_blocking(move || look(&reader, seen)).await.unwrap_or(seen);
    }
}
