//! The state of the keys and sticks of each device, and the deflection of the axes that follows.
//! When a device is removed, its keys count as released.

use std::collections::{BTreeMap, BTreeSet};

use taktil_signal::JogFrame;

use super::map::{Action, Map};

/// The keys and sticks of one device.
#[derive(Clone, Debug, Default)]
struct Device {
    down: BTreeSet<u16>,
    /// Position of each stick, -1 to 1.
    sticks: BTreeMap<u16, f64>,
    /// The device has a dead-man's switch.
    has_dead_man_switch: bool,
    /// Keys that were down when the state became unknown and have not been seen since.
    unconfirmed: BTreeSet<u16>,
}

/// The keys and sticks of all devices.
#[derive(Clone, Debug)]
pub struct InputState {
    map: Map,
    devices: BTreeMap<usize, Device>,
    frame: JogFrame,
    speed: f64,
}

impl InputState {
    /// The state with no key held.
    #[must_use]
    pub fn new(map: Map) -> InputState {
        InputState { map, devices: BTreeMap::new(), frame: JogFrame::Joints, speed: 0.3 }
    }

    /// Adds a device; `has` tells which keys it reports.
    pub fn connect(&mut self, device: usize, has: impl Fn(u16) -> bool) {
        let has_dead_man_switch = self.map.hold.iter().any(|code| has(*code));
        self.devices.insert(device, Device { has_dead_man_switch, ..Device::default() });
    }

    /// Removes a device; everything on it is released.
    pub fn disconnect(&mut self, device: usize) {
        self.devices.remove(&device);
    }

    /// Releases everything on a device whose state is unknown.
    pub fn release_all(&mut self, device: usize) {
        if let Some(device) = self.devices.get_mut(&device) {
            device.unconfirmed.append(&mut device.down);
            device.sticks.clear();
        }
    }

    /// Ends the report of the held keys of a device: keys that it did not name are released.
    pub fn end_resynchronisation(&mut self, device: usize) {
        if let Some(device) = self.devices.get_mut(&device) {
            device.unconfirmed.clear();
        }
    }

    /// Marks a key as held. If it was released before, its press was lost, and its command is
    /// returned now.
    pub fn confirm_key(&mut self, device: usize, code: u16) -> Option<String> {
        if let Some(held) = self.devices.get_mut(&device)
            && held.unconfirmed.remove(&code)
        {
            held.down.insert(code);
            return None;
        }
        self.key(device, code, true)
    }

    /// Records that a key was pressed or released, and returns the command to send. Repeats of the
    /// kernel send nothing.
    pub fn key(&mut self, device: usize, code: u16, down: bool) -> Option<String> {
        let held = self.devices.entry(device).or_default();
        // A pipe does not tell which keys exist; the first press of a dead-man's switch shows that
        // it has one.
        held.has_dead_man_switch |= self.map.hold.contains(&code);
        held.unconfirmed.remove(&code);
        if !down {
            held.down.remove(&code);
            return None;
        }
        if !held.down.insert(code) {
            return None;
        }
        match self.map.keys.get(&code) {
            Some(Action::Frame(frame)) => self.frame = *frame,
            Some(Action::Speed(speed)) => self.speed = *speed,
            Some(Action::Say(words)) => return Some(words.clone()),
            Some(Action::Axis(..)) | None => {}
        }
        None
    }

    /// Records the position of a stick, -1 to 1.
    pub fn stick(&mut self, device: usize, code: u16, value: f64) {
        let zone = self.map.dead_zone;
        let beyond = ((value.abs().min(1.0) - zone) / (1.0 - zone)).max(0.0);
        let value = if value.is_nan() { 0.0 } else { beyond.copysign(value) };
        let held = self.devices.entry(device).or_default();
        // A device with sticks moves nothing unless its dead-man's switch is held.
        held.has_dead_man_switch |= !self.map.hold.is_empty();
        held.sticks.insert(code, value);
    }

    /// Deflection of each axis, and the frame of the axes; `None` when no axis is deflected.
    #[must_use]
    pub fn deflection(&self) -> Option<([f64; 6], JogFrame)> {
        let mut axes = [0.0; 6];
        for device in self.devices.values() {
            if device.has_dead_man_switch
                && !self.map.hold.iter().any(|code| device.down.contains(code))
            {
                continue;
            }
            let keys = device.down.iter().filter_map(|code| Some((self.map.keys.get(code)?, 1.0)));
            let sticks = device.sticks.iter();
            let sticks = sticks.filter_map(|(code, way)| Some((self.map.sticks.get(code)?, *way)));
            for (action, way) in keys.chain(sticks) {
                if let Action::Axis(axis, sign) = action {
                    axes[*axis] += sign * way * self.speed;
                }
            }
        }
        let axes = axes.map(|axis: f64| axis.clamp(-1.0, 1.0));
        axes.iter().any(|axis| *axis != 0.0).then_some((axes, self.frame))
    }
}

#[cfg(test)]
mod tests {
    use super::super::map::{DEFAULT_MAP, MapFile};
    use super::*;
    use evdev::{AbsoluteAxisCode, KeyCode};

    fn input_state() -> InputState {
        InputState::new(toml::from_str::<MapFile>(DEFAULT_MAP).unwrap().check().unwrap())
    }

