//! A USB camera made of software, which the kernel's own driver (uvcvideo) serves as it serves a bought one.
//!
//! In: a [`Scene`], which is light, and the driver's requests over USB/IP, by way of the kernel's vhci-hcd. Out: pictures
//! of 640 × 480 and 320 × 240 px, GREY or YUYV, on which exposure, gain and brightness act. It can be unplugged, fall
//! silent, and spoil a picture. It must never know who looks at it: tests see it through `/dev/video…` only.
//!
//! ```text
//! driver ─ USB/IP ─► usbip ─► requests ─► State ─► shooting ─► picture ─► USB/IP
//!                      └─► descriptors
//! ```

pub mod commands;
mod controls;
mod descriptors;
mod picture;
mod requests;
mod shooting;
mod state;
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

/// Where a software device is plugged in, and how many there may be of the fast kind.
const ATTACH: &str = "/sys/devices/platform/vhci_hcd.0/attach";
const PORTS: usize = 8;
/// Bus 1, device 2; the number means nothing to the driver.
const DEVICE: u32 = 1 << 16 | 2;
/// USB/IP's number of a high-speed device.
const HIGH_SPEED: u32 = 3;
/// Time for the driver to make a node.
const NODE_S_MAX: u64 = 20;

/// The camera; dropped, it is unplugged.
pub struct Camera {
    scene: Arc<Scene>,
    noise: Noise,
    numbered: bool,
    plugged: Option<(UnixStream, Arc<Shared>)>,
}

impl Camera {
    /// One that is not plugged in yet, and looks at `scene`.
    pub fn new(scene: Scene) -> Camera {
        Camera { scene: Arc::new(scene), noise: Noise::default(), numbered: false, plugged: None }
    }

    /// Plugs it in, with its controls as they are by default; `serial` is what the driver is told. Plugged in already, it is
    /// unplugged first.
    ///
    /// # Errors
    /// When the kernel has no vhci-hcd, or all its ports are taken.
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
            // The connection ends when the driver or we let go of it.
            if let Err(error) = usbip::serve(input, &answers, &to, &serial) {
                eprintln!("uvccam: {error}");
            }
            to.change(|state| state.is_gone = true);
        };
        Builder::new().name("uvccam requests".into()).spawn(serve)?;
        let to = shared.clone();
        let shoot = move || {
            // Unplugged, the way ends in the middle of a picture.
            if let Err(error) = shooting::shoot(&out, &to)
                && !to.state().is_gone
            {
                eprintln!("uvccam: {error}");
            }
        };
        Builder::new().name("uvccam pictures".into()).spawn(shoot)?;
        let attach = |port| fs::write(ATTACH, format!("{port} {} {DEVICE} {HIGH_SPEED}", theirs.as_raw_fd()));
        let attached = (1..PORTS).fold(attach(0), |done, port| done.or_else(|_| attach(port)));
        self.plugged = Some((ours, shared));
        attached.inspect_err(|_| self.unplug())
    }

    /// Pulls the plug.
    pub fn unplug(&mut self) {
        if let Some((socket, shared)) = self.plugged.take() {
            // First of all: who sends a piece of a picture holds the state until the driver has it.
            socket.shutdown(Shutdown::Both).ok(); // closed from the other side: unplugged as well
            shared.change(|state| state.is_gone = true);
        }
    }

    /// Looks at something else from the next picture on.
    pub fn show(&mut self, scene: Scene) {
        self.scene = Arc::new(scene);
        let scene = self.scene.clone();
        self.change(|state| state.scene = scene);
    }

    /// How its pixels scatter from the next picture on.
    pub fn scatter(&mut self, noise: Noise) {
        self.noise = noise;
        self.change(|state| state.noise = noise);
    }

    /// Whether the first four pixels are the picture's number, the low byte first, instead of light.
    pub fn number(&mut self, numbered: bool) {
        self.numbered = numbered;
        self.change(|state| state.numbered = numbered);
    }

    /// Sends nothing for a while.
    pub fn stall(&self, time: Duration) {
        self.change(|state| state.silence = Some(time));
    }

    /// Spoils the next picture.
    pub fn spoil(&self, fault: Fault) {
        self.change(|state| state.fault = Some(fault));
    }

    /// Its controls and the pictures that it has sent; `None` when it is not plugged in.
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

/// The node that delivers the pictures of the USB camera called `serial`, as soon as the driver has made it. Its number
/// changes when the camera is plugged in again while somebody holds the old one.
pub fn node(serial: &str) -> io::Result<PathBuf> {
    until(&format!("video device called {serial}"), Duration::from_secs(NODE_S_MAX), || find(serial))
}

fn find(serial: &str) -> Option<PathBuf> {
    let is = |path: &Path, file: &str, text: &str| {
        fs::read_to_string(path.join(file)).is_ok_and(|found| found.trim() == text)
    };
    // The second node of a camera has data about pictures, not pictures.
    let found = fs::read_dir("/sys/class/video4linux").ok()?.filter_map(Result::ok);
    let mut found =
        found.filter(|entry| is(&entry.path(), "index", "0") && is(&entry.path(), "device/../serial", serial));
    let node = Path::new("/dev").join(found.next()?.file_name());
    node.exists().then_some(node)
}
