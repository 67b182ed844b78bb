//! The only module that calls V4L2 drivers: safe wrappers around ioctls, and memory-mapped buffers.
//!
//! The crate `v4l` provides the structures and codes of `videodev2.h`. Its safe layer is not used: it panics if a driver
//! reports an unknown colour space, field order or kind of control, and if closing a lost device fails.

#![allow(unsafe_code)] // each block states its safety argument

use std::fs::{File, OpenOptions};
use std::io;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd};
use std::os::unix::fs::{FileTypeExt, MetadataExt, OpenOptionsExt};
use std::path::Path;
use std::ptr;
use std::time::Duration;

use v4l::sys::*;
use v4l::v4l2;
use v4l::v4l2::vidioc;

/// `V4L2_BUF_TYPE_VIDEO_CAPTURE` and `V4L2_MEMORY_MMAP`.
const CAPTURE: u32 = 1;
const MMAP: u32 = 1;
/// Major device number of video devices.
const VIDEO: u32 = 81;
/// `V4L2_FIELD_NONE`: progressive frames.
const WHOLE: u32 = 1;
/// Most entries read from any list of a driver.
const ENTRIES_MAX: u32 = 4096;

/// # Safety
/// Only for structures of `videodev2.h` that consist of numbers, nullable pointers and unions of them, so that all zeros is
/// a valid value.
unsafe trait Plain {}
// SAFETY: each consists only of these.
unsafe impl Plain for v4l2_capability {}
unsafe impl Plain for v4l2_fmtdesc {}
unsafe impl Plain for v4l2_frmsizeenum {}
unsafe impl Plain for v4l2_frmivalenum {}
unsafe impl Plain for v4l2_format {}
unsafe impl Plain for v4l2_streamparm {}
unsafe impl Plain for v4l2_query_ext_ctrl {}
unsafe impl Plain for v4l2_querymenu {}
unsafe impl Plain for v4l2_ext_control {}
unsafe impl Plain for v4l2_ext_controls {}
unsafe impl Plain for v4l2_requestbuffers {}
unsafe impl Plain for v4l2_buffer {}
unsafe impl Plain for v4l2_event {}
unsafe impl Plain for v4l2_event_subscription {}
unsafe impl Plain for i32 {}

fn zeroed<T: Plain>() -> T {
    // SAFETY: `Plain` guarantees that all zeros is a value of T.
    unsafe { std::mem::zeroed() }
}

/// Capabilities that a driver reports.
pub(super) struct Capabilities {
    pub driver: String,
    pub card: String,
    pub bus: String,
    pub is_camera: bool,
}

/// Current stream format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct StreamFormat {
    pub fourcc: [u8; 4],
    pub size: [u32; 2],
    /// Row stride of the first plane, bytes.
    pub stride: u32,
    /// Maximum bytes of a frame.
    pub bytes: u32,
}

/// Frame interval, s, as the driver's fraction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Interval {
    pub numerator: u32,
    pub denominator: u32,
}

impl Interval {
    /// s; `None` if zero or not finite.
    pub fn seconds(self) -> Option<f64> {
        let seconds = f64::from(self.numerator) / f64::from(self.denominator);
        (seconds > 0.0 && seconds.is_finite()).then_some(seconds)
    }
}

impl From<v4l2_fract> for Interval {
    fn from(fraction: v4l2_fract) -> Interval {
        Interval { numerator: fraction.numerator, denominator: fraction.denominator }
    }
}

/// A discrete size or interval, or a range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Choice<T> {
    One(T),
    Range { least: T, most: T, step: T },
}

/// A control, as the driver describes it.
pub(super) struct ControlEntry {
    pub id: u32,
    pub name: String,
    pub kind: u32,
    pub range: [i64; 2],
    pub step: i64,
    pub default: i64,
    pub flags: u32,
    /// Value and label of each menu item.
    pub menu: Vec<(i64, String)>,
}

/// A buffer filled by the driver.
#[derive(Clone, Copy, Debug)]
pub(super) struct Filled {
    pub index: u32,
    pub bytes: usize,
    pub is_error: bool,
    pub sequence: u32,
    /// Capture time on CLOCK_MONOTONIC, if the driver uses that clock.
    pub monotonic: Option<Duration>,
}

/// An open device in non-blocking mode.
pub(super) struct DeviceNode(File);

impl AsFd for DeviceNode {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.0.as_fd()
    }
}

