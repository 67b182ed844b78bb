//! Camera controls: exposure, gain, brightness, white balance and any others of the driver.
//!
//! Drivers clamp values silently and ignore a gain while auto gain is on, so automatic modes are switched off first and
//! every value is read back.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use v4l::sys::*;

use super::error::CameraError;
use super::ioctl::{ControlEntry, DeviceNode};

const INTEGER: u32 = v4l2_ctrl_type_V4L2_CTRL_TYPE_INTEGER;
const BOOLEAN: u32 = v4l2_ctrl_type_V4L2_CTRL_TYPE_BOOLEAN;
const MENU: u32 = v4l2_ctrl_type_V4L2_CTRL_TYPE_MENU;
const INTEGER_MENU: u32 = v4l2_ctrl_type_V4L2_CTRL_TYPE_INTEGER_MENU;
const BUTTON: u32 = v4l2_ctrl_type_V4L2_CTRL_TYPE_BUTTON;

/// Type of a control.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum ControlKind {
    /// A number.
    Integer,
    /// `true` or `false`.
    Boolean,
    /// One of several named items.
    Menu,
    /// One of several numbers.
    IntegerMenu,
    /// An action, triggered by setting it.
    Button,
}

/// A control with its range and present value.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ControlInfo {
    /// Name in lower case, as `v4l2-ctl` prints it.
    pub name: String,
    /// Type of the control.
    pub kind: ControlKind,
    /// Smallest value.
    pub minimum: i64,
    /// Largest value.
    pub maximum: i64,
    /// Step between values.
    pub step: i64,
    /// Default value.
    pub default: i64,
    /// Present value; absent if it cannot be read.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub value: Option<i64>,
    /// Names of a menu's items, by value.
    #[serde(skip_serializing_if = "BTreeMap::is_empty", default)]
    pub items: BTreeMap<i64, String>,
    /// True while another control overrides it, such as an automatic mode.
    #[serde(skip_serializing_if = "is_false", default)]
    pub is_inactive: bool,
}

fn is_false(flag: &bool) -> bool {
    !flag
}

/// Value of a control in a document.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(untagged)]
pub enum ControlValue {
    /// For a boolean.
    Switch(bool),
    /// For any other control; for a menu, the item's number.
    Number(i64),
    /// For a menu: the item's name.
    Word(String),
}

/// Values by name of control.
pub type ControlValues = BTreeMap<String, ControlValue>;

/// Common names of controls, with their candidate V4L2 IDs in order of preference.
const COMMON: [(&str, &[u32]); 3] = [
    ("exposure", &[V4L2_CID_EXPOSURE_ABSOLUTE, V4L2_CID_EXPOSURE]),
    ("gain", &[V4L2_CID_GAIN, V4L2_CID_ANALOGUE_GAIN]),
    ("white_balance", &[V4L2_CID_WHITE_BALANCE_TEMPERATURE]),
];

/// A control, the automatic control that overrides it, and the value that disables the latter.
const AUTOMATIC: [(u32, u32, i32); 5] = [
    (V4L2_CID_EXPOSURE_ABSOLUTE, V4L2_CID_EXPOSURE_AUTO, MANUAL),
    (V4L2_CID_EXPOSURE, V4L2_CID_EXPOSURE_AUTO, MANUAL),
    (V4L2_CID_GAIN, V4L2_CID_AUTOGAIN, 0),
    (V4L2_CID_ANALOGUE_GAIN, V4L2_CID_AUTOGAIN, 0),
    (V4L2_CID_WHITE_BALANCE_TEMPERATURE, V4L2_CID_AUTO_WHITE_BALANCE, 0),
];
/// `V4L2_EXPOSURE_MANUAL`.
const MANUAL: i32 = 1;

/// Lists the device's controls of supported kinds.
pub(super) fn of(node: &DeviceNode) -> Vec<ControlInfo> {
    node.controls().iter().filter_map(|entry| info(node, entry)).collect()
}

