//! The knob of a camera: how much light it takes, as exposure time and gain.
//!
//! Light is exposure time × gain, both relative to what they were. The time is turned first: gain amplifies noise as well.
//! Only where the time ends gain takes over. The unit of a gain is the driver's own; it is taken to be in proportion to
//! light, and where it is not, the next frame's advice mends it.

use v4l::sys::*;

use super::controls::prepare;
use super::ioctl::{ControlEntry, DeviceNode};

/// `V4L2_CID_EXPOSURE_ABSOLUTE` counts these, s.
const EXPOSURE_UNIT_S: f64 = 1e-4;

/// One control of the light.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Screw {
    id: u32,
    range: [f64; 2],
    /// When the knob was made.
    start: f64,
}

impl Screw {
    fn of(node: &DeviceNode, entries: &[ControlEntry], ids: &[u32]) -> Option<Screw> {
        let is_number = |entry: &&ControlEntry| {
            entry.kind == v4l2_ctrl_type_V4L2_CTRL_TYPE_INTEGER
                && entry.flags & (V4L2_CTRL_FLAG_DISABLED | V4L2_CTRL_FLAG_READ_ONLY) == 0
        };
        let entry = ids.iter().find_map(|id| entries.iter().filter(is_number).find(|entry| entry.id == *id))?;
        let [least, most] = entry.range.map(|end| end as f64);
        // 0 of a time or gain is no light, or a unit that does not begin with 0: from there nothing is in proportion.
        let range = [least.max(1.0), most];
        let start = (node.control(entry.id).ok()? as f64).clamp(range[0], range[1].max(range[0]));
        (range[1] > range[0]).then_some(Screw { id: entry.id, range, start })
    }

    /// Sets so many times the start; how many times it is then, whatever the driver made of it.
    fn turn(&self, node: &DeviceNode, entries: &[ControlEntry], factor: f64) -> f64 {
        let value = (self.start * factor).round().clamp(self.range[0], self.range[1]);
        if node.control(self.id).is_ok_and(|now| now as f64 != value) {
            prepare(node, entries, self.id);
            drop(node.set_control(self.id, value as i32)); // what it is now is read
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
pub(super) struct Knob {
    time: Option<Screw>,
    gain: Option<Screw>,
}

impl Knob {
    /// Starts at what is set now. `interval` is the time from a frame to the next, s: longer exposures would slow the
    /// camera down.
    pub fn of(node: &DeviceNode, interval: Option<f64>) -> Option<Knob> {
        let entries = node.controls();
        let mut time = Screw::of(node, &entries, &[V4L2_CID_EXPOSURE_ABSOLUTE, V4L2_CID_EXPOSURE]);
        if let (Some(screw), Some(interval)) = (&mut time, interval)
            && screw.id == V4L2_CID_EXPOSURE_ABSOLUTE
        {
            screw.range[1] = (interval / EXPOSURE_UNIT_S).clamp(screw.start.min(screw.range[1]), screw.range[1]);
        }
        let gain = Screw::of(node, &entries, &[V4L2_CID_GAIN, V4L2_CID_ANALOGUE_GAIN]);
        (time.is_some() || gain.is_some()).then_some(Knob { time, gain })
    }

    /// How much less and how much more light there can be.
    pub fn reach(&self) -> [f64; 2] {
        let [time, gain] = [self.time, self.gain].map(|screw| screw.map_or([1.0, 1.0], |screw| screw.reach()));
        [time[0] * gain[0], time[1] * gain[1]]
    }

    /// So many times as much light as at the start; as much as there really is then. Automatic control of what is turned
    /// ends.
    pub fn set(&self, node: &DeviceNode, factor: f64) -> f64 {
        let entries = node.controls();
        // Gain stays at its start as long as time suffices.
        let [time, gain] = share(factor, self.time.map(|screw| screw.reach()));
        let time = self.time.map_or(1.0, |screw| {
            prepare(node, &entries, screw.id);
            screw.turn(node, &entries, time)
        });
        time * self.gain.map_or(1.0, |screw| screw.turn(node, &entries, gain))
    }
}

/// How much of a factor is time, and how much gain.
fn share(factor: f64, time: Option<[f64; 2]>) -> [f64; 2] {
    let [least, most] = time.unwrap_or([1.0, 1.0]);
    let time = factor.clamp(least.min(most), most);
    [time, factor / time]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_is_turned_first() {
        let reach = Some([0.01, 4.0]);
        assert_eq!(share(2.0, reach), [2.0, 1.0]);
        assert_eq!(share(8.0, reach), [4.0, 2.0]);
        assert_eq!(share(0.005, reach), [0.01, 0.5]);
        assert_eq!(share(3.0, None), [1.0, 3.0]);
    }
}
