//! Shows frames of known truth as a camera: a thread writes them to a loopback device (v4l2loopback), which readers
//! open as a camera.
//!
//! A late reader misses frames without notice: so each picture has its number in its first bytes, by which truth is
//! looked up ([`number_of`]).

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::Path;
use std::sync::mpsc::{RecvTimeoutError, SyncSender, sync_channel};
use std::thread::{Builder, JoinHandle};
use std::time::{Duration, Instant};

use isophote_capture::{FrameSource, Synthetic, SyntheticSpec};
use isophote_tracker::Frame;
use v4l::video::Output;
use v4l::{Device, Format, FourCC};

/// Size of a picture's number, bytes.
const NUMBER: usize = 4;

/// Writes pictures of one format and size to a device.
pub struct Writer {
    device: Device,
    bytes: usize,
}

impl Writer {
    /// Opens the device and sets its format: GREY, YUYV, RGB3, or any other by its own bytes.
    ///
    /// # Errors
    /// There is no such device, or it chooses another format.
    pub fn open(path: &Path, fourcc: [u8; 4], [width, height]: [usize; 2]) -> io::Result<Writer> {
        let device = Device::with_path(path)?;
        let wanted = Format::new(width as u32, height as u32, FourCC::new(&fourcc));
        let got = device.set_format(&wanted)?;
        if (got.width, got.height, got.fourcc.repr) != (wanted.width, wanted.height, fourcc) {
            return Err(io::Error::other(format!("{}: asked for {wanted}, got {got}", path.display())));
        }
        Ok(Writer { device, bytes: got.size as usize })
    }

    /// Shows one picture.
    ///
    /// # Errors
    /// Its length does not match the format, or the device refuses it.
    pub fn write(&mut self, picture: &[u8]) -> io::Result<()> {
        if picture.len() != self.bytes {
            return Err(io::Error::other(format!("a picture has {} bytes, not {}", self.bytes, picture.len())));
        }
        self.device.write_all(picture)
    }
}

/// The bytes of an 8-bit frame in a format: luma or the first plane for GREY and YUYV, three planes for RGB3.
///
/// # Errors
/// The format is unsupported, or the frame lacks its planes.
pub fn packed(frame: &Frame, fourcc: [u8; 4]) -> Result<Vec<u8>, String> {
    let pixel = |plane: usize, i: usize| frame.plane_view(plane).pixel(i % frame.width(), i / frame.width()) as u8;
    let pixels = 0..frame.width() * frame.rows();
    match (&fourcc, frame.planes().len()) {
        (b"GREY", _) => Ok(pixels.map(|i| pixel(0, i)).collect()),
        (b"YUYV", _) => Ok(pixels.flat_map(|i| [pixel(0, i), 128]).collect()),
        (b"RGB3", 3) => Ok(pixels.flat_map(|i| [0, 1, 2].map(|plane| pixel(plane, i))).collect()),
        (_, planes) => Err(format!("{} is not written of {planes} planes", String::from_utf8_lossy(&fourcc))),
    }
}

/// Writes a picture's number over its first four bytes (for YUYV the first four of luma), little-endian.
pub fn number(picture: &mut [u8], fourcc: [u8; 4], number: u32) {
    let step = if fourcc == *b"YUYV" { 2 } else { 1 };
    picture.iter_mut().step_by(step).zip(number.to_le_bytes()).for_each(|(pixel, byte)| *pixel = byte);
}

/// Reads the number from the first row of a single-plane frame, or from the first bytes of its buffer for three
/// planes.
pub fn number_of(frame: &Frame) -> u32 {
    let view = |channel: usize, x: usize| frame.plane_view(channel).pixel(x, 0) as u8;
    let bytes: [u8; NUMBER] = match frame.planes().len() {
        3 => std::array::from_fn(|i| view(i % 3, i / 3)),
        _ => std::array::from_fn(|i| view(0, i)),
    };
    u32::from_le_bytes(bytes)
}

/// Pictures of a synthetic camera, with their truth.
pub struct Film {
    /// Four-character code of the pictures.
    pub fourcc: [u8; 4],
    /// Width and height, px.
    pub size: [usize; 2],
    /// Bytes by picture, without numbers.
    pub pictures: Vec<Vec<u8>>,
    /// Parameters by picture.
    pub truths: Vec<BTreeMap<String, f64>>,
}

