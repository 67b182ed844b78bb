//! `DeviceWatch`: reports that devices appeared or disappeared.

use std::io;

use rustix::fd::{AsFd, BorrowedFd, OwnedFd};
use rustix::fs::inotify::{self, CreateFlags, WatchFlags};

use super::device::DEVICES;

/// inotify watch on `/dev`.
pub(super) struct DeviceWatch(OwnedFd);

impl DeviceWatch {
    /// Starts watching.
    pub fn new() -> io::Result<DeviceWatch> {
        let watch = inotify::init(CreateFlags::CLOEXEC | CreateFlags::NONBLOCK)?;
        // Nodes are created first and get their permissions later.
        inotify::add_watch(&watch, DEVICES, WatchFlags::CREATE | WatchFlags::ATTRIB | WatchFlags::DELETE)?;
        Ok(DeviceWatch(watch))
    }

    /// Whether something has changed since the last call.
    pub fn has_changed(&self) -> bool {
        let mut events = [0; 4096];
        let mut changed = false;
        while rustix::io::read(&self.0, &mut events).is_ok_and(|bytes| bytes > 0) {
            changed = true;
        }
        changed
    }
}

impl AsFd for DeviceWatch {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.0.as_fd()
    }
}