fn kind(entry: &ControlEntry) -> Option<ControlKind> {
    let hidden = V4L2_CTRL_FLAG_DISABLED | V4L2_CTRL_FLAG_HAS_PAYLOAD;
    if entry.flags & hidden != 0 {
        return None;
    }
    match entry.kind {
        INTEGER => Some(ControlKind::Integer),
        BOOLEAN => Some(ControlKind::Boolean),
        MENU => Some(ControlKind::Menu),
        INTEGER_MENU => Some(ControlKind::IntegerMenu),
        BUTTON => Some(ControlKind::Button),
        _ => None,
    }
}

fn info(node: &DeviceNode, entry: &ControlEntry) -> Option<ControlInfo> {
    let unreadable = V4L2_CTRL_FLAG_WRITE_ONLY;
    let kind = kind(entry)?;
    let value = (entry.flags & unreadable == 0 && kind != ControlKind::Button).then(|| node.control(entry.id).ok());
    Some(ControlInfo {
        name: plain(&entry.name),
        kind,
        minimum: entry.range[0],
        maximum: entry.range[1],
        step: entry.step,
        default: entry.default,
        value: value.flatten(),
        items: entry.menu.iter().cloned().collect(),
        is_inactive: entry.flags & V4L2_CTRL_FLAG_INACTIVE != 0,
    })
}

/// Normalizes a menu item for comparison: case and whitespace are ignored, signs are not (`-6` is not `6`).
fn word(text: &str) -> String {
    text.to_lowercase().split_whitespace().collect::<Vec<_>>().join(" ")
}

/// `Exposure Time, Absolute` becomes `exposure_time_absolute`.
fn plain(name: &str) -> String {
    let parts = name.split(|c: char| !c.is_ascii_alphanumeric()).filter(|part| !part.is_empty());
    parts.map(str::to_ascii_lowercase).collect::<Vec<_>>().join("_")
}

/// Sets controls in turn while `may_go_on` returns true, and returns the values read back. Drivers may be slow, and the
/// caller may lose the right to set controls meanwhile.
///
/// # Errors
/// An unknown control, a value of the wrong kind, or a driver error. Controls before the failing one stay set.
pub fn set_controls(
    device: &str,
    values: &ControlValues,
    may_go_on: &dyn Fn() -> bool,
) -> Result<ControlValues, CameraError> {
    apply(&super::device::named(device)?.node, values, may_go_on)
}

/// [`set_controls`] on an open device.
pub(super) fn apply(
    node: &DeviceNode,
    values: &ControlValues,
    may_go_on: &dyn Fn() -> bool,
) -> Result<ControlValues, CameraError> {
    let entries = node.controls();
    let mut taken = ControlValues::new();
    for (name, value) in values {
        if !may_go_on() {
            break;
        }
        let wrong = |reason: String| CameraError::Control { name: name.clone(), reason };
        let entry = find(&entries, name).ok_or_else(|| wrong(unknown(&entries)))?;
        let number = number(entry, value).map_err(wrong)?;
        prepare(node, &entries, entry.id);
        node.set_control(entry.id, number).map_err(|error| wrong(refusal(entry, number, &error)))?;
        if kind(entry) == Some(ControlKind::Button) || entry.flags & V4L2_CTRL_FLAG_WRITE_ONLY != 0 {
            continue;
        }
        let now = node.control(entry.id).map_err(|error| wrong(format!("cannot be read back: {error}")))?;
        let is_switch = kind(entry) == Some(ControlKind::Boolean);
        taken.insert(name.clone(), if is_switch { ControlValue::Switch(now != 0) } else { ControlValue::Number(now) });
    }
    Ok(taken)
}

/// Switches off the automatic control that would override `id`, if the driver has one.
pub(super) fn prepare(node: &DeviceNode, entries: &[ControlEntry], id: u32) {
    for (_, automatic, off) in AUTOMATIC.iter().filter(|(manual, ..)| *manual == id) {
        if entries.iter().any(|entry| entry.id == *automatic) {
            drop(node.set_control(*automatic, *off)); // the read-back shows whether it worked
        }
    }
}

