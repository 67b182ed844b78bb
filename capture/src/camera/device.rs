//! Camera enumeration and identity: device numbers change when cameras are plugged in again, identities do not.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::controls::{self, ControlInfo};
use super::error::CameraError;
use super::formats::{self, FormatInfo};
use super::ioctl::DeviceNode;
use super::queries::{DeviceQueries, QueryAnswer};

/// Directory of the device nodes.
pub(super) const DEVICES: &str = "/dev";
/// sysfs directory with the kernel's attributes of each device.
const CLASS: &str = "/sys/class/video4linux";

/// Attempts to find a listed camera whose path does not exist yet.
const FIND_ATTEMPTS: usize = 10;
/// Delay between attempts to find a listed camera.
const FIND_DELAY: Duration = Duration::from_millis(50);
/// Identity queries, with their time limit.
static QUERIES: DeviceQueries = DeviceQueries::new(Duration::from_secs(2));

/// Identifies a camera independently of its device number.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Identity {
    pub driver: String,
    /// Name that the device reports.
    pub name: String,
    /// Bus position.
    pub bus: String,
    /// USB serial number, if any.
    pub serial: Option<String>,
    /// Index among the device's nodes.
    pub index: u32,
}

impl Identity {
    fn of(node: &DeviceNode, path: &Path) -> io::Result<Option<Identity>> {
        let capabilities = node.capabilities()?;
        let name = path.file_name().map(|name| Path::new(CLASS).join(name)).unwrap_or_default();
        let read = |file: &str| {
            let text = fs::read_to_string(name.join(file)).ok()?;
            Some(text.trim().to_string()).filter(|text| !text.is_empty())
        };
        let serial = read("device/../serial");
        let index = read("index").and_then(|index| index.parse().ok()).unwrap_or(0);
        let identity =
            Identity { driver: capabilities.driver, name: capabilities.card, bus: capabilities.bus, serial, index };
        Ok(capabilities.is_camera.then_some(identity))
    }

    /// Equal but for the bus position: the same camera moved, or another of the same model.
    fn is_like(&self, other: &Identity) -> bool {
        (&self.driver, &self.name, &self.serial, self.index) == (&other.driver, &other.name, &other.serial, other.index)
    }

