//! Which cameras there are, and who they are: numbers of devices change when cameras are plugged in again, identities do not.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::asking::{Asking, Heard};
use super::controls::{self, ControlInfo};
use super::error::CameraError;
use super::formats::{self, FormatInfo};
use super::ioctl::DeviceNode;

/// Where device nodes are.
pub(super) const DEVICES: &str = "/dev";
/// What the kernel says about them.
const CLASS: &str = "/sys/class/video4linux";

/// How often a camera is looked for that is listed and has no path, …
const LOOKS: usize = 10;
/// … and how long is waited before each further look.
const SETTLING: Duration = Duration::from_millis(50);
/// For a device to say who it is.
static ASKING: Asking = Asking::new(Duration::from_secs(2));

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
    fn of(node: &DeviceNode, path: &Path) -> io::Result<Option<Identity>> {
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

    /// Another one of the same make, or the same one in another place.
    fn is_like(&self, other: &Identity) -> bool {
        (&self.driver, &self.name, &self.serial, self.index) == (&other.driver, &other.name, &other.serial, other.index)
    }

    /// What documents call it: its name with serial number or place, in small letters, digits and dashes. Where several have
    /// one serial number, the place says which.
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
    /// Those that are like it.
    pub others: Vec<Identity>,
    /// What documents call it.
    pub key: String,
}

/// A camera of this machine, with what it offers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
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

/// All cameras of this machine, by number. Devices that cannot be opened, or do not answer, are left out: they are nothing that
/// could be used.
pub fn cameras() -> Vec<CameraInfo> {
    Present::now().cameras.into_iter().map(|found| describe(&found)).collect()
}

/// One camera, by path or identity.
///
/// # Errors
/// When there is no such camera, where the error lists those that there are, or it does not answer.
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

/// The camera that a document names: a path, or an identity. While its node is being made a camera may be listed whose path is
/// not there yet: that is waited for.
pub(super) fn named(device: &str) -> Result<OpenCamera, CameraError> {
    let is_listed = |one: &String| one.strip_prefix(device).is_some_and(|rest| rest.starts_with(" ("));
    for _ in 1..LOOKS {
        match named_now(device) {
            Err(CameraError::Missing { present, .. }) if present.iter().any(is_listed) => {
                thread::park_timeout(SETTLING)
            }
            found => return found,
        }
    }
    named_now(device)
}

fn named_now(device: &str) -> Result<OpenCamera, CameraError> {
    let mut present = Present::now();
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
    // What stands in /dev/v4l/by-id points to a device node.
    let path = fs::canonicalize(device).map_err(fault)?;
    if present.silent.contains(&path) {
        return Err(CameraError::Silent { device: device.into() });
    }
    match present.cameras.iter().position(|found| found.path == path) {
        Some(at) => Ok(present.cameras.swap_remove(at)),
        // Not among the cameras: the device itself says why.
        None => Err(DeviceNode::open(&path).map_or_else(fault, |_| CameraError::NotACamera { device: device.into() })),
    }
}

/// A camera that was there before: the same in the same place, else the only one like it that is not one of `others`, which
/// were there together with it.
///
/// # Errors
/// While it is not there, or does not answer.
pub(super) fn again(identity: &Identity, others: &[Identity], key: &str) -> Result<OpenCamera, CameraError> {
    let mut present = Present::now();
    let identities: Vec<Identity> = present.cameras.iter().map(|found| found.identity.clone()).collect();
    let at = place(&identities, identity, others).ok_or_else(|| present.missing(key))?;
    Ok(present.cameras.swap_remove(at))
}

fn place(all: &[Identity], identity: &Identity, others: &[Identity]) -> Option<usize> {
    all.iter().position(|one| one == identity).or_else(|| {
        let mut moved = (0..all.len()).filter(|at| all[*at].is_like(identity) && !others.contains(&all[*at]));
        let first = moved.next()?;
        moved.next().is_none().then_some(first)
    })
}

/// What there is at a time.
struct Present {
    cameras: Vec<OpenCamera>,
    /// Devices that do not answer: any camera may be behind them.
    silent: Vec<PathBuf>,
}

impl Present {
    fn now() -> Present {
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
        for (path, answer) in paths.iter().cloned().zip(ASKING.ask(&paths, open)) {
            match answer {
                Heard::Said(Some((node, identity))) => opened.push((node, path, identity)),
                Heard::Said(None) => {}
                Heard::Silent => silent.push(path),
            }
        }
        let identities: Vec<Identity> = opened.iter().map(|(_, _, identity)| identity.clone()).collect();
        let found = opened.into_iter().map(|(node, path, identity)| {
            let others = identities.iter().filter(|other| **other != identity && other.is_like(&identity));
            let others: Vec<Identity> = others.cloned().collect();
            OpenCamera { key: identity.key(&others), node, path, identity, others }
        });
        Present { cameras: found.collect(), silent }
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
    fn a_camera_is_found_where_it_was_and_where_it_went() {
        for serial in [Some("0001"), None] {
            let (here, there) = (identity(serial, "usb-1"), identity(serial, "usb-2"));
            assert_eq!(place(&[there.clone(), here.clone()], &here, &[]), Some(1), "in its place");
            assert_eq!(place(std::slice::from_ref(&there), &here, &[]), Some(0), "moved");
            assert_eq!(
                place(std::slice::from_ref(&there), &here, std::slice::from_ref(&there)),
                None,
                "that is the other one"
            );
            let third = identity(serial, "usb-3");
            assert_eq!(place(&[there.clone(), third.clone()], &here, &[]), None, "nobody knows which");
            assert_eq!(place(&[there.clone(), third], &here, &[there]), Some(1), "not the one that was there before");
        }
        let other = identity(Some("0002"), "usb-1");
        assert_eq!(place(&[other], &identity(Some("0001"), "usb-1"), &[]), None, "another serial number in its place");
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
