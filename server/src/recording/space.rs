//! `RecordingSpace`: limits the bytes of recordings, finished ones included, by the operator's quotas and the free disk space.
//!
//! Each tenant has a [`TenantSpace`] of it. Files changed from outside the service are counted when a file is begun or ends,
//! and before a request is refused.

use std::collections::BTreeMap;
use std::fs;
use std::io::{Error, ErrorKind};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock, Weak};

use super::folder::FileName;

const MB: u64 = 1_000_000;
/// Budget: free space that recordings leave by default, as the reciprocal share of the file system, for the store, logs and the
/// operator.
const FREE_SHARE: u64 = 20;
/// Budget: upper bound of that default, MB.
const FREE_MB_MOST: u64 = 1000;
/// Budget: bytes granted to an open file beyond its current need, so that few of its notes query the disk.
const GRANT_BYTES: u64 = 1 << 20;

/// Disk space that recordings may take, in units of 10⁶ bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RecordingQuota {
    /// Of each tenant; default: an equal share of the space for all.
    pub tenant_mb: Option<u64>,
    /// Of all tenants; default: limited by the disk.
    pub all_mb: Option<u64>,
    /// Free space that recordings leave, in MB; default: a twentieth of the file system, at most 1000.
    pub free_mb: Option<u64>,
}

/// The bound that recordings have reached.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SpaceFault {
    /// The tenant's.
    #[error(
        "recordings of this tenant may take {0} MB, finished ones included, and that is used up; delete some of them"
    )]
    Tenant(u64),
    /// All tenants'.
    #[error("all recordings of this service may take {0} MB, finished ones included, and that is used up")]
    All(u64),
    /// The disk's.
    #[error(
        "the disk has {free_mb} MB free, and {more_mb} MB more would not leave {least_mb} MB free; delete recordings"
    )]
    Free {
        /// Free space.
        free_mb: u64,
        /// The requested bytes.
        more_mb: u64,
        /// Free space to be left.
        least_mb: u64,
    },
}

/// Capacity of a file system.
#[derive(Clone, Copy, Debug)]
pub struct DiskBytes {
    /// Total bytes.
    pub all: u64,
    /// Bytes available to this process.
    pub free: u64,
}

fn disk_bytes(folder: &Path) -> Result<DiskBytes, Error> {
    let found = rustix::fs::statvfs(folder)?;
    let bytes = |blocks: u64| blocks.saturating_mul(found.f_frsize);
    Ok(DiskBytes { all: bytes(found.f_blocks), free: bytes(found.f_bavail) })
}

/// Queries a file system's free space.
type Disk = dyn Fn(&Path) -> Result<DiskBytes, Error> + Send + Sync;

/// The space of one service.
pub struct RecordingSpace {
    quota: RecordingQuota,
    tenants: RwLock<Vec<Weak<TenantSpace>>>,
    disk: Box<Disk>,
}

/// The space of one tenant.
pub struct TenantSpace {
    all: Arc<RecordingSpace>,
    ledger: Mutex<Ledger>,
    /// The ledger's sum, for other threads.
    bytes: AtomicU64,
}

#[derive(Default)]
struct Ledger {
    /// Bytes of all files in the folder except open ones.
    finished: u64,
    /// Open files with their tables, and the bytes granted to them.
    open: BTreeMap<FileName, u64>,
}

impl RecordingSpace {
    /// A space with those quotas.
    pub fn new(quota: RecordingQuota) -> Arc<RecordingSpace> {
        RecordingSpace::on(Box::new(disk_bytes), quota)
    }

    fn on(disk: Box<Disk>, quota: RecordingQuota) -> Arc<RecordingSpace> {
        Arc::new(RecordingSpace { quota, tenants: RwLock::default(), disk })
    }

    /// Adds a tenant.
    pub fn part(self: &Arc<Self>) -> Arc<TenantSpace> {
        let part = TenantSpace { all: self.clone(), ledger: Mutex::default(), bytes: AtomicU64::new(0) };
        let part = Arc::new(part);
        let mut tenants = self.tenants.write().unwrap_or_else(PoisonError::into_inner);
        tenants.retain(|tenant| tenant.strong_count() > 0);
        tenants.push(Arc::downgrade(&part));
        part
    }

    /// Bytes of all tenants, and the number of tenants.
    fn bytes(&self) -> (u64, u64) {
        let tenants = self.tenants.read().unwrap_or_else(PoisonError::into_inner);
        let each: Vec<u64> = tenants.iter().filter_map(Weak::upgrade).map(|tenant| tenant.bytes()).collect();
        (each.iter().sum(), each.len().max(1) as u64)
    }
}

impl TenantSpace {
    fn lock(&self) -> MutexGuard<'_, Ledger> {
        self.ledger.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Bytes of its recordings, as last counted.
    pub fn bytes(&self) -> u64 {
        self.bytes.load(Ordering::SeqCst)
    }