    /// Key for documents: name plus serial number or bus position, in lower-case letters, digits and dashes. If several
    /// cameras share a serial number, the bus position is added.
    fn key(&self, others: &[Identity]) -> String {
        let which = match &self.serial {
            Some(serial) if others.is_empty() => serial.clone(),
            Some(serial) => format!("{serial} {}", self.bus),
            None => self.bus.clone(),
        };
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
pub(super) struct OpenCamera {
    pub node: DeviceNode,
    pub path: PathBuf,
    pub identity: Identity,
    /// Present cameras that equal it but for the bus position.
    pub others: Vec<Identity>,
    /// Key for documents.
    pub key: String,
}

/// A camera of this machine, with its formats and controls.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct CameraInfo {
    /// Present device node.
    pub device: String,
    /// Name for documents; unchanged when the camera is plugged in again.
    pub identity: String,
    /// Name that the device reports.
    pub name: String,
    /// Kernel driver.
    pub driver: String,
    /// Bus position.
    pub bus: String,
    /// USB serial number, if any.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub serial: Option<String>,
    /// Supported formats.
    pub formats: Vec<FormatInfo>,
    /// Controls with present values.
    pub controls: Vec<ControlInfo>,
}

/// All cameras of this machine, by device number. Devices that cannot be opened or do not answer are omitted.
pub fn cameras() -> Vec<CameraInfo> {
    PresentDevices::now().cameras.into_iter().map(|found| describe(&found)).collect()
}

/// One camera, by path or identity.
///
/// # Errors
/// If there is no such camera (the error lists those present), or it does not answer.
pub fn camera(device: &str) -> Result<CameraInfo, CameraError> {
    Ok(describe(&named(device)?))
}

fn describe(found: &OpenCamera) -> CameraInfo {
    let Identity { driver, name, bus, serial, .. } = found.identity.clone();
    CameraInfo {
        device: found.path.display().to_string(),
        identity: found.key.clone(),
        name,
        driver,
        bus,
        serial,
        formats: formats::offered(&found.node),
        controls: controls::of(&found.node),
    }
}

/// Finds the camera that a document names by path or identity. While its node is being created, a camera may be listed
/// before its path resolves; this function retries.
pub(super) fn named(device: &str) -> Result<OpenCamera, CameraError> {
    let is_listed = |one: &String| one.strip_prefix(device).is_some_and(|rest| rest.starts_with(" ("));
    for _ in 1..FIND_ATTEMPTS {
        match named_now(device) {
            Err(CameraError::Missing { present, .. }) if present.iter().any(is_listed) => {
                thread::park_timeout(FIND_DELAY)
            }
            found => return found,
        }
    }
    named_now(device)
}

fn named_now(device: &str) -> Result<OpenCamera, CameraError> {
    let mut present = PresentDevices::now();
    if !device.starts_with('/') {
        let at = present.cameras.iter().position(|found| found.key == device);
        let at = at.ok_or_else(|| present.missing(device))?;
        return Ok(present.cameras.swap_remove(at));
    }
    let fault = |reason: io::Error| match reason.kind() {
        io::ErrorKind::NotFound => present.missing(device),
        io::ErrorKind::InvalidInput => CameraError::NotACamera { device: device.into() },
        io::ErrorKind::PermissionDenied => CameraError::Forbidden { device: device.into() },
        io::ErrorKind::ResourceBusy => CameraError::Busy { device: device.into() },
        _ => CameraError::Io { device: device.into(), doing: "opened", reason },
    };
    // Links in /dev/v4l/by-id point to a device node.
    let path = fs::canonicalize(device).map_err(fault)?;
    if present.silent.contains(&path) {
        return Err(CameraError::Silent { device: device.into() });
    }
    match present.cameras.iter().position(|found| found.path == path) {
        Some(at) => Ok(present.cameras.swap_remove(at)),
        // Not among the cameras: opening the device gives the reason.
        None => Err(DeviceNode::open(&path).map_or_else(fault, |_| CameraError::NotACamera { device: device.into() })),
    }
}

/// Finds a camera again: at the same bus position, else the only one that equals it but for the position and is not in
/// `others`, which were present together with it.
///
/// # Errors
/// If it is absent or does not answer.
pub(super) fn again(identity: &Identity, others: &[Identity], key: &str) -> Result<OpenCamera, CameraError> {
    let mut present = PresentDevices::now();
    let identities: Vec<Identity> = present.cameras.iter().map(|found| found.identity.clone()).collect();
    let at = find_identity(&identities, identity, others).ok_or_else(|| present.missing(key))?;
    Ok(present.cameras.swap_remove(at))
}

fn find_identity(all: &[Identity], identity: &Identity, others: &[Identity]) -> Option<usize> {
    all.iter().position(|one| one == identity).or_else(|| {
        let mut moved = (0..all.len()).filter(|at| all[*at].is_like(identity) && !others.contains(&all[*at]));
        let first = moved.next()?;
        moved.next().is_none().then_some(first)
    })
}

/// Snapshot of the present devices.
struct PresentDevices {
    cameras: Vec<OpenCamera>,
    /// Devices that do not answer; each may be a camera.
    silent: Vec<PathBuf>,
}

impl PresentDevices {
    fn now() -> PresentDevices {
        let number = |path: &Path| path.file_name()?.to_str()?.strip_prefix("video")?.parse::<u32>().ok();
        let entries = fs::read_dir(DEVICES).into_iter().flatten().flatten();
        let mut paths: Vec<(u32, PathBuf)> =
            entries.filter_map(|entry| Some((number(&entry.path())?, entry.path()))).collect();
        paths.sort();
        let paths: Vec<PathBuf> = paths.into_iter().map(|(_, path)| path).collect();
        let open = |path: &Path| {
            let node = DeviceNode::open(path).ok()?;
            let identity = Identity::of(&node, path).ok()??;
            Some((node, identity))
        };
        let (mut opened, mut silent) = (Vec::new(), Vec::new());
        for (path, answer) in paths.iter().cloned().zip(QUERIES.query(&paths, open)) {
            match answer {
                QueryAnswer::Answered(Some((node, identity))) => opened.push((node, path, identity)),
                QueryAnswer::Answered(None) => {}
                QueryAnswer::Silent => silent.push(path),
            }
        }
        let identities: Vec<Identity> = opened.iter().map(|(_, _, identity)| identity.clone()).collect();
        let found = opened.into_iter().map(|(node, path, identity)| {
            let others = identities.iter().filter(|other| **other != identity && other.is_like(&identity));
            let others: Vec<Identity> = others.cloned().collect();
            OpenCamera { key: identity.key(&others), node, path, identity, others }
        });
        PresentDevices { cameras: found.collect(), silent }
    }

    fn missing(&self, device: &str) -> CameraError {
        let names = |paths: &[PathBuf]| paths.iter().map(|path| path.display().to_string()).collect::<Vec<_>>();
        if !self.silent.is_empty() && !device.starts_with('/') {
            return CameraError::Silent { device: names(&self.silent).join(", ") };
        }
        let camera = |found: &OpenCamera| format!("{} ({})", found.path.display(), found.key);
        CameraError::Missing { device: device.into(), present: self.cameras.iter().map(camera).collect() }
    }
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
    fn a_camera_is_found_in_place_and_after_moving() {
        for serial in [Some("0001"), None] {
            let (here, there) = (identity(serial, "usb-1"), identity(serial, "usb-2"));
            assert_eq!(find_identity(&[there.clone(), here.clone()], &here, &[]), Some(1), "in its place");
            assert_eq!(find_identity(std::slice::from_ref(&there), &here, &[]), Some(0), "moved");
            assert_eq!(
                find_identity(std::slice::from_ref(&there), &here, std::slice::from_ref(&there)),
                None,
                "that is the other one"
            );
            let third = identity(serial, "usb-3");
            assert_eq!(find_identity(&[there.clone(), third.clone()], &here, &[]), None, "nobody knows which");
            assert_eq!(
                find_identity(&[there.clone(), third], &here, &[there]),
                Some(1),
                "not the one that was there before"
            );
        }
        let other = identity(Some("0002"), "usb-1");
        assert_eq!(
            find_identity(&[other], &identity(Some("0001"), "usb-1"), &[]),
            None,
            "another serial number in its place"
        );
    }

    #[test]
    fn keys_are_unique() {
        let one = identity(Some("0001"), "usb-1");
        assert_eq!(one.key(&[]), "rig-camera-rig-0001");
        assert_eq!(one.key(&[identity(Some("0001"), "usb-2")]), "rig-camera-rig-0001-usb-1");
        let node = Identity { index: 1, ..identity(None, "usb-0000:00.1-3") };
        assert_eq!(node.key(&[]), "rig-camera-rig-usb-0000-00-1-3-1");
    }
}