fn find<'a>(entries: &'a [ControlEntry], name: &str) -> Option<&'a ControlEntry> {
    let settable = |entry: &&ControlEntry| kind(entry).is_some();
    let by_id = |id: &u32| entries.iter().filter(settable).find(|entry| entry.id == *id);
    let own = entries.iter().filter(settable).find(|entry| plain(&entry.name) == name);
    own.or_else(|| COMMON.iter().find(|(common, _)| *common == name).and_then(|(_, ids)| ids.iter().find_map(by_id)))
}

fn unknown(entries: &[ControlEntry]) -> String {
    let names: Vec<String> = entries.iter().filter(|entry| kind(entry).is_some()).map(|e| plain(&e.name)).collect();
    if names.is_empty() { "the camera has no controls".into() } else { format!("the camera has {}", names.join(", ")) }
}

fn number(entry: &ControlEntry, value: &ControlValue) -> Result<i32, String> {
    let number = match value {
        ControlValue::Switch(on) if kind(entry) != Some(ControlKind::Boolean) => {
            return Err(format!("is {on}, but it is no switch; set a number"));
        }
        ControlValue::Switch(on) => i64::from(*on),
        ControlValue::Number(number) => *number,
        ControlValue::Word(word) => {
            let found = entry.menu.iter().find(|(_, item)| self::word(item) == self::word(word));
            let items: Vec<String> = entry.menu.iter().map(|(_, item)| format!("\"{item}\"")).collect();
            let remedy = match kind(entry) {
                Some(ControlKind::Boolean) => "set true or false".into(),
                _ if items.is_empty() => "set a number".into(),
                _ => format!("set {}", items.join(" or ")),
            };
            found.map(|(index, _)| *index).ok_or_else(|| format!("is \"{word}\"; {remedy}"))?
        }
    };
    i32::try_from(number).map_err(|_| format!("is {number}, beyond 32 bits"))
}

fn refusal(entry: &ControlEntry, number: i32, error: &std::io::Error) -> String {
    let [least, most] = entry.range;
    format!("was not set to {number}: {error}; it goes from {least} to {most} in steps of {}", entry.step)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(id: u32, name: &str, kind: u32) -> ControlEntry {
        let menu = if kind == MENU { vec![(1, "Manual Mode".into())] } else { vec![] };
        ControlEntry { id, name: name.into(), kind, range: [0, 9], step: 1, default: 0, flags: 0, menu }
    }

    #[test]
    fn controls_are_found_by_name_and_values_are_converted() {
        let entries = [
            entry(V4L2_CID_EXPOSURE_AUTO, "Auto Exposure", MENU),
            entry(V4L2_CID_EXPOSURE_ABSOLUTE, "Exposure Time, Absolute", INTEGER),
            entry(V4L2_CID_AUTOGAIN, "Gain, Automatic", BOOLEAN),
            entry(1, "A rectangle", 0x0107),
        ];
        let id = |name: &str| find(&entries, name).map(|entry| entry.id);
        assert_eq!(id("exposure_time_absolute"), Some(V4L2_CID_EXPOSURE_ABSOLUTE));
        assert_eq!(id("exposure"), Some(V4L2_CID_EXPOSURE_ABSOLUTE));
        assert_eq!(id("gain"), None);
        assert_eq!(id("a_rectangle"), None, "kinds that nobody knows are left alone");
        assert_eq!(unknown(&entries), "the camera has auto_exposure, exposure_time_absolute, gain_automatic");
        assert_eq!(number(&entries[0], &ControlValue::Word("manual mode".into())), Ok(1));
        assert!(number(&entries[0], &ControlValue::Word("no".into())).is_err_and(|e| e.contains("\"Manual Mode\"")));
        assert_eq!(number(&entries[2], &ControlValue::Switch(true)), Ok(1));
        assert!(number(&entries[1], &ControlValue::Switch(true)).is_err());
        assert!(number(&entries[1], &ControlValue::Number(1 << 40)).is_err());
    }
}