    /// Grants an open file of `written` bytes `more` bytes; returns the length up to which it may grow, [`GRANT_BYTES`] further
    /// than that if space permits.
    ///
    /// # Errors
    /// The exceeded bound, or a failure to query the disk.
    pub fn grow(
        &self,
        folder: &Path,
        name: &FileName,
        written: u64,
        more: u64,
    ) -> Result<Result<u64, SpaceFault>, Error> {
        let disk = (self.all.disk)(folder)?;
        let mut ledger = self.lock();
        let grant = |ledger: &mut Ledger, more: u64| {
            ledger.open.insert(name.clone(), written + more);
            self.allowed(ledger, disk, more).map(|()| written + more)
        };
        let mut granted = Ok(grant(&mut ledger, more + GRANT_BYTES).or_else(|_| grant(&mut ledger, more)));
        if let Ok(Err(_)) = granted {
            granted = self.scan(&mut ledger, folder).map(|()| grant(&mut ledger, more));
        }
        if !matches!(granted, Ok(Ok(_))) {
            ledger.open.insert(name.clone(), written);
            self.note(&ledger);
        }
        granted
    }

    fn allowed(&self, ledger: &Ledger, disk: DiskBytes, more: u64) -> Result<(), SpaceFault> {
        let RecordingQuota { tenant_mb, all_mb, free_mb } = self.all.quota;
        let own = self.note(ledger);
        let (all, tenants) = self.all.bytes();
        let least = free_mb.map_or((disk.all / FREE_SHARE).min(FREE_MB_MOST * MB), |mb| mb.saturating_mul(MB));
        let room = disk.free.saturating_sub(least);
        let all_most = all_mb.map_or(u64::MAX, |mb| mb.saturating_mul(MB));
        let part = || all_most.min(all.saturating_sub(more).saturating_add(room)) / tenants;
        let own_most = tenant_mb.map_or_else(part, |mb| mb.saturating_mul(MB));
        if more > room {
            let (more_mb, least_mb) = (more.div_ceil(MB), least.div_ceil(MB));
            Err(SpaceFault::Free { free_mb: disk.free / MB, more_mb, least_mb })
        } else if all > all_most {
            Err(SpaceFault::All(all_most / MB))
        } else if own > own_most {
            Err(SpaceFault::Tenant(own_most / MB))
        } else {
            Ok(())
        }
    }

    /// Records that an open file was finished or removed.
    pub fn ended(&self, folder: &Path, name: &FileName) -> Result<(), Error> {
        let mut ledger = self.lock();
        ledger.open.remove(name);
        self.scan(&mut ledger, folder)
    }

    /// Counts the files again.
    pub fn count(&self, folder: &Path) -> Result<(), Error> {
        self.scan(&mut self.lock(), folder)
    }

    fn scan(&self, ledger: &mut Ledger, folder: &Path) -> Result<(), Error> {
        let entries = match fs::read_dir(folder) {
            Err(error) if error.kind() == ErrorKind::NotFound => None,
            entries => Some(entries?),
        };
        let is_open = |name: &str| ledger.open.keys().any(|open| open.is_of(name));
        let finished = entries.into_iter().flatten().filter_map(Result::ok);
        let finished = finished.filter(|entry| !entry.file_name().to_str().is_some_and(is_open));
        // Links are not followed: files elsewhere are not counted.
        ledger.finished = finished.filter_map(|entry| entry.metadata().ok()).map(|about| about.len()).sum();
        self.note(ledger);
        Ok(())
    }

