//! Which cameras there are, and who they are: numbers of devices change when cameras are plugged in again, identities do not.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::CameraError;
use super::controls::{self, ControlInfo};
use super::formats::{self, FormatInfo};
use super::ioctl::Node;

/// Where device nodes are.
pub(super) const DEVICES: &str = "/dev";
/// What the kernel says about them.
const CLASS: &str = "/sys/class/video4linux";

/// A camera, whatever its number.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Identity {
    pub driver: String,
    /// As the device calls itself.
    pub name: String,
    /// Where it is plugged in.
    pub bus: String,
    /// Of USB devices that have one.
    pub serial: Option<String>,
    /// Which of the device's nodes.
    pub index: u32,
}

impl Identity {
    fn of(node: &Node, path: &Path) -> io::Result<Option<Identity>> {
        let about = node.capabilities()?;
        let name = path.file_name().map(|name| Path::new(CLASS).join(name)).unwrap_or_default();
        let read = |file: &str| {
            let text = fs::read_to_string(name.join(file)).ok()?;
            Some(text.trim().to_string()).filter(|text| !text.is_empty())
        };
        let serial = read("device/../serial");
        let index = read("index").and_then(|index| index.parse().ok()).unwrap_or(0);
        let identity = Identity { driver: about.driver, name: about.card, bus: about.bus, serial, index };
        Ok(about.is_camera.then_some(identity))
    }

    /// The same camera in the same or another place: by its serial number, or where it has none by its place.
    fn is(&self, other: &Identity) -> bool {
        let is_alike = self.is_like(other);
        match (&self.serial, &other.serial) {
            (Some(one), Some(two)) => is_alike && one == two,
            _ => is_alike && self.bus == other.bus,
        }
    }

    fn is_like(&self, other: &Identity) -> bool {
        self.driver == other.driver && self.name == other.name && self.index == other.index
    }

    /// What documents call it: its name with serial number or place, in small letters, digits and dashes.
    pub fn key(&self) -> String {
        let which = self.serial.as_ref().unwrap_or(&self.bus);
        let mut key = format!("{} {which}", self.name);
        if self.index > 0 {
            key += &format!(" {}", self.index);
        }
        let plain = key.chars().map(|c| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '-' });
        let plain: String = plain.collect();
        plain.split('-').filter(|part| !part.is_empty()).collect::<Vec<_>>().join("-")
    }
}

/// An open camera.
pub(super) struct Found {
    pub node: Node,
    pub path: PathBuf,
    pub identity: Identity,
}

/// A camera of this machine, with what it offers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraInfo {
    /// Its device node, today.
    pub device: String,
    /// Its name for documents, which stays when it is plugged in again.
    pub identity: String,
    /// As the device calls itself.
    pub name: String,
    /// Of the kernel.
    pub driver: String,
    /// Where it is plugged in.
    pub bus: String,
    /// Of USB devices that have one.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub serial: Option<String>,
    /// What it can send.
    pub formats: Vec<FormatInfo>,
    /// What can be set, with present values.
    pub controls: Vec<ControlInfo>,
}

/// All cameras of this machine, by number. Devices that cannot be opened are left out: they are nothing that could be used.
pub fn cameras() -> Vec<CameraInfo> {
    all().into_iter().map(|found| describe(&found)).collect()
}

/// One camera, by path or identity.
///
/// # Errors
/// When there is no such camera; the error lists those that there are.
pub fn camera(device: &str) -> Result<CameraInfo, CameraError> {
    Ok(describe(&named(device)?))
}

fn describe(found: &Found) -> CameraInfo {
    let Identity { driver, name, bus, serial, .. } = found.identity.clone();
    CameraInfo {
        device: found.path.display().to_string(),
        identity: found.identity.key(),
        name,
        driver,
        bus,
        serial,
        formats: formats::offered(&found.node),
        controls: controls::of(&found.node),
    }
}

/// The camera that a document names: a path, or an identity.
pub(super) fn named(device: &str) -> Result<Found, CameraError> {
    if device.starts_with('/') {
        let fault = |reason: io::Error| match reason.kind() {
            io::ErrorKind::NotFound => missing(device),
            _ => CameraError::Io { device: device.into(), doing: "opened", reason },
        };
        // What stands in /dev/v4l/by-id points to a device node.
        let path = fs::canonicalize(device).map_err(fault)?;
        let node = Node::open(&path).map_err(fault)?;
        let not = |_| CameraError::NotACamera { device: device.into() };
        let identity = Identity::of(&node, &path).map_err(not)?;
        let identity = identity.ok_or_else(|| CameraError::NotACamera { device: device.into() })?;
        return Ok(Found { node, path, identity });
    }
    all().into_iter().find(|found| found.identity.key() == device).ok_or_else(|| missing(device))
}

/// A camera that was there before; `None` while it is not there. One without a serial number is found in another place
/// when there is no other like it.
pub(super) fn again(identity: &Identity) -> Option<Found> {
    let mut all = all();
    let at = all.iter().position(|found| found.identity.is(identity)).or_else(|| {
        let mut alike = (0..all.len()).filter(|at| all[*at].identity.is_like(identity));
        let first = alike.next()?;
        (identity.serial.is_none() && alike.next().is_none()).then_some(first)
    })?;
    Some(all.swap_remove(at))
}

fn missing(device: &str) -> CameraError {
    CameraError::Missing { device: device.into(), present: present() }
}

/// For people: what is plugged in.
pub(super) fn present() -> Vec<String> {
    all().iter().map(|found| format!("{} ({})", found.path.display(), found.identity.key())).collect()
}

fn all() -> Vec<Found> {
    let number = |path: &Path| path.file_name()?.to_str()?.strip_prefix("video")?.parse::<u32>().ok();
    let entries = fs::read_dir(DEVICES).into_iter().flatten().flatten();
    let mut paths: Vec<(u32, PathBuf)> =
        entries.filter_map(|entry| Some((number(&entry.path())?, entry.path()))).collect();
    paths.sort();
    let open = |path: PathBuf| {
        let node = Node::open(&path).ok()?;
        let identity = Identity::of(&node, &path).ok()??;
        Some(Found { node, path, identity })
    };
    paths.into_iter().filter_map(|(_, path)| open(path)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn identity(serial: Option<&str>, bus: &str) -> Identity {
        Identity {
            driver: "uvcvideo".into(),
            name: "Rig camera: Rig".into(),
            bus: bus.into(),
            serial: serial.map(str::to_string),
            index: 0,
        }
    }

    #[test]
    fn a_serial_number_goes_with_the_camera_a_place_does_not() {
        let (one, two) = (identity(Some("0001"), "usb-1"), identity(Some("0002"), "usb-1"));
        assert!(one.is(&identity(Some("0001"), "usb-2")) && !one.is(&two));
        assert!(identity(None, "usb-1").is(&identity(None, "usb-1")));
        assert!(!identity(None, "usb-1").is(&identity(None, "usb-2")));
        assert!(!one.is(&Identity { index: 1, ..one.clone() }));
        assert_eq!(one.key(), "rig-camera-rig-0001");
        assert_eq!(
            Identity { index: 1, ..identity(None, "usb-0000:00.1-3") }.key(),
            "rig-camera-rig-usb-0000-00-1-3-1"
        );
    }
}
