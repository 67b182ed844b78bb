//! `LiveCamera`: one camera through disconnects, stalls and reconnects.
//!
//! It rests (closed), streams, or is down. Any fault that ends a stream closes the device; the camera is then found by
//! identity and set up from scratch, so there is one path up and one path down.

use std::io;
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use isophote_frame::Frame;
use rustix::fd::AsFd;

use super::device::{self, Identity, OpenCamera};
use super::error::CameraError;
use super::formats::{self, FormatPlan};
use super::ioctl::{DeviceNode, StreamFormat};
use super::light_control::LightControl;
use super::sequence::Sequence;
use super::stream::{LostPictures, Stream, StreamEvent, wait};
use super::watch::DeviceWatch;
use super::{CameraSpec, CameraState, CameraStatus, controls};
use crate::exposure::Exposure;
use crate::pixels::PixelsError;
use crate::source::Captured;
use crate::wake::Wake;

/// Initial delay before a lost camera is looked for again; it doubles with each failure.
const RETRY_MIN: Duration = Duration::from_millis(50);
/// Upper bound of that delay.
const RETRY_MAX: Duration = Duration::from_secs(1);
/// A camera without a picture for this long, and for `STALL_INTERVALS` frame intervals, has stalled; after twice that it is
/// reopened.
const STALL: Duration = Duration::from_secs(2);
const STALL_INTERVALS: u32 = 8;
/// Driver whose streams are shared with other readers: its sequence numbers begin with a jump.
const LOOPBACK: &str = "v4l2 loopback";

/// A camera bound to one identity, format and size.
pub struct LiveCamera {
    spec: CameraSpec,
    identity: Identity,
    /// Cameras present together with it that equal it but for the bus position.
    others: Vec<Identity>,
    plan: FormatPlan,
    format: StreamFormat,
    interval: Option<Duration>,
    link: Link,
    state: CameraState,
    status: CameraStatus,
    wake: Wake,
    /// `None` if the kernel grants no inotify watch: reconnection then depends on retries alone.
    watch: Option<DeviceWatch>,
    light_control: Option<LightControl>,
    exposure: Option<Exposure>,
    /// Exposure factor last set on the device; `None` after it is opened.
    applied: Option<f64>,
    /// Frames lost since the last delivered one.
    lost: u64,
    next_number: u64,
    /// Capture time of the first frame, shared with spares.
    first_ns: Arc<OnceLock<u64>>,
    /// Fault of the last picture, if any.
    damage: Option<String>,
    last_picture: Instant,
    /// Start of the stream.
    since: Instant,
}

enum Link {
    Resting,
    /// `pause` is the delay before the next try if the stream fails before its first picture.
    Streaming {
        stream: Stream,
        pause: Duration,
    },
    Down {
        next: Instant,
        pause: Duration,
    },
}

impl LiveCamera {
    /// Finds the camera, chooses and sets the format, sets the controls and closes it again: it rests.
    ///
    /// # Errors
    /// A camera that is absent, in use, or lacks what the document requests.
    pub fn open(spec: CameraSpec) -> Result<LiveCamera, CameraError> {
        let OpenCamera { node, path, identity, others, key } = device::named(&spec.device)?;
        let device = path.display().to_string();
        let plan = formats::choose(&node, &device, &spec.format, spec.colour)?;
        if !plan.encoding.has(spec.colour) {
            return Err(CameraError::Colour { device, format: plan.encoding.name() });
        }
        let unwaitable = |reason| CameraError::Io { device: device.clone(), doing: "waited for", reason };
        let wake = Wake::new().map_err(unwaitable)?;
        let status = CameraStatus {
            device,
            identity: key,
            format: plan.encoding.name(),
            width: plan.size[0],
            height: plan.size[1],
            rate_hz: None,
            controls_taken: Default::default(),
            gaps: 0,
            damaged: 0,
            overtaken: 0,
            reconnects: 0,
        };
        let format = StreamFormat { fourcc: plan.encoding.fourcc(), size: plan.size, stride: 0, bytes: 0 };
        let mut camera = LiveCamera {
            spec,
            identity,
            others,
            plan,
            format,
            interval: None,
            link: Link::Resting,
            state: CameraState::Resting,
            status,
            wake,
            watch: DeviceWatch::new().ok(),
            light_control: None,
            exposure: None,
            applied: None,
            lost: 0,
            next_number: 0,
            first_ns: Arc::default(),
            damage: None,
            last_picture: Instant::now(),
            since: Instant::now(),
        };
        camera.set_up(&node)?;
        camera.light_control = LightControl::of(&node, camera.interval.map(|interval| interval.as_secs_f64()));
        camera.exposure =
            camera.light_control.map(|light_control| Exposure::waking(camera.wake.clone(), light_control.reach()));
        Ok(camera)
    }

