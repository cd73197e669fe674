//! The key map: a TOML table from the kernel's names of keys and sticks to actions. Unknown names
//! and actions are errors with their place.

use std::collections::BTreeMap;
use std::str::FromStr;

use evdev::{AbsoluteAxisCode, KeyCode};
use serde::Deserialize;
use taktil_machine::operator::command::{CommandContext, parse};
use taktil_rtcore::Invalid;
use taktil_signal::JogFrame;

/// The key map that is part of the program.
pub const DEFAULT_MAP: &str = include_str!("default.toml");

/// The key map file.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MapFile {
    #[serde(default)]
    hold: Vec<String>,
    #[serde(default)]
    dead_zone: f64,
    #[serde(default)]
    keys: BTreeMap<String, String>,
    #[serde(default)]
    sticks: BTreeMap<String, String>,
}

/// The action of a key or a stick.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// Deflects an axis (0 to 5) in the direction of the sign.
    Axis(usize, f64),
    /// Selects the frame of the axes.
    Frame(JogFrame),
    /// Selects the deflection of a key.
    Speed(f64),
    /// Sends a command to the machine.
    Say(String),
}

/// A checked key map.
#[derive(Clone, Debug, Default)]
pub struct Map {
    /// Dead-man's switches: a device that has one of these keys moves nothing unless one is held.
    pub hold: Vec<u16>,
    /// Fraction of a stick's range about its middle that counts as released.
    pub dead_zone: f64,
    /// Actions of the keys by the kernel's code.
    pub keys: BTreeMap<u16, Action>,
    /// Actions of the sticks by the kernel's code.
    pub sticks: BTreeMap<u16, Action>,
}

impl MapFile {
    /// Checks the file and returns the map.
    ///
    /// # Errors
    /// The first unknown name or action, with its place.
    pub fn check(&self) -> Result<Map, Invalid> {
        if !(0.0..1.0).contains(&self.dead_zone) {
            let what = format!("{} is no part of a stick's way", self.dead_zone);
            return Err(Invalid::new("dead_zone", what, "give 0 to less than 1"));
        }
        let mut map = Map { dead_zone: self.dead_zone, ..Map::default() };
        for (index, name) in self.hold.iter().enumerate() {
            map.hold.push(key(name).map_err(|bad| bad.within(&format!("hold[{index}]")))?);
        }
        for (name, words) in &self.keys {
            let place = format!("keys.{name}");
            let code = key(name).map_err(|bad| bad.within(&place))?;
            map.keys.insert(code, action(words).map_err(|bad| bad.within(&place))?);
        }
        for (name, words) in &self.sticks {
            let place = format!("sticks.{name}");
            let Ok(AbsoluteAxisCode(code)) = AbsoluteAxisCode::from_str(name) else {
                let remedy = "names are those of the kernel: ABS_X, ABS_RY, ABS_HAT0X";
                return Err(Invalid::new(place, "there is no such stick", remedy));
            };
            match action(words).map_err(|bad| bad.within(&place))? {
                axis @ Action::Axis(..) => map.sticks.insert(code, axis),
                _ => {
                    let what = format!("a stick cannot do `{words}`");
                    return Err(Invalid::new(place, what, "give an axis: \"axis +1\""));
                }
            };
        }
        Ok(map)
    }
}

fn key(name: &str) -> Result<u16, Invalid> {
    KeyCode::from_str(name).map(|code| code.0).map_err(|_| {
        let remedy = "names are those of the kernel: KEY_A, KEY_SPACE, BTN_SOUTH";
        Invalid::new("", format!("there is no key `{name}`"), remedy)
    })
}

fn action(words: &str) -> Result<Action, Invalid> {
    let parts: Vec<&str> = words.split_whitespace().collect();
    match parts[..] {
        ["axis", which] => {
            let number = which.parse::<i8>().ok().filter(|n| (1..=6).contains(&n.abs()));
            let number = number.ok_or_else(|| {
                let what = format!("there is no axis `{which}`");
                Invalid::new("", what, "axes are +1 to +6 and -1 to -6")
            })?;
            Ok(Action::Axis(usize::from(number.unsigned_abs()) - 1, f64::from(number.signum())))
        }
        ["frame", name] => {
            let frame = JogFrame::ALL.into_iter().find(|frame| frame.name() == name);
            frame.map(Action::Frame).ok_or_else(|| {
                let what = format!("there is no frame `{name}`");
                Invalid::new("", what, "frames are: joints, base, tool, outer")
            })
        }
        ["speed", share] => {
            let share = share.parse::<f64>().ok().filter(|share| *share > 0.0 && *share <= 1.0);
            let what = format!("`{words}` is no speed");
            share.map(Action::Speed).ok_or_else(|| Invalid::new("", what, "give 0 to 1"))
        }
        _ => match parse(words, &CommandContext::default()) {
            Ok(Some(_)) => Ok(Action::Say(words.to_owned())),
            Ok(None) => Err(Invalid::new("", "does nothing", "take the key out")),
            Err(bad) => Err(Invalid::new("", bad.what, bad.remedy)),
        },
    }
}

/// The key of a character, for terminals; `None` for characters without a key.
#[must_use]
pub fn key_of(character: u8) -> Option<u16> {
    let name = match character {
        b'a'..=b'z' => format!("KEY_{}", character.to_ascii_uppercase() as char),
        b'0'..=b'9' => format!("KEY_{}", character as char),
        b' ' => "KEY_SPACE".to_owned(),
        _ => return None,
    };
    key(&name).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Map, Invalid> {
        toml::from_str::<MapFile>(text).unwrap().check()
    }

    #[test]
    fn the_map_that_comes_with_the_program_is_sound_and_reaches_every_axis() {
        let map = read(DEFAULT_MAP).unwrap();
        for axis in 0..6 {
            for sign in [-1.0, 1.0] {
                assert!(map.keys.values().any(|action| *action == Action::Axis(axis, sign)));
            }
        }
        assert_eq!(map.keys[&KeyCode::KEY_SPACE.0], Action::Say("stop".into()));
        assert_eq!(key_of(b' '), Some(KeyCode::KEY_SPACE.0));
        assert_eq!((key_of(b'q'), key_of(b'\n')), (Some(KeyCode::KEY_Q.0), None));
    }

    #[test]
    fn unknown_names_and_actions_are_rejected_with_their_place() {
        for (text, place) in [
            ("dead_zone = 1.0", "dead_zone"),
            ("dead_zone = nan", "dead_zone"),
            ("hold = [\"BTN_NOSE\"]", "hold[0]"),
            ("[keys]\nKEY_NOSE = \"idle\"", "keys.KEY_NOSE"),
            ("[keys]\nKEY_A = \"axis 0\"", "keys.KEY_A"),
            ("[keys]\nKEY_A = \"axis +7\"", "keys.KEY_A"),
            ("[keys]\nKEY_A = \"frame world\"", "keys.KEY_A"),
            ("[keys]\nKEY_A = \"speed 2\"", "keys.KEY_A"),
            ("[keys]\nKEY_A = \"fly\"", "keys.KEY_A"),
            ("[keys]\nKEY_A = \"\"", "keys.KEY_A"),
            ("[sticks]\nABS_NOSE = \"axis +1\"", "sticks.ABS_NOSE"),
            ("[sticks]\nABS_X = \"idle\"", "sticks.ABS_X"),
        ] {
            assert_eq!(read(text).unwrap_err().place, place, "{text}");
        }
    }
}