    #[test]
    fn axes_are_deflected_as_long_as_their_keys_are_held() {
        let mut input_state = input_state();
        input_state.connect(0, |_| false);
        assert_eq!(input_state.deflection(), None);
        assert_eq!(input_state.key(0, KeyCode::KEY_3.0, true), None);
        assert_eq!(input_state.key(0, KeyCode::KEY_C.0, true), None);
        input_state.key(0, KeyCode::KEY_E.0, true);
        input_state.key(0, KeyCode::KEY_F.0, true);
        let both = ([0.0, 0.0, 1.0, -1.0, 0.0, 0.0], JogFrame::Tool);
        assert_eq!(input_state.deflection(), Some(both));
        input_state.key(0, KeyCode::KEY_E.0, false);
        assert_eq!(input_state.deflection().unwrap().0[3], -1.0);
        input_state.key(0, KeyCode::KEY_R.0, true);
        assert_eq!(input_state.deflection(), None, "one against the other");
    }

    #[test]
    fn commands_are_sent_once_per_press() {
        let mut input_state = input_state();
        input_state.connect(0, |_| false);
        assert_eq!(input_state.key(0, KeyCode::KEY_K.0, true).as_deref(), Some("manual_cartesian"));
        assert_eq!(input_state.key(0, KeyCode::KEY_K.0, true), None, "the kernel's repeats");
        input_state.key(0, KeyCode::KEY_K.0, false);
        assert!(input_state.key(0, KeyCode::KEY_K.0, true).is_some());
    }

    #[test]
    fn a_gamepad_moves_nothing_without_its_dead_man_s_switch() {
        let mut input_state = input_state();
        input_state.connect(1, |code| code == KeyCode::BTN_TL.0);
        input_state.stick(1, AbsoluteAxisCode::ABS_RY.0, -1.0);
        assert_eq!(input_state.deflection(), None);
        input_state.key(1, KeyCode::BTN_TL.0, true);
        assert!((input_state.deflection().unwrap().0[2] - 0.3).abs() < 1e-12);
        input_state.stick(1, AbsoluteAxisCode::ABS_RY.0, 0.1);
        assert_eq!(input_state.deflection(), None, "the dead zone");
        for bad in [f64::NAN, f64::INFINITY, -1e300] {
            input_state.stick(1, AbsoluteAxisCode::ABS_RY.0, bad);
            assert!(
                input_state
                    .deflection()
                    .is_none_or(|(axes, _)| axes.iter().all(|a| a.abs() <= 1.0))
            );
        }
        input_state.key(1, KeyCode::BTN_TL.0, false);
        assert_eq!(input_state.deflection(), None);
    }

    #[test]
    fn sticks_of_unknown_devices_wait_for_the_dead_man_s_switch() {
        let mut input_state = input_state();
        input_state.connect(1, |_| false);
        input_state.stick(1, AbsoluteAxisCode::ABS_RY.0, -1.0);
        assert_eq!(input_state.deflection(), None);
        input_state.key(1, KeyCode::BTN_TL.0, true);
        assert!(input_state.deflection().is_some());
        input_state.key(1, KeyCode::BTN_TL.0, false);
        assert_eq!(input_state.deflection(), None);
    }

    #[test]
    fn held_keys_are_confirmed_and_lost_presses_are_sent() {
        let mut input_state = input_state();
        input_state.connect(1, |code| code == KeyCode::BTN_TL.0);
        input_state.key(1, KeyCode::KEY_Q.0, true);
        input_state.key(1, KeyCode::KEY_K.0, true);
        input_state.release_all(1);
        for code in [KeyCode::KEY_Q, KeyCode::KEY_K] {
            assert_eq!(input_state.confirm_key(1, code.0), None, "said when it went down");
        }
        let lost = input_state.confirm_key(1, KeyCode::KEY_SPACE.0);
        assert_eq!(lost.as_deref(), Some("stop"), "its press was lost");
        assert_eq!(input_state.deflection(), None, "its dead-man's switch is up");
        input_state.confirm_key(1, KeyCode::BTN_TL.0);
        assert!(input_state.deflection().is_some());
    }

    #[test]
    fn a_press_is_sent_once_however_often_its_state_was_unknown() {
        let mut input_state = input_state();
        input_state.connect(0, |_| false);
        let k = KeyCode::KEY_K.0;
        assert!(input_state.key(0, k, true).is_some());
        for _ in 0..3 {
            input_state.release_all(0);
            input_state.release_all(0);
            assert_eq!(input_state.confirm_key(0, k), None, "it has been down all the time");
        }
        // The key was released and pressed again and the press was lost: it is sent when a report
        // ended in between.
        input_state.release_all(0);
        input_state.end_resynchronisation(0);
        input_state.release_all(0);
        assert!(input_state.confirm_key(0, k).is_some());
        input_state.key(0, k, false);
        assert!(input_state.key(0, k, true).is_some());
    }

    #[test]
    fn an_unplugged_device_holds_nothing() {
        let mut input_state = input_state();
        input_state.connect(0, |_| false);
        input_state.key(0, KeyCode::KEY_Q.0, true);
        assert!(input_state.deflection().is_some());
        input_state.disconnect(0);
        assert_eq!(input_state.deflection(), None);
    }
}