    /// A closed copy that replaces a camera whose driver hangs. This calls no driver: the copy finds the camera by its
    /// identity, as after unplugging.
    pub fn spare(&self) -> LiveCamera {
        LiveCamera {
            spec: self.spec.clone(),
            identity: self.identity.clone(),
            others: self.others.clone(),
            plan: self.plan,
            format: self.format,
            interval: self.interval,
            link: Link::Resting,
            state: CameraState::Resting,
            status: self.status.clone(),
            wake: self.wake.clone(),
            watch: DeviceWatch::new().ok(),
            light_control: self.light_control,
            exposure: self.exposure.clone(),
            applied: None,
            lost: 0,
            next_number: self.next_number,
            first_ns: self.first_ns.clone(),
            damage: None,
            last_picture: Instant::now(),
            since: Instant::now(),
        }
    }

    /// Starts a spare: its frames are numbered from `next_number`, and its loss counters continue from `status`.
    pub fn go_on(&mut self, next_number: u64, status: CameraStatus) {
        (self.next_number, self.status) = (next_number, status);
        self.link = Link::Down { next: Instant::now(), pause: RETRY_MIN };
        self.state = CameraState::Lost("its driver does not come back".into());
        self.last_picture = Instant::now();
    }

    /// Current state.
    pub fn state(&self) -> &CameraState {
        &self.state
    }

    /// Identity, settings and loss counters.
    pub fn status(&self) -> &CameraStatus {
        &self.status
    }

    /// Ends a wait in [`LiveCamera::next`] from another thread.
    pub fn wake(&self) -> Wake {
        self.wake.clone()
    }

    /// Exposure control, if the camera has exposure time or gain.
    pub fn exposure(&self) -> Option<Exposure> {
        self.exposure.clone()
    }

    /// Width and height of the frames, px.
    pub fn size(&self) -> [usize; 2] {
        self.plan.encoding.size(self.plan.size.map(|side| side as usize), self.spec.colour)
    }

    /// Planes per frame.
    pub fn planes(&self) -> usize {
        self.plan.encoding.planes(self.spec.colour)
    }

    /// Pixel format of the frames.
    pub fn pixel_format(&self) -> isophote_jit::PixelFormat {
        self.plan.encoding.format()
    }

    /// Closes the device.
    pub fn rest(&mut self) {
        self.link = Link::Resting;
        self.state = CameraState::Resting;
        self.lost = 0;
    }

    /// Waits for the newest frame, at most `limit`, less if woken. `None` does not imply a fault: see [`LiveCamera::state`].
    pub fn next(&mut self, limit: Duration) -> Option<Captured> {
        let now = Instant::now();
        let frame = match &self.link {
            Link::Resting => {
                self.state = CameraState::Running;
                self.last_picture = now;
                self.connect(RETRY_MIN);
                None
            }
            Link::Down { next, .. } if now < *next => {
                self.wait_for_devices(limit.min(*next - now));
                None
            }
            Link::Down { pause, .. } => {
                let pause = *pause;
                self.connect(pause);
                None
            }
            Link::Streaming { .. } => self.take(limit),
        };
        // Cleared only now: a ring before this point has already ended the wait.
        self.wake.reset();
        frame
    }

    fn wait_for_devices(&mut self, limit: Duration) {
        let mut waited = vec![self.wake.as_fd()];
        waited.extend(self.watch.as_ref().map(AsFd::as_fd));
        if wait(&waited, limit).is_err() {
            return; // the next retry comes at its time
        }
        if self.watch.as_ref().is_some_and(DeviceWatch::has_changed) {
            self.link = Link::Down { next: Instant::now(), pause: RETRY_MIN };
        }
    }

    /// Opens the device, sets it up and starts streaming; on failure stays down for `pause`, and longer the next time.
    fn connect(&mut self, pause: Duration) {
        if let Some(watch) = &self.watch {
            watch.has_changed(); // only later changes count
        }
        let longer = (2 * pause).min(RETRY_MAX);
        match self.stream() {
            Ok(stream) => {
                self.link = Link::Streaming { stream, pause: longer };
                self.since = Instant::now();
            }
            Err(error) => {
                self.link = Link::Down { next: Instant::now() + pause, pause: longer };
                self.state = CameraState::Lost(error.to_string());
            }
        }
    }