impl Film {
    /// Renders `frames` pictures of 8 bits.
    ///
    /// # Errors
    /// The synthetic camera is invalid, or its frames lack the planes of the format.
    pub fn render(spec: SyntheticSpec, frames: usize, fourcc: [u8; 4]) -> Result<Film, String> {
        let size = [spec.width, spec.height];
        let mut camera = Synthetic::new(spec).map_err(|error| error.to_string())?;
        let mut film = Film { fourcc, size, pictures: Vec::new(), truths: Vec::new() };
        while film.pictures.len() < frames {
            let Some(captured) = camera.next().map_err(|error| error.to_string())? else { break };
            film.pictures.push(packed(&captured.frame, fourcc)?);
            film.truths.push(captured.truth.unwrap_or_default());
        }
        Ok(film)
    }

    /// Truth of picture `number`: the film repeats.
    pub fn truth(&self, number: u32) -> &BTreeMap<String, f64> {
        &self.truths[number as usize % self.truths.len()]
    }

    /// Loops the film on a device at a rate, numbered from 0, until the result is dropped. The first picture is
    /// written before this returns, so that readers of the device see its format.
    pub fn play(&self, path: &Path, rate_hz: f64) -> io::Result<Playing> {
        let mut writer = Writer::open(path, self.fourcc, self.size)?;
        let (fourcc, pictures) = (self.fourcc, self.pictures.clone());
        let mut show = move |n: u32| {
            let mut picture = pictures[n as usize % pictures.len()].clone();
            number(&mut picture, fourcc, n);
            writer.write(&picture)
        };
        show(0)?;
        let (stop, stopped) = sync_channel::<()>(1);
        let (start, step) = (Instant::now(), 1.0 / rate_hz);
        let play = move || -> io::Result<u32> {
            for n in 1.. {
                let due = start + Duration::from_secs_f64(f64::from(n) * step);
                match stopped.recv_timeout(due.saturating_duration_since(Instant::now())) {
                    Err(RecvTimeoutError::Timeout) => show(n)?,
                    _ => return Ok(n),
                }
            }
            Ok(u32::MAX)
        };
        let thread = Builder::new().name("loopback writer".into()).spawn(play)?;
        Ok(Playing { stop: Some(stop), thread: Some(thread) })
    }
}

/// A running film; it stops on drop.
pub struct Playing {
    stop: Option<SyncSender<()>>,
    thread: Option<JoinHandle<io::Result<u32>>>,
}

impl Playing {
    /// Stops and returns the number of pictures shown.
    ///
    /// # Errors
    /// The device refused one.
    pub fn stop(mut self) -> io::Result<u32> {
        self.stop = None;
        let ended = self.thread.take().map(JoinHandle::join);
        ended.unwrap_or(Ok(Ok(0))).unwrap_or_else(|_| Err(io::Error::other("the writer panicked")))
    }
}

impl Drop for Playing {
    fn drop(&mut self) {
        self.stop = None;
        if let Some(thread) = self.thread.take() {
            thread.join().ok(); // `stop` reports write errors
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use isophote_capture::{Colour, Encoding};
    use isophote_jit::PixelFormat;
    use isophote_tracker::Plane;

    #[test]
    fn numbers_round_trip_in_every_format() {
        let plane = |base: u8| Plane::owned(PixelFormat::U8, (base..base + 24).collect(), 6);
        for (fourcc, frame) in [
            (*b"GREY", Frame::new(&[6, 4], vec![plane(7)]).unwrap()),
            (*b"YUYV", Frame::new(&[6, 4], vec![plane(7)]).unwrap()),
            (*b"RGB3", Frame::new(&[6, 4], vec![plane(7), plane(70), plane(170)]).unwrap()),
        ] {
            let mut picture = packed(&frame, fourcc).unwrap();
            let stride = picture.len() / 4;
            let read =
                |picture: &[u8]| Encoding::of(fourcc).unwrap().frame(picture, [6, 4], stride, Colour::All).unwrap();
            let back = read(&picture);
            for (plane, i) in (0..frame.planes().len()).flat_map(|plane| (0..24).map(move |i| (plane, i))) {
                let pixel = |frame: &Frame| frame.plane_view(plane).pixel(i % 6, i / 6);
                assert_eq!(pixel(&back), pixel(&frame));
            }
            number(&mut picture, fourcc, 0x0304_0506);
            assert_eq!(number_of(&read(&picture)), 0x0304_0506);
        }
        let grey = Frame::new(&[6, 4], vec![plane(7)]).unwrap();
        assert!(packed(&grey, *b"RGB3").is_err() && packed(&grey, *b"MJPG").is_err());
    }
}
