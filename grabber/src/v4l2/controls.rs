//! A camera's controls: exposure, gain, white balance and others.

use super::ioctl::{self, Control as Value, QueryControl, QueryMenu, control_type};
use crate::camera::Fault;
use bytemuck::Zeroable;
use config::SettingValue;
use messages::CameraState;
use rustix::fd::AsFd;
use serde::Serialize;
use std::collections::BTreeMap;

/// A control as described by the device.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Control {
    #[serde(skip)]
    id: u32,
    #[serde(skip)]
    flags: u32,
    /// Its name in configurations.
    pub name: String,
    /// Type of its value.
    pub kind: ControlKind,
    /// Lowest value.
    pub minimum: i64,
    /// Highest value.
    pub maximum: i64,
    /// Distance between values.
    pub step: u64,
    /// Value after power-up.
    pub default: i64,
    /// Present value, if it can be read.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub value: Option<i64>,
    /// The entries of a menu, by value.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub menu: BTreeMap<i64, String>,
    /// Whether it has no effect now because another control, usually an automatic, overrides it.
    pub inactive: bool,
}

/// Type of a control's value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ControlKind {
    /// A whole number.
    Integer,
    /// True or false.
    Boolean,
    /// One of a menu's entries.
    Menu,
    /// Any value triggers an action.
    Button,
}

/// The exposure time in units of 100 µs, on cameras that have it.
const EXPOSURE_ABSOLUTE: u32 = 0x009a_0902;

/// All controls of a device that can be set.
pub fn list(device: impl AsFd) -> Vec<Control> {
    let mut controls = Vec::new();
    let mut query = QueryControl { id: ioctl::NEXT_CONTROL, ..QueryControl::zeroed() };
    while ioctl::query_control(&device, &mut query).is_ok() {
        controls.extend(describe(&device, &query));
        query = QueryControl { id: query.id | ioctl::NEXT_CONTROL, ..QueryControl::zeroed() };
    }
    controls
}

fn describe(device: impl AsFd, query: &QueryControl) -> Option<Control> {
    let kind = match query.kind {
        control_type::INTEGER | control_type::BITMASK => ControlKind::Integer,
        control_type::BOOLEAN => ControlKind::Boolean,
        control_type::MENU | control_type::INTEGER_MENU => ControlKind::Menu,
        control_type::BUTTON => ControlKind::Button,
        _ => return None,
    };
    if query.flags & (ioctl::CONTROL_DISABLED | ioctl::CONTROL_READ_ONLY) != 0 {
        return None;
    }
    let menu = match kind {
        ControlKind::Menu => menu(&device, query),
        _ => BTreeMap::new(),
    };
    let value = match query.flags & ioctl::CONTROL_WRITE_ONLY {
        0 => read(&device, query.id).map(i64::from),
        _ => None,
    };
    Some(Control {
        id: query.id,
        flags: query.flags,
        name: plain_name(&ioctl::text(&query.name)),
        kind,
        minimum: query.minimum,
        maximum: query.maximum,
        step: query.step,
        default: query.default,
        value,
        menu,
        inactive: query.flags & ioctl::CONTROL_INACTIVE != 0,
    })
}

fn menu(device: impl AsFd, query: &QueryControl) -> BTreeMap<i64, String> {
    // No camera has longer menus; a greater number is an error of the driver.
    let last = query.maximum.min(query.minimum.saturating_add(255));
    let entry = |index: i64| {
        let mut entry =
            QueryMenu { id: query.id, index: u32::try_from(index).ok()?, ..QueryMenu::zeroed() };
        ioctl::query_menu(&device, &mut entry).ok()?;
        let name = match query.kind {
            control_type::INTEGER_MENU => {
                let number = entry.name.first_chunk::<8>().copied().unwrap_or_default();
                i64::from_ne_bytes(number).to_string()
            }
            _ => ioctl::text(&entry.name),
        };
        Some((index, name))
    };
    (query.minimum..=last).filter_map(entry).collect()
}

fn read(device: impl AsFd, id: u32) -> Option<i32> {
    let mut value = Value { id, value: 0 };
    ioctl::get_control(device, &mut value).ok()?;
    Some(value.value)
}

/// The exposure time in microseconds, if it is readable.
pub fn exposure_us(device: impl AsFd) -> Option<u32> {
    u32::try_from(read(device, EXPOSURE_ABSOLUTE)?).ok()?.checked_mul(100)
}

/// A control's name in the configuration: `White Balance, Automatic` is `white_balance_automatic`.
fn plain_name(name: &str) -> String {
    let words = name.split(|letter: char| !letter.is_ascii_alphanumeric());
    let words: Vec<&str> = words.filter(|word| !word.is_empty()).collect();
    words.join("_").to_ascii_lowercase()
}

/// Sets the configured controls. Switches and menus go first, since an automatic must be off before the
/// values that it controls can be set.
pub fn apply(device: impl AsFd, settings: &BTreeMap<String, SettingValue>) -> Result<(), Fault> {
    if settings.is_empty() {
        return Ok(());
    }
    let controls = list(&device);
    let mut wanted = settings
        .iter()
        .map(|(name, value)| {
            let control = find(&controls, name)?;
            Ok((control, control.number(value)?))
        })
        .collect::<Result<Vec<_>, Fault>>()?;
    wanted.sort_by_key(|(control, _)| control.kind == ControlKind::Integer);
    for (control, number) in wanted {
        set(&device, control, number)?;
    }
    Ok(())
}

