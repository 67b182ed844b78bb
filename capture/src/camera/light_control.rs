//! Light control of a camera through exposure time and gain.
//!
//! Light is exposure time × gain, both relative to their starting values. The time changes first, because gain also
//! amplifies noise; gain is used only beyond the range of the time. The driver's unit of gain is assumed proportional to
//! light; if it is not, the advice on the next frame corrects it.

use v4l::sys::*;

use super::controls::prepare;
use super::ioctl::{ControlEntry, DeviceNode};

/// Unit of `V4L2_CID_EXPOSURE_ABSOLUTE`, s.
const EXPOSURE_UNIT_S: f64 = 1e-4;

/// One control that affects the light.
#[derive(Clone, Copy, Debug, PartialEq)]
struct RelativeControl {
    id: u32,
    range: [f64; 2],
    /// Value when the light control was created.
    start: f64,
}

impl RelativeControl {
    fn of(node: &DeviceNode, entries: &[ControlEntry], ids: &[u32]) -> Option<RelativeControl> {
        let is_number = |entry: &&ControlEntry| {
            entry.kind == v4l2_ctrl_type_V4L2_CTRL_TYPE_INTEGER
                && entry.flags & (V4L2_CTRL_FLAG_DISABLED | V4L2_CTRL_FLAG_READ_ONLY) == 0
        };
        let entry = ids.iter().find_map(|id| entries.iter().filter(is_number).find(|entry| entry.id == *id))?;
        let [least, most] = entry.range.map(|end| end as f64);
        // A time or gain of 0 is no light, or its unit has an offset: no ratio to 0 is defined.
        let range = [least.max(1.0), most];
        let start = (node.control(entry.id).ok()? as f64).clamp(range[0], range[1].max(range[0]));
        (range[1] > range[0]).then_some(RelativeControl { id: entry.id, range, start })
    }

    /// Sets the control to `factor` × start; returns the ratio that the driver set.
    fn set(&self, node: &DeviceNode, entries: &[ControlEntry], factor: f64) -> f64 {
        let value = (self.start * factor).round().clamp(self.range[0], self.range[1]);
        if node.control(self.id).is_ok_and(|now| now as f64 != value) {
            prepare(node, entries, self.id);
            drop(node.set_control(self.id, value as i32)); // the value is read back below
        }
        let now = node.control(self.id).map_or(self.start, |now| now as f64);
        (now / self.start).max(f64::MIN_POSITIVE)
    }

    fn reach(&self) -> [f64; 2] {
        self.range.map(|end| end / self.start)
    }
}

/// Exposure time and gain of a camera that has at least one of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LightControl {
    time: Option<RelativeControl>,
    gain: Option<RelativeControl>,
}

impl LightControl {
    /// Starts at the current settings. `interval` is the frame interval, s: longer exposures would lower the frame rate.
    pub fn of(node: &DeviceNode, interval: Option<f64>) -> Option<LightControl> {
        let entries = node.controls();
        let mut time = RelativeControl::of(node, &entries, &[V4L2_CID_EXPOSURE_ABSOLUTE, V4L2_CID_EXPOSURE]);
        if let (Some(control), Some(interval)) = (&mut time, interval)
            && control.id == V4L2_CID_EXPOSURE_ABSOLUTE
        {
            control.range[1] =
                (interval / EXPOSURE_UNIT_S).clamp(control.start.min(control.range[1]), control.range[1]);
        }
        let gain = RelativeControl::of(node, &entries, &[V4L2_CID_GAIN, V4L2_CID_ANALOGUE_GAIN]);
        (time.is_some() || gain.is_some()).then_some(LightControl { time, gain })
    }

    /// Least and most light, relative to the start.
    pub fn reach(&self) -> [f64; 2] {
        let [time, gain] = [self.time, self.gain].map(|control| control.map_or([1.0, 1.0], |control| control.reach()));
        [time[0] * gain[0], time[1] * gain[1]]
    }

    /// Sets the light to `factor` × start and returns the ratio reached. Disables automatic control of the controls it
    /// changes.
    pub fn set(&self, node: &DeviceNode, factor: f64) -> f64 {
        let entries = node.controls();
        // Gain stays at its start while the time suffices.
        let [time, gain] = share(factor, self.time.map(|control| control.reach()));
        let time = self.time.map_or(1.0, |control| {
            prepare(node, &entries, control.id);
            control.set(node, &entries, time)
        });
        time * self.gain.map_or(1.0, |control| control.set(node, &entries, gain))
    }
}

/// Splits a factor into time and gain.
fn share(factor: f64, time: Option<[f64; 2]>) -> [f64; 2] {
    let [least, most] = time.unwrap_or([1.0, 1.0]);
    let time = factor.clamp(least.min(most), most);
    [time, factor / time]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exposure_time_changes_before_gain() {
        let reach = Some([0.01, 4.0]);
        assert_eq!(share(2.0, reach), [2.0, 1.0]);
        assert_eq!(share(8.0, reach), [4.0, 2.0]);
        assert_eq!(share(0.005, reach), [0.01, 0.5]);
        assert_eq!(share(3.0, None), [1.0, 3.0]);
    }
}