    fn stream(&mut self) -> Result<Stream, CameraError> {
        let found = device::again(&self.identity, &self.others, &self.status.identity)?;
        self.status.device = found.path.display().to_string();
        self.set_up(&found.node)?;
        (self.identity, self.others) = (found.identity, found.others);
        self.applied = None;
        let sequence = if self.identity.driver == LOOPBACK { Sequence::joining() } else { Sequence::default() };
        let size = self.plan.size.map(|side| side as usize);
        let bytes_min = self.plan.encoding.bytes_min(size, self.format.stride as usize);
        let bytes = bytes_min..=self.format.bytes.max(bytes_min as u32) as usize;
        Stream::start(found.node, bytes, sequence).map_err(|reason| self.fault("started", reason))
    }

    /// Sets format, rate and controls.
    fn set_up(&mut self, node: &DeviceNode) -> Result<(), CameraError> {
        let fourcc = self.plan.encoding.fourcc();
        let format = node.set_format(fourcc, self.plan.size).map_err(|reason| self.fault("set up", reason))?;
        if (format.fourcc, format.size) != (fourcc, self.plan.size) {
            let name = |fourcc, size: [u32; 2]| format!("{} of {}×{} px", formats::name(fourcc), size[0], size[1]);
            let (given, wanted) = (name(format.fourcc, format.size), name(fourcc, self.plan.size));
            return Err(CameraError::Changed { device: self.status.device.clone(), given, wanted });
        }
        if let Some(interval) = self.plan.interval {
            drop(node.set_interval(interval)); // not every driver supports this; the interval is read back
        }
        self.format = format;
        if self.format.stride == 0 {
            self.format.stride = self.plan.encoding.row_bytes(self.plan.size[0] as usize) as u32; // some drivers leave it 0
        }
        let interval = node.interval();
        self.interval = interval.map(Duration::from_secs_f64);
        self.status.rate_hz = interval.map(|interval| (1000.0 / interval).round() / 1000.0);
        self.status.controls_taken = controls::apply(node, &self.spec.controls, &|| true)?;
        drop(node.subscribe_source_change()); // drivers without this event have no signal that changes
        Ok(())
    }

    fn fault(&self, doing: &'static str, reason: io::Error) -> CameraError {
        let device = self.status.device.clone();
        match reason.kind() {
            io::ErrorKind::ResourceBusy => CameraError::Busy { device },
            _ => CameraError::Io { device, doing, reason },
        }
    }

    fn take(&mut self, limit: Duration) -> Option<Captured> {
        self.apply_exposure();
        let Link::Streaming { stream, .. } = &mut self.link else { return None };
        let (plan, stride, colour) = (&self.plan, self.format.stride as usize, self.spec.colour);
        let size = plan.size.map(|side| side as usize);
        let mut lost = LostPictures::default();
        let event = stream.newest(self.wake.as_fd(), limit, &mut lost, |event| match event {
            StreamEvent::Picture(picture) => {
                let frame = plan.encoding.frame(picture.bytes, size, stride, colour);
                let capture_ns = picture.monotonic.map(|time| time.as_nanos() as u64);
                DecodedEvent::Picture(frame.map(|frame| frame.with_capture_ns(capture_ns)))
            }
            StreamEvent::Nothing => DecodedEvent::Nothing,
            StreamEvent::SourceChanged => DecodedEvent::SourceChanged,
        });
        if let Ok(DecodedEvent::Picture(Err(error))) = &event {
            lost.damaged += 1;
            self.damage = Some(error.to_string());
        } else if lost.damaged > 0 {
            self.damage = Some("flagged as wrong by the driver, or too short".into());
        }
        self.status.gaps += lost.gaps;
        self.status.damaged += lost.damaged;
        self.status.overtaken += lost.overtaken;
        self.lost += lost.all();
        match event {
            Ok(DecodedEvent::Picture(Ok(frame))) => Some(self.deliver(frame)),
            Ok(DecodedEvent::Picture(Err(_)) | DecodedEvent::Nothing) => self.check_stall(),
            Ok(DecodedEvent::SourceChanged) => self.disconnect("the signal has another format now".into()),
            Err(error) => self.disconnect(reason_of(&error)),
        }
    }

    fn deliver(&mut self, frame: Frame) -> Captured {
        self.status.reconnects += u64::from(matches!(self.state, CameraState::Lost(_)));
        self.state = CameraState::Running;
        self.last_picture = Instant::now();
        self.damage = None;
        if let Link::Streaming { pause, .. } = &mut self.link {
            *pause = RETRY_MIN;
        }
        let number = self.next_number + std::mem::take(&mut self.lost);
        self.next_number = number + 1;
        let time_s = frame.capture_ns.map(|now_ns| {
            let first_ns = self.first_ns.get_or_init(|| now_ns);
            now_ns.saturating_sub(*first_ns) as f64 * 1e-9
        });
        Captured { frame: frame.with_sequence(number).with_time_s(time_s), file: None, truth: None }
    }