impl DeviceNode {
    /// Opens only video devices: opening another device can start a watchdog or rewind a tape.
    pub fn open(path: &Path) -> io::Result<DeviceNode> {
        let metadata = std::fs::metadata(path)?;
        if !metadata.file_type().is_char_device() || rustix::fs::major(metadata.rdev()) != VIDEO {
            return Err(io::Error::new(io::ErrorKind::InvalidInput, "not a video device"));
        }
        let flags = rustix::fs::OFlags::NONBLOCK | rustix::fs::OFlags::NOCTTY;
        OpenOptions::new().read(true).write(true).custom_flags(flags.bits() as i32).open(path).map(DeviceNode)
    }

    /// Makes one ioctl, retrying on EINTR.
    fn call<T: Plain>(&self, code: vidioc::_IOC_TYPE, argument: &mut T) -> io::Result<()> {
        let size = (code >> 16) as usize & 0x3fff;
        assert_eq!(size, size_of::<T>(), "a code says how large its argument is");
        loop {
            // SAFETY: the argument has the size that the code states and outlives the call; pointers in it are null, or set
            // by `with_control` to something that outlives the call.
            let done = unsafe { v4l2::ioctl(self.0.as_raw_fd(), code, ptr::from_mut(argument).cast()) };
            match done {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                done => return done,
            }
        }
    }

    /// Queries the entries 0, 1, … until the driver returns an error.
    fn list<T: Plain, U>(
        &self,
        code: vidioc::_IOC_TYPE,
        ask: impl Fn(u32) -> T,
        take: impl Fn(&T) -> Option<U>,
    ) -> Vec<U> {
        let mut found = Vec::new();
        for index in 0..ENTRIES_MAX {
            let mut entry = ask(index);
            if self.call(code, &mut entry).is_err() {
                break;
            }
            found.extend(take(&entry));
        }
        found
    }

    pub fn capabilities(&self) -> io::Result<Capabilities> {
        let mut caps: v4l2_capability = zeroed();
        self.call(vidioc::VIDIOC_QUERYCAP, &mut caps)?;
        let is_per_node = caps.capabilities & V4L2_CAP_DEVICE_CAPS != 0;
        let flags = if is_per_node { caps.device_caps } else { caps.capabilities };
        let is_camera = flags & V4L2_CAP_VIDEO_CAPTURE != 0 && flags & V4L2_CAP_STREAMING != 0;
        Ok(Capabilities { driver: text(&caps.driver), card: text(&caps.card), bus: text(&caps.bus_info), is_camera })
    }

    pub fn formats(&self) -> Vec<[u8; 4]> {
        let ask = |index| v4l2_fmtdesc { index, type_: CAPTURE, ..zeroed() };
        self.list(vidioc::VIDIOC_ENUM_FMT, ask, |entry| Some(entry.pixelformat.to_le_bytes()))
    }

    pub fn sizes(&self, fourcc: [u8; 4]) -> Vec<Choice<[u32; 2]>> {
        let ask = |index| v4l2_frmsizeenum { index, pixel_format: u32::from_le_bytes(fourcc), ..zeroed() };
        self.list(vidioc::VIDIOC_ENUM_FRAMESIZES, ask, |entry| {
            // SAFETY: both variants are numbers; `type_` selects the one that was written.
            let (one, range) = unsafe { (entry.__bindgen_anon_1.discrete, entry.__bindgen_anon_1.stepwise) };
            match entry.type_ {
                1 => Some(Choice::One([one.width, one.height])),
                2 | 3 => Some(Choice::Range {
                    least: [range.min_width, range.min_height],
                    most: [range.max_width, range.max_height],
                    step: [range.step_width, range.step_height],
                }),
                _ => None,
            }
        })
    }

    /// Frame intervals.
    pub fn intervals(&self, fourcc: [u8; 4], [width, height]: [u32; 2]) -> Vec<Choice<Interval>> {
        let pixel_format = u32::from_le_bytes(fourcc);
        let ask = |index| v4l2_frmivalenum { index, pixel_format, width, height, ..zeroed() };
        self.list(vidioc::VIDIOC_ENUM_FRAMEINTERVALS, ask, |entry| {
            // SAFETY: as for sizes.
            let (one, range) = unsafe { (entry.__bindgen_anon_1.discrete, entry.__bindgen_anon_1.stepwise) };
            match entry.type_ {
                1 => Some(Choice::One(one.into())),
                2 | 3 => {
                    Some(Choice::Range { least: range.min.into(), most: range.max.into(), step: range.step.into() })
                }
                _ => None,
            }
        })
    }

    pub fn format(&self) -> io::Result<StreamFormat> {
        let mut format = v4l2_format { type_: CAPTURE, ..zeroed() };
        self.call(vidioc::VIDIOC_G_FMT, &mut format)?;
        Ok(pixels(&format))
    }

