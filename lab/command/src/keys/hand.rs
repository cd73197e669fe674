//! What is held down, device by device, and what that pushes. Refuses to remember a device that is
//! gone: its keys are up.

use std::collections::{BTreeMap, BTreeSet};

use taktil_signal::JogFrame;

use super::map::{Action, Map};

/// The keys and sticks of one device.
#[derive(Clone, Debug, Default)]
struct Device {
    down: BTreeSet<u16>,
    /// Where each stick is, -1 to 1.
    sticks: BTreeMap<u16, f64>,
    /// It has a dead-man's switch.
    guarded: bool,
    /// What was down when nobody knew any more, and was not seen up or down since.
    before: BTreeSet<u16>,
}

/// All devices.
#[derive(Clone, Debug)]
pub struct Hand {
    map: Map,
    devices: BTreeMap<usize, Device>,
    frame: JogFrame,
    speed: f64,
}

impl Hand {
    /// Nothing is held.
    #[must_use]
    pub fn new(map: Map) -> Hand {
        Hand { map, devices: BTreeMap::new(), frame: JogFrame::Joints, speed: 0.3 }
    }

    /// A device has come that has these keys.
    pub fn plugged(&mut self, device: usize, has: impl Fn(u16) -> bool) {
        let guarded = self.map.hold.iter().any(|code| has(*code));
        self.devices.insert(device, Device { guarded, ..Device::default() });
    }

    /// A device has gone: everything on it is up.
    pub fn unplugged(&mut self, device: usize) {
        self.devices.remove(&device);
    }

    /// Nobody knows what is held on a device: everything on it counts as up.
    pub fn let_go(&mut self, device: usize) {
        if let Some(device) = self.devices.get_mut(&device) {
            device.before.append(&mut device.down);
            device.sticks.clear();
        }
    }

    /// The device has said everything that is held on it: what it did not name is up.
    pub fn all_told(&mut self, device: usize) {
        if let Some(device) = self.devices.get_mut(&device) {
            device.before.clear();
        }
    }

    /// A key turns out to be down: it pushes. If it was up before, its press was lost, and what it
    /// says is said now.
    pub fn still_held(&mut self, device: usize, code: u16) -> Option<String> {
        if let Some(held) = self.devices.get_mut(&device)
            && held.before.remove(&code)
        {
            held.down.insert(code);
            return None;
        }
        self.key(device, code, true)
    }