    fn check_stall(&mut self) -> Option<Captured> {
        let limit = STALL.max(self.interval.unwrap_or_default() * STALL_INTERVALS);
        let silence_s = self.last_picture.elapsed().as_secs_f64();
        if self.since.max(self.last_picture).elapsed() > 2 * limit {
            // Some drivers recover only when reopened, or accept another format only when closed.
            self.link = Link::Down { next: Instant::now() + RETRY_MIN, pause: RETRY_MIN };
        }
        if self.last_picture.elapsed() > limit {
            let damage = self.damage.as_ref().map(|damage| format!("; the last one was {damage}")).unwrap_or_default();
            self.state = CameraState::Stalled(format!("no picture for {silence_s:.0} s{damage}"));
        }
        None
    }

    fn disconnect(&mut self, reason: String) -> Option<Captured> {
        let pause = match self.link {
            Link::Streaming { pause, .. } | Link::Down { pause, .. } => pause,
            Link::Resting => RETRY_MIN,
        };
        self.link = Link::Down { next: Instant::now() + pause, pause };
        self.state = CameraState::Lost(reason);
        None
    }

    /// Sets the exposure on the device if the wanted factor has changed.
    fn apply_exposure(&mut self) {
        let (Some(light_control), Some(exposure), Link::Streaming { stream, .. }) =
            (self.light_control, &self.exposure, &self.link)
        else {
            return;
        };
        // Until a factor is set, the camera keeps its own exposure.
        let Some(wanted) = exposure.wanted().filter(|wanted| self.applied != Some(*wanted)) else { return };
        self.applied = Some(wanted);
        exposure.record_applied(light_control.set(stream.node(), wanted));
    }
}

/// Result of one read of the stream.
enum DecodedEvent {
    Picture(Result<Frame, PixelsError>),
    Nothing,
    SourceChanged,
}

fn reason_of(error: &io::Error) -> String {
    const ENODEV: i32 = rustix::io::Errno::NODEV.raw_os_error();
    match error.raw_os_error() {
        Some(ENODEV) => "the camera was unplugged".into(),
        _ => format!("the stream broke off: {error}"),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::pixels::Encoding;

    /// A camera that exists on no machine.
    fn absent() -> LiveCamera {
        let text = |text: &str| text.to_string();
        let (name, bus) = (text("Camera of a test"), text("nowhere"));
        let encoding = Encoding::of(*b"GREY").unwrap();
        LiveCamera {
            spec: CameraSpec::default(),
            identity: Identity { driver: text("none"), name, bus, serial: None, index: 0 },
            others: Vec::new(),
            plan: FormatPlan { encoding, size: [4, 4], interval: None },
            format: StreamFormat { fourcc: *b"GREY", size: [4, 4], stride: 4, bytes: 16 },
            interval: None,
            link: Link::Resting,
            state: CameraState::Resting,
            status: CameraStatus {
                device: text("/dev/video0"),
                identity: text("camera-of-a-test-nowhere"),
                format: text("GREY"),
                width: 4,
                height: 4,
                rate_hz: None,
                controls_taken: Default::default(),
                gaps: 3,
                damaged: 0,
                overtaken: 0,
                reconnects: 1,
            },
            wake: Wake::new().unwrap(),
            watch: None,
            light_control: None,
            exposure: None,
            applied: None,
            lost: 0,
            next_number: 0,
            first_ns: Arc::default(),
            damage: None,
            last_picture: Instant::now(),
            since: Instant::now(),
        }
    }

    fn picture(camera: &mut LiveCamera, capture_ns: u64) -> Captured {
        let (encoding, bytes) = (camera.plan.encoding, [7; 16]);
        let frame = encoding.frame(&bytes, [4, 4], 4, camera.spec.colour).unwrap();
        camera.deliver(frame.with_capture_ns(Some(capture_ns)))
    }

    /// Numbers, times, counters and the wake are shared between the two.
    #[test]
    fn a_spare_continues_numbers_times_and_counters() {
        let mut first = absent();
        assert_eq!(picture(&mut first, 2_000_000_000).frame.sequence, 0);
        let mut spare = first.spare();
        let status = CameraStatus { gaps: 5, ..first.status().clone() };
        spare.go_on(41, status.clone());
        assert!(spare.next(Duration::ZERO).is_none());
        assert!(matches!(spare.state(), CameraState::Lost(_)), "it is looked for: {:?}", spare.state());
        let frame = picture(&mut spare, 4_500_000_000).frame;
        assert_eq!((frame.sequence, frame.time_s), (41, Some(2.5)));
        assert_eq!(*spare.status(), CameraStatus { reconnects: 2, ..status });
        first.wake().ring();
        assert!(spare.wake.reset());
    }
}