fn set(device: impl AsFd, control: &Control, number: i32) -> Result<(), Fault> {
    let name = &control.name;
    let mut value = Value { id: control.id, value: number };
    ioctl::set_control(&device, &mut value)
        .map_err(|error| wrong(format!("control {name} = {number}: the driver says: {error}")))?;
    let write_only = control.flags & ioctl::CONTROL_WRITE_ONLY != 0;
    match read(&device, control.id) {
        Some(now) if now != number && !write_only && control.kind != ControlKind::Button => {
            Err(wrong(format!("control {name} was set to {number}, but is {now}")))
        }
        _ => Ok(()),
    }
}

fn wrong(problem: String) -> Fault {
    Fault::new(CameraState::WrongSetting, problem)
}

fn find<'a>(controls: &'a [Control], name: &str) -> Result<&'a Control, Fault> {
    let plain = plain_name(name);
    controls.iter().find(|control| control.name == plain).ok_or_else(|| {
        let names: Vec<&str> = controls.iter().map(|control| control.name.as_str()).collect();
        wrong(format!(
            "there is no control {name:?} (see `touchline cameras`); there are {}",
            names.join(", ")
        ))
    })
}

impl Control {
    /// The number for a configured value.
    fn number(&self, value: &SettingValue) -> Result<i32, Fault> {
        let refuse =
            || wrong(format!("control {} = {value}: allowed are {}", self.name, self.allowed()));
        let number = match (self.kind, value) {
            (ControlKind::Menu, SettingValue::Text(text)) => {
                let is_it = |entry: &&String| plain_name(entry) == plain_name(text);
                let found = self.menu.iter().find(|(_, entry)| is_it(entry));
                found.map(|(&number, _)| number).ok_or_else(refuse)?
            }
            (ControlKind::Boolean, SettingValue::Switch(on)) => i64::from(*on),
            (_, SettingValue::Number(number)) if number.fract() == 0.0 => *number as i64,
            _ => return Err(refuse()),
        };
        let fits = (self.minimum..=self.maximum).contains(&number)
            && (self.kind != ControlKind::Menu || self.menu.contains_key(&number))
            && (self.step < 2 || (number.abs_diff(self.minimum)).is_multiple_of(self.step));
        if !fits && self.kind != ControlKind::Button {
            return Err(refuse());
        }
        i32::try_from(number).map_err(|_| refuse())
    }

    /// A value as written in the configuration.
    pub fn written(&self, value: i64) -> String {
        match self.kind {
            ControlKind::Boolean => (value != 0).to_string(),
            ControlKind::Menu => {
                self.menu.get(&value).map_or(value.to_string(), |entry| format!("{entry:?}"))
            }
            _ => value.to_string(),
        }
    }

    /// The permitted values, in words.
    pub fn allowed(&self) -> String {
        match self.kind {
            ControlKind::Boolean => "true and false".into(),
            ControlKind::Button => "any number".into(),
            ControlKind::Menu => {
                let entries = self.menu.values().map(|entry| format!("{entry:?}"));
                entries.collect::<Vec<_>>().join(", ")
            }
            ControlKind::Integer if self.step > 1 => {
                format!("{} to {} in steps of {}", self.minimum, self.maximum, self.step)
            }
            ControlKind::Integer => format!("{} to {}", self.minimum, self.maximum),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn control(kind: ControlKind, minimum: i64, maximum: i64, step: u64) -> Control {
        let menu = [(1, "Manual Mode"), (3, "Aperture Priority Mode")];
        Control {
            id: 0,
            flags: 0,
            name: "gain".into(),
            kind,
            minimum,
            maximum,
            step,
            default: 0,
            value: None,
            menu: menu.map(|(number, name)| (number, name.to_string())).into(),
            inactive: false,
        }
    }

    #[test]
    fn names_are_written_plainly() {
        assert_eq!(plain_name("White Balance, Automatic"), "white_balance_automatic");
        assert_eq!(plain_name("Exposure Time, Absolute"), "exposure_time_absolute");
        assert_eq!(plain_name("gain"), "gain");
    }

    #[test]
    fn values_are_checked_against_what_the_control_takes() {
        let gain = control(ControlKind::Integer, 0, 100, 5);
        assert_eq!(gain.number(&SettingValue::Number(55.0)).unwrap(), 55);
        for wrong in [105.0, 52.0, 5.5, -5.0, 1e300] {
            let fault = gain.number(&SettingValue::Number(wrong)).unwrap_err();
            assert!(fault.problem.contains("0 to 100 in steps of 5"), "{fault}");
        }
        assert!(gain.number(&SettingValue::Text("much".into())).is_err());
        let switch = control(ControlKind::Boolean, 0, 1, 1);
        assert_eq!(switch.number(&SettingValue::Switch(true)).unwrap(), 1);
        assert_eq!(switch.number(&SettingValue::Number(0.0)).unwrap(), 0);
    }

    #[test]
    fn menus_take_names_and_numbers() {
        let menu = control(ControlKind::Menu, 0, 3, 1);
        assert_eq!(menu.number(&SettingValue::Text("manual mode".into())).unwrap(), 1);
        assert_eq!(menu.number(&SettingValue::Number(3.0)).unwrap(), 3);
        let fault = menu.number(&SettingValue::Number(2.0)).unwrap_err();
        assert!(fault.problem.contains("\"Aperture Priority Mode\""), "{fault}");
    }
}
