//! A software USB camera, driven by the kernel's own uvcvideo.
//!
//! It takes pictures of a [`Scene`] at 640 × 480 and 320 × 240 px, GREY or YUYV, subject to exposure, gain and
//! brightness, and serves the driver over USB/IP by the kernel's vhci-hcd. It can be unplugged, stall, and damage a
//! picture. Tests see it through `/dev/video…` only.
//!
//! ```text
//! driver ─ USB/IP ─► usbip ─► requests ─► State ─► streaming ─► picture ─► USB/IP
//!                      └─► descriptors
//! ```

pub mod commands;
mod controls;
mod descriptors;
mod picture;
mod requests;
mod state;
mod streaming;
mod usbip;

use std::collections::VecDeque;
use std::fs;
use std::io;
use std::net::Shutdown;
use std::os::fd::AsRawFd;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex};
use std::thread::Builder;
use std::time::Duration;

pub use controls::Controls;
pub use picture::{Noise, Scene};
pub use state::Fault;

use crate::rig::until;
use descriptors::Kind;
use state::{Shared, State};

/// Where vhci-hcd attaches a device, and its number of high-speed ports.
const ATTACH: &str = "/sys/devices/platform/vhci_hcd.0/attach";
const PORTS: usize = 8;
/// Bus 1, device 2; the driver ignores the number.
const DEVICE: u32 = 1 << 16 | 2;
/// USB/IP's code of a high-speed device.
const HIGH_SPEED: u32 = 3;
/// Timeout for the driver to create a node.
const NODE_S_MAX: u64 = 20;

/// The camera; unplugged on drop.
pub struct Camera {
    scene: Arc<Scene>,
    noise: Noise,
    numbered: bool,
    plugged: Option<(UnixStream, Arc<Shared>)>,
}

impl Camera {
    /// A camera that sees `scene`, not plugged in yet.
    pub fn new(scene: Scene) -> Camera {
        Camera { scene: Arc::new(scene), noise: Noise::default(), numbered: false, plugged: None }
    }

    /// Plugs it in with default controls and that `serial`, after unplugging it if necessary.
    ///
    /// # Errors
    /// The kernel has no vhci-hcd, or all its ports are in use.
    pub fn plug(&mut self, serial: &str) -> io::Result<()> {
        self.unplug();
        let (ours, theirs) = UnixStream::pair()?;
        let state = State {
            requests: VecDeque::new(),
            kind: Kind::Grey,
            size: descriptors::SIZES[0],
            interval: descriptors::INTERVAL,
            controls: Controls::default(),
            scene: self.scene.clone(),
            noise: self.noise,
            numbered: self.numbered,
            pictures: 0,
            silence: None,
            fault: None,
            stops: 0,
            is_gone: false,
        };
        let shared = Arc::new(Shared { state: Mutex::new(state), changed: Condvar::new() });
        let out = usbip::Answers::new(ours.try_clone()?);
        let (input, answers, to, serial) = (ours.try_clone()?, out.clone(), shared.clone(), serial.to_string());
        let serve = move || {
            // The connection ends when the driver or this side closes it.
            if let Err(error) = usbip::serve(input, &answers, &to, &serial) {
                eprintln!("uvccam: {error}");
            }
            to.change(|state| state.is_gone = true);
        };
        Builder::new().name("uvccam requests".into()).spawn(serve)?;
        let to = shared.clone();
        let stream_frames = move || {
            // Unplugging closes the stream in the middle of a picture.
            if let Err(error) = streaming::stream_frames(&out, &to)
                && !to.state().is_gone
            {
                eprintln!("uvccam: {error}");
            }
        };
        Builder::new().name("uvccam pictures".into()).spawn(stream_frames)?;
        let attach = |port| fs::write(ATTACH, format!("{port} {} {DEVICE} {HIGH_SPEED}", theirs.as_raw_fd()));
        let attached = (1..PORTS).fold(attach(0), |done, port| done.or_else(|_| attach(port)));
        self.plugged = Some((ours, shared));
        attached.inspect_err(|_| self.unplug())
    }

    /// Pulls the plug.
    pub fn unplug(&mut self) {
        if let Some((socket, shared)) = self.plugged.take() {
            // First: a sender of a payload holds the state until the driver has it.
            socket.shutdown(Shutdown::Both).ok(); // closed by the peer: unplugged as well
            shared.change(|state| state.is_gone = true);
        }
    }

    /// Changes the scene from the next picture on.
    pub fn show(&mut self, scene: Scene) {
        self.scene = Arc::new(scene);
        let scene = self.scene.clone();
        self.change(|state| state.scene = scene);
    }

    /// Changes the noise from the next picture on.
    pub fn scatter(&mut self, noise: Noise) {
        self.noise = noise;
        self.change(|state| state.noise = noise);
    }

    /// Whether the first four pixels hold the picture's number, little-endian, instead of light.
    pub fn number(&mut self, numbered: bool) {
        self.numbered = numbered;
        self.change(|state| state.numbered = numbered);
    }

    /// Sends nothing for a while.
    pub fn stall(&self, time: Duration) {
        self.change(|state| state.silence = Some(time));
    }

    /// Damages the next picture.
    pub fn spoil(&self, fault: Fault) {
        self.change(|state| state.fault = Some(fault));
    }

    /// Its controls and the number of pictures sent; `None` when unplugged.
    pub fn controls(&self) -> Option<(Controls, u32)> {
        self.plugged.as_ref().map(|(_, shared)| {
            let state = shared.state();
            (state.controls, state.pictures)
        })
    }

    fn change(&self, change: impl FnOnce(&mut State)) {
        if let Some((_, shared)) = &self.plugged {
            shared.change(change);
        }
    }
}

impl Drop for Camera {
    fn drop(&mut self) {
        self.unplug();
    }
}

/// The video node of the USB camera with that serial, once the driver has created it. Its number changes when the
/// camera is plugged in again while the old node is open.
pub fn node(serial: &str) -> io::Result<PathBuf> {
    until(&format!("video device called {serial}"), Duration::from_secs(NODE_S_MAX), || find(serial))
}

fn find(serial: &str) -> Option<PathBuf> {
    let is = |path: &Path, file: &str, text: &str| {
        fs::read_to_string(path.join(file)).is_ok_and(|found| found.trim() == text)
    };
    // The second node of a camera carries metadata, not pictures.
    let found = fs::read_dir("/sys/class/video4linux").ok()?.filter_map(Result::ok);
    let mut found =
        found.filter(|entry| is(&entry.path(), "index", "0") && is(&entry.path(), "device/../serial", serial));
    let node = Path::new("/dev").join(found.next()?.file_name());
    node.exists().then_some(node)
}