    /// A key went down or up; what is to be said to the machine. Repeats of the kernel say nothing.
    pub fn key(&mut self, device: usize, code: u16, down: bool) -> Option<String> {
        let held = self.devices.entry(device).or_default();
        // Whoever writes to a pipe does not say which keys there are: the first press shows it.
        held.guarded |= self.map.hold.contains(&code);
        held.before.remove(&code);
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

    /// A stick moved to `value`, -1 to 1.
    pub fn stick(&mut self, device: usize, code: u16, value: f64) {
        let zone = self.map.dead_zone;
        let beyond = ((value.abs().min(1.0) - zone) / (1.0 - zone)).max(0.0);
        let value = if value.is_nan() { 0.0 } else { beyond.copysign(value) };
        let held = self.devices.entry(device).or_default();
        // What has sticks moves nothing unless its dead-man's switch is held.
        held.guarded |= !self.map.hold.is_empty();
        held.sticks.insert(code, value);
    }

    /// How far each axis is pushed, and what the axes are; `None` when nothing is.
    #[must_use]
    pub fn push(&self) -> Option<([f64; 6], JogFrame)> {
        let mut axes = [0.0; 6];
        for device in self.devices.values() {
            if device.guarded && !self.map.hold.iter().any(|code| device.down.contains(code)) {
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
    use super::super::map::{DEFAULT, MapFile};
    use super::*;
    use evdev::{AbsoluteAxisCode, KeyCode};

    fn hand() -> Hand {
        Hand::new(toml::from_str::<MapFile>(DEFAULT).unwrap().check().unwrap())
    }

    #[test]
    fn axes_are_pushed_as_long_as_their_keys_are_held() {
        let mut hand = hand();
        hand.plugged(0, |_| false);
        assert_eq!(hand.push(), None);
        assert_eq!(hand.key(0, KeyCode::KEY_3.0, true), None);
        assert_eq!(hand.key(0, KeyCode::KEY_C.0, true), None);
        hand.key(0, KeyCode::KEY_E.0, true);
        hand.key(0, KeyCode::KEY_F.0, true);
        let both = ([0.0, 0.0, 1.0, -1.0, 0.0, 0.0], JogFrame::Tool);
        assert_eq!(hand.push(), Some(both));
        hand.key(0, KeyCode::KEY_E.0, false);
        assert_eq!(hand.push().unwrap().0[3], -1.0);
        hand.key(0, KeyCode::KEY_R.0, true);
        assert_eq!(hand.push(), None, "one against the other");
    }

    #[test]
    fn words_are_said_once_a_press() {
        let mut hand = hand();
        hand.plugged(0, |_| false);
        assert_eq!(hand.key(0, KeyCode::KEY_K.0, true).as_deref(), Some("manual_cartesian"));
        assert_eq!(hand.key(0, KeyCode::KEY_K.0, true), None, "the kernel's repeats");
        hand.key(0, KeyCode::KEY_K.0, false);
        assert!(hand.key(0, KeyCode::KEY_K.0, true).is_some());
    }

    #[test]
    fn a_gamepad_moves_nothing_without_its_dead_man_s_switch() {
        let mut hand = hand();
        hand.plugged(1, |code| code == KeyCode::BTN_TL.0);
        hand.stick(1, AbsoluteAxisCode::ABS_RY.0, -1.0);
        assert_eq!(hand.push(), None);
        hand.key(1, KeyCode::BTN_TL.0, true);
        assert!((hand.push().unwrap().0[2] - 0.3).abs() < 1e-12);
        hand.stick(1, AbsoluteAxisCode::ABS_RY.0, 0.1);
        assert_eq!(hand.push(), None, "the dead zone");
        for bad in [f64::NAN, f64::INFINITY, -1e300] {
            hand.stick(1, AbsoluteAxisCode::ABS_RY.0, bad);
            assert!(hand.push().is_none_or(|(axes, _)| axes.iter().all(|a| a.abs() <= 1.0)));
        }
        hand.key(1, KeyCode::BTN_TL.0, false);
        assert_eq!(hand.push(), None);
    }

    #[test]
    fn sticks_of_unknown_devices_wait_for_the_dead_man_s_switch() {
        let mut hand = hand();
        hand.plugged(1, |_| false);
        hand.stick(1, AbsoluteAxisCode::ABS_RY.0, -1.0);
        assert_eq!(hand.push(), None);
        hand.key(1, KeyCode::BTN_TL.0, true);
        assert!(hand.push().is_some());
        hand.key(1, KeyCode::BTN_TL.0, false);
        assert_eq!(hand.push(), None);
    }

    #[test]
    fn what_is_found_held_pushes_and_says_what_was_lost() {
        let mut hand = hand();
        hand.plugged(1, |code| code == KeyCode::BTN_TL.0);
        hand.key(1, KeyCode::KEY_Q.0, true);
        hand.key(1, KeyCode::KEY_K.0, true);
        hand.let_go(1);
        for code in [KeyCode::KEY_Q, KeyCode::KEY_K] {
            assert_eq!(hand.still_held(1, code.0), None, "said when it went down");
        }
        let lost = hand.still_held(1, KeyCode::KEY_SPACE.0);
        assert_eq!(lost.as_deref(), Some("stop"), "its press was lost");
        assert_eq!(hand.push(), None, "its dead-man's switch is up");
        hand.still_held(1, KeyCode::BTN_TL.0);
        assert!(hand.push().is_some());
    }

    #[test]
    fn a_press_is_said_once_however_often_it_was_lost_from_sight() {
        let mut hand = hand();
        hand.plugged(0, |_| false);
        let k = KeyCode::KEY_K.0;
        assert!(hand.key(0, k, true).is_some());
        for _ in 0..3 {
            hand.let_go(0);
            hand.let_go(0);
            assert_eq!(hand.still_held(0, k), None, "it has been down all the time");
        }
        // Up and down again, the press was lost: it is said when everything was told in between.
        hand.let_go(0);
        hand.all_told(0);
        hand.let_go(0);
        assert!(hand.still_held(0, k).is_some());
        hand.key(0, k, false);
        assert!(hand.key(0, k, true).is_some());
    }

    #[test]
    fn an_unplugged_device_holds_nothing() {
        let mut hand = hand();
        hand.plugged(0, |_| false);
        hand.key(0, KeyCode::KEY_Q.0, true);
        assert!(hand.push().is_some());
        hand.unplugged(0);
        assert_eq!(hand.push(), None);
    }
}