    /// Publishes and returns the sum.
    fn note(&self, ledger: &Ledger) -> u64 {
        let bytes = ledger.finished.saturating_add(ledger.open.values().sum());
        self.bytes.store(bytes, Ordering::SeqCst);
        bytes
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// A test's temporary folder.
    struct Place(std::path::PathBuf);

    impl Place {
        fn new(name: &str) -> Place {
            let folder = std::env::temp_dir().join(format!("isophote-space-{name}-{}", std::process::id()));
            fs::create_dir_all(&folder).unwrap();
            Place(folder)
        }

        fn put(&self, name: &str, mb: u64) {
            fs::File::create(self.0.join(name)).unwrap().set_len(mb * MB).unwrap();
        }
    }

    impl Drop for Place {
        fn drop(&mut self) {
            drop(fs::remove_dir_all(&self.0));
        }
    }

    fn name(stem: &str) -> FileName {
        FileName::of(stem, 1).unwrap()
    }

    fn space(quota: RecordingQuota, free_mb: &Arc<AtomicU64>) -> Arc<RecordingSpace> {
        let free = free_mb.clone();
        let disk = move |_: &Path| Ok(DiskBytes { all: 100_000 * MB, free: free.load(Ordering::SeqCst) * MB });
        RecordingSpace::on(Box::new(disk), quota)
    }

    /// Grows a file of `written` MB by `more` MB.
    fn grown(tenant: &TenantSpace, place: &Place, stem: &str, [written, more]: [u64; 2]) -> Result<u64, SpaceFault> {
        tenant.grow(&place.0, &name(stem), written * MB, more * MB).unwrap()
    }

    #[test]
    fn finished_files_count_until_deleted() {
        let (place, free) = (Place::new("finished"), Arc::new(AtomicU64::new(90_000)));
        let quota = RecordingQuota { tenant_mb: Some(100), ..RecordingQuota::default() };
        let tenant = space(quota, &free).part();
        place.put("old-0001.mcap", 60);
        place.put("old-0001.csv", 10);
        let grow = |stem: &str, written, more| grown(&tenant, &place, stem, [written, more]).map(drop);
        tenant.count(&place.0).unwrap();
        assert_eq!(grow("new", 0, 30), Ok(()));
        assert_eq!(grow("new", 0, 31), Err(SpaceFault::Tenant(100)));
        assert_eq!(grow("new", 20, 10), Ok(()));
        assert_eq!(grow("other", 0, 1), Err(SpaceFault::Tenant(100)), "open files of the same tenant count as well");
        // The open file is counted once, and files deleted by hand are noticed.
        place.put("new-0001.part.mcap", 20);
        fs::remove_file(place.0.join("old-0001.csv")).unwrap();
        assert_eq!(grow("new", 20, 20), Ok(()));
        fs::rename(place.0.join("new-0001.part.mcap"), place.0.join("new-0001.mcap")).unwrap();
        tenant.ended(&place.0, &name("new")).unwrap();
        assert_eq!(tenant.bytes(), 80 * MB);
        assert_eq!((grow("next", 0, 20), grow("next", 0, 21)), (Ok(()), Err(SpaceFault::Tenant(100))));
    }

    #[test]
    fn total_quota_is_shared_between_tenants() {
        let (one, two) = (Place::new("one"), Place::new("two"));
        let free = Arc::new(AtomicU64::new(90_000));
        let space = space(RecordingQuota { all_mb: Some(100), tenant_mb: Some(80), free_mb: None }, &free);
        let (first, second) = (space.part(), space.part());
        let grow = |tenant: &TenantSpace, place: &Place, mb| grown(tenant, place, "a", [0, mb]).map(drop);
        assert_eq!(grow(&first, &one, 81), Err(SpaceFault::Tenant(80)));
        assert_eq!((grow(&first, &one, 80), grow(&second, &two, 20)), (Ok(()), Ok(())));
        assert_eq!(grow(&second, &two, 21), Err(SpaceFault::All(100)));
        // Without a quota per tenant.
        for (all_mb, part_mb) in [(Some(100), 50), (None, 44_500)] {
            let space = self::space(RecordingQuota { all_mb, ..RecordingQuota::default() }, &free);
            let (first, _second) = (space.part(), space.part());
            assert_eq!(grow(&first, &one, part_mb), Ok(()), "{all_mb:?}");
            assert_eq!(grow(&first, &one, part_mb + 1), Err(SpaceFault::Tenant(part_mb)));
        }
    }

    #[test]
    fn minimum_free_space_is_kept() {
        let (place, free) = (Place::new("free"), Arc::new(AtomicU64::new(1010)));
        let tenant = space(RecordingQuota::default(), &free).part();
        let grow = |more| grown(&tenant, &place, "a", [0, more]).map(drop);
        assert_eq!(
            (grow(10), grow(11)),
            (Ok(()), Err(SpaceFault::Free { free_mb: 1010, more_mb: 11, least_mb: 1000 }))
        );
        free.store(1005, Ordering::SeqCst);
        assert!(grow(6).is_err() && grow(5).is_ok());
        let tenant = space(RecordingQuota { free_mb: Some(500), ..RecordingQuota::default() }, &free).part();
        let grow = |more| grown(&tenant, &place, "a", [0, more]).map(drop);
        assert_eq!(
            (grow(505), grow(506)),
            (Ok(()), Err(SpaceFault::Free { free_mb: 1005, more_mb: 506, least_mb: 500 }))
        );
    }

    #[test]
    fn growth_is_granted_ahead_of_need() {
        let (place, free) = (Place::new("granted"), Arc::new(AtomicU64::new(90_000)));
        let quota = RecordingQuota { tenant_mb: Some(100), ..RecordingQuota::default() };
        let tenant = space(quota, &free).part();
        for (written, more, granted) in
            [(0, 10, 10 * MB + GRANT_BYTES), (5, 93, 98 * MB + GRANT_BYTES), (90, 9, 99 * MB)]
        {
            assert_eq!(grown(&tenant, &place, "a", [written, more]), Ok(granted));
            assert_eq!(tenant.bytes(), granted, "it is promised");
        }
    }

    #[test]
    fn failed_disk_query_grants_nothing() {
        let place = Place::new("unasked");
        let disk = Box::new(|_: &Path| Err(Error::from(ErrorKind::TimedOut)));
        let tenant = RecordingSpace::on(disk, RecordingQuota::default()).part();
        let error = tenant.grow(&place.0, &name("a"), 0, MB).unwrap_err();
        assert_eq!((error.kind(), tenant.bytes()), (ErrorKind::TimedOut, 0));
        tenant.count(&place.0).unwrap();
        assert_eq!(tenant.bytes(), 0);
    }
}
