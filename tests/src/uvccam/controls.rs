//! `Controls`: exposure, gain and brightness.

/// Exposure mode: manual or automatic.
pub(super) const MANUAL: u8 = 1;
pub(super) const AUTOMATIC: u8 = 8;
/// Exposure time and gain at which light is unchanged.
pub(super) const EXPOSURE: u32 = 100;
pub(super) const GAIN: u16 = 64;

/// The camera's controls, in the driver's units.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Controls {
    pub(super) mode: u8,
    /// Exposure time, 100 µs.
    pub exposure: u32,
    /// 64 multiplies light by 1.
    pub gain: u16,
    /// Added to each pixel, DN.
    pub brightness: i16,
}

impl Default for Controls {
    fn default() -> Self {
        Controls { mode: AUTOMATIC, exposure: EXPOSURE, gain: GAIN, brightness: 0 }
    }
}

impl Controls {
    /// Whether the camera controls exposure and gain.
    pub fn is_automatic(self) -> bool {
        self.mode != MANUAL
    }

    /// Factor of light: exposure time and gain over their defaults; 1 in automatic mode.
    pub fn light(self) -> f32 {
        if self.is_automatic() { 1.0 } else { self.exposure as f32 / EXPOSURE as f32 * self.gain() }
    }

    /// Factor of electrons.
    pub(super) fn gain(self) -> f32 {
        if self.is_automatic() { 1.0 } else { f32::from(self.gain) / f32::from(GAIN) }
    }
}