    /// Sets a format; returns the driver's adjusted one.
    pub fn set_format(&self, fourcc: [u8; 4], [width, height]: [u32; 2]) -> io::Result<StreamFormat> {
        let mut format: v4l2_format = v4l2_format { type_: CAPTURE, ..zeroed() };
        // SAFETY: all zeros is a value of this variant.
        let pix = unsafe { &mut format.fmt.pix };
        (pix.width, pix.height, pix.pixelformat, pix.field) = (width, height, u32::from_le_bytes(fourcc), WHOLE);
        self.call(vidioc::VIDIOC_S_FMT, &mut format)?;
        Ok(pixels(&format))
    }

    /// Current frame interval, s; `None` if the driver does not report one.
    pub fn interval(&self) -> Option<f64> {
        let mut parm = v4l2_streamparm { type_: CAPTURE, ..zeroed() };
        self.call(vidioc::VIDIOC_G_PARM, &mut parm).ok()?;
        // SAFETY: numbers, written by the driver for this type of stream.
        Interval::from(unsafe { parm.parm.capture.timeperframe }).seconds()
    }

    /// Requests a frame interval; the driver picks one that it supports.
    pub fn set_interval(&self, interval: Interval) -> io::Result<()> {
        let mut parm = v4l2_streamparm { type_: CAPTURE, ..zeroed() };
        let Interval { numerator, denominator } = interval;
        parm.parm.capture.timeperframe = v4l2_fract { numerator, denominator };
        self.call(vidioc::VIDIOC_S_PARM, &mut parm)
    }

    pub fn controls(&self) -> Vec<ControlEntry> {
        let mut found = Vec::new();
        let mut id = 0;
        for _ in 0..ENTRIES_MAX {
            let mut query =
                v4l2_query_ext_ctrl { id: id | V4L2_CTRL_FLAG_NEXT_CTRL | V4L2_CTRL_FLAG_NEXT_COMPOUND, ..zeroed() };
            if self.call(vidioc::VIDIOC_QUERY_EXT_CTRL, &mut query).is_err() || query.id <= id {
                break;
            }
            id = query.id;
            let name = query.name.map(|character| character as u8);
            found.push(ControlEntry {
                id,
                name: text(&name),
                kind: query.type_,
                range: [query.minimum, query.maximum],
                step: query.step as i64,
                default: query.default_value,
                flags: query.flags,
                menu: self.menu(&query),
            });
        }
        found
    }

    fn menu(&self, query: &v4l2_query_ext_ctrl) -> Vec<(i64, String)> {
        let is_numbers = query.type_ == v4l2_ctrl_type_V4L2_CTRL_TYPE_INTEGER_MENU;
        if query.type_ != v4l2_ctrl_type_V4L2_CTRL_TYPE_MENU && !is_numbers {
            return Vec::new();
        }
        let [least, most] = [query.minimum, query.maximum].map(|end| end.clamp(0, i64::from(ENTRIES_MAX)));
        let of = |index: i64| {
            let mut item = v4l2_querymenu { id: query.id, index: index as u32, ..zeroed() };
            self.call(vidioc::VIDIOC_QUERYMENU, &mut item).ok()?; // a gap in the menu
            // SAFETY: both variants are numbers, in a packed structure, so they are copied.
            let (name, value) = unsafe { (item.__bindgen_anon_1.name, item.__bindgen_anon_1.value) };
            Some((index, if is_numbers { value.to_string() } else { text(&name) }))
        };
        (least..=most).filter_map(of).collect()
    }

    pub fn control(&self, id: u32) -> io::Result<i64> {
        let mut control = v4l2_ext_control { id, ..zeroed() };
        self.with_control(vidioc::VIDIOC_G_EXT_CTRLS, &mut control)?;
        // SAFETY: numbers; drivers write the 32-bit field for all kinds but 64-bit integers.
        Ok(i64::from(unsafe { control.__bindgen_anon_1.value }))
    }

    pub fn set_control(&self, id: u32, value: i32) -> io::Result<()> {
        let mut control = v4l2_ext_control { id, ..zeroed() };
        control.__bindgen_anon_1.value = value;
        self.with_control(vidioc::VIDIOC_S_EXT_CTRLS, &mut control)
    }

    fn with_control(&self, code: vidioc::_IOC_TYPE, control: &mut v4l2_ext_control) -> io::Result<()> {
        let mut controls = v4l2_ext_controls { count: 1, controls: control, ..zeroed() };
        self.call(code, &mut controls)
    }

