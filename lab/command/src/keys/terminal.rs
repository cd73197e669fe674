//! Keys from a terminal or a pipe, where nobody says that a key went up: each character counts as
//! held for a moment, and the terminal's repeats hold it on. Refuses to leave a terminal as it
//! found it useful: the settings of before come back.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::io::{IsTerminal, Read};

use nix::sys::termios::{LocalFlags, SetArg, Termios, tcgetattr, tcsetattr};
use taktil_hal::Nanos;
use taktil_hal::link::{Receiver, link};

use super::hand::Hand;
use super::map::key_of;

/// Looks for which a character counts as held.
const HELD_POLLS: u32 = 15;
/// Characters that wait.
const QUEUED_CHARACTERS_MAX: usize = 256;

/// Standard input, character by character.
pub(super) struct Terminal {
    /// Nothing for the end of the input.
    characters: RefCell<Receiver<Option<u8>>>,
    ended: Cell<bool>,
    before: Option<Termios>,
}

impl Terminal {
    /// Standard input without lines and echo, if it is a terminal.
    pub(super) fn open() -> anyhow::Result<Terminal> {
        let input = std::io::stdin();
        let before = if input.is_terminal() { Some(tcgetattr(&input)?) } else { None };
        if let Some(before) = &before {
            let mut raw = before.clone();
            raw.local_flags.remove(LocalFlags::ICANON | LocalFlags::ECHO);
            tcsetattr(&input, SetArg::TCSANOW, &raw)?;
        }
        let (mut characters, receiver) = link(QUEUED_CHARACTERS_MAX);
        // Ends with the process: a read from a terminal cannot be called off.
        std::thread::Builder::new().name("stdin".into()).spawn(move || {
            let bytes = std::io::stdin().lock().bytes().map_while(Result::ok);
            // A full ring makes the typist wait: what was typed may be the word to stop.
            for word in bytes.map(Some).chain([None]) {
                while characters.send(word, Nanos::ZERO, Nanos::ZERO).is_err() {
                    std::thread::sleep(super::POLL_PERIOD);
                }
            }
        })?;
        Ok(Terminal { characters: receiver.into(), ended: Cell::new(false), before })
    }

    /// What was typed since the last look; `None` once nothing more will come.
    pub(super) fn characters(&self) -> Option<Vec<u8>> {
        let mut receiver = self.characters.borrow_mut();
        let mut typed = Vec::new();
        while let Some(word) = receiver.next(Nanos(i64::MAX)) {
            match word.value {
                Some(byte) => typed.push(byte),
                None => self.ended.set(true),
            }
        }
        (!self.ended.get() || !typed.is_empty()).then_some(typed)
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        if let Some(before) = &self.before {
            let _ = tcsetattr(std::io::stdin(), SetArg::TCSANOW, before);
        }
    }
}

/// Characters that count as held.
#[derive(Debug, Default)]
pub(super) struct Presses {
    left: BTreeMap<u16, u32>,
}

impl Presses {
    /// True while one is held.
    pub(super) fn any(&self) -> bool {
        !self.left.is_empty()
    }

    /// One look: what was typed goes down, what was not repeated in time goes up.
    pub(super) fn take(&mut self, characters: &[u8], hand: &mut Hand) -> Vec<String> {
        self.left.retain(|code, left| {
            *left -= 1;
            if *left == 0 {
                hand.key(0, *code, false);
            }
            *left > 0
        });
        let mut said = Vec::new();
        for code in characters.iter().filter_map(|character| key_of(*character)) {
            said.extend(hand.key(0, code, true));
            self.left.insert(code, HELD_POLLS);
        }
        said
    }
}

#[cfg(test)]
mod tests {
    use super::super::map::{DEFAULT, MapFile};
    use super::*;

    #[test]
    fn a_character_is_held_for_a_moment_and_its_repeats_hold_it_on() {
        let map = toml::from_str::<MapFile>(DEFAULT).unwrap().check().unwrap();
        let mut hand = Hand::new(map);
        hand.plugged(0, |_| false);
        let mut presses = Presses::default();
        assert!(presses.take(b"e", &mut hand).is_empty());
        for look in 0..40 {
            assert!(hand.push().is_some(), "{look}");
            presses.take(if look < 20 { b"e" } else { b"" }, &mut hand);
            if look == 34 {
                break;
            }
        }
        presses.take(b"", &mut hand);
        assert!(hand.push().is_none() && !presses.any());
        assert_eq!(presses.take(b"k", &mut hand), ["manual_cartesian"]);
    }
}