    /// Subscribes to format changes of the signal; many drivers do not support this.
    pub fn subscribe_source_change(&self) -> io::Result<()> {
        let mut subscription = v4l2_event_subscription { type_: V4L2_EVENT_SOURCE_CHANGE, ..zeroed() };
        self.call(vidioc::VIDIOC_SUBSCRIBE_EVENT, &mut subscription)
    }

    /// Whether the signal has changed since the last call.
    pub fn has_source_changed(&self) -> bool {
        let mut event: v4l2_event = zeroed();
        self.call(vidioc::VIDIOC_DQEVENT, &mut event).is_ok() && event.type_ == V4L2_EVENT_SOURCE_CHANGE
    }

    /// Requests `count` buffers; returns the number granted.
    pub fn request_buffers(&self, count: u32) -> io::Result<u32> {
        let mut request = v4l2_requestbuffers { count, type_: CAPTURE, memory: MMAP, ..zeroed() };
        self.call(vidioc::VIDIOC_REQBUFS, &mut request)?;
        Ok(request.count)
    }

    pub fn map(&self, index: u32) -> io::Result<Mapping> {
        let mut buffer = buffer(index);
        self.call(vidioc::VIDIOC_QUERYBUF, &mut buffer)?;
        let length = buffer.length as usize;
        // SAFETY: a new mapping of the driver's memory, of the length and at the offset that the driver gave.
        let at = unsafe {
            v4l2::mmap(
                ptr::null_mut(),
                length,
                rustix::mm::ProtFlags::READ.bits() as i32,
                rustix::mm::MapFlags::SHARED.bits() as i32,
                self.0.as_raw_fd(),
                buffer.m.offset.into(),
            )?
        };
        Ok(Mapping { at: at.cast(), length })
    }

    /// Hands a buffer to the driver.
    pub fn queue(&self, index: u32) -> io::Result<()> {
        self.call(vidioc::VIDIOC_QBUF, &mut buffer(index))
    }

    /// Takes a filled buffer from the driver; `None` if none is ready.
    pub fn dequeue(&self) -> io::Result<Option<Filled>> {
        let mut buffer = buffer(0);
        match self.call(vidioc::VIDIOC_DQBUF, &mut buffer) {
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(None),
            done => done?,
        }
        let is_monotonic = buffer.flags & V4L2_BUF_FLAG_TIMESTAMP_MASK == V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC;
        let time = Duration::new(
            buffer.timestamp.tv_sec.try_into().unwrap_or(0),
            u32::try_from(buffer.timestamp.tv_usec).unwrap_or(0).min(999_999) * 1000,
        );
        Ok(Some(Filled {
            index: buffer.index,
            bytes: buffer.bytesused as usize,
            is_error: buffer.flags & V4L2_BUF_FLAG_ERROR != 0,
            sequence: buffer.sequence,
            monotonic: is_monotonic.then_some(time),
        }))
    }

    pub fn start(&self) -> io::Result<()> {
        self.call(vidioc::VIDIOC_STREAMON, &mut (CAPTURE as i32))
    }

    pub fn stop(&self) -> io::Result<()> {
        self.call(vidioc::VIDIOC_STREAMOFF, &mut (CAPTURE as i32))
    }
}

fn buffer(index: u32) -> v4l2_buffer {
    v4l2_buffer { index, type_: CAPTURE, memory: MMAP, ..zeroed() }
}

fn pixels(format: &v4l2_format) -> StreamFormat {
    // SAFETY: numbers, written by the driver for this type of stream.
    let pix = unsafe { format.fmt.pix };
    StreamFormat {
        fourcc: pix.pixelformat.to_le_bytes(),
        size: [pix.width, pix.height],
        stride: pix.bytesperline,
        bytes: pix.sizeimage,
    }
}

fn text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).trim().to_string()
}

/// A driver buffer mapped into this process.
pub(super) struct Mapping {
    at: *const u8,
    length: usize,
}

// SAFETY: this value is the sole owner of the mapping, which any thread may read.
unsafe impl Send for Mapping {}

impl Mapping {
    /// The first bytes of a dequeued buffer. The driver does not write to it until it is queued again, which
    /// [`super::stream::Stream::newest`] does after its reader has returned.
    pub fn bytes(&self, filled: &Filled) -> &[u8] {
        // SAFETY: the mapping is at least this long and lives until `drop`.
        unsafe { std::slice::from_raw_parts(self.at, filled.bytes.min(self.length)) }
    }
}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: mapped in `map` with this length, and not used after.
        let done = unsafe { v4l2::munmap(self.at.cast_mut().cast(), self.length) };
        debug_assert!(done.is_ok(), "{done:?}");
    }
}
