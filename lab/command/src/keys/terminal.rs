//! Keys from a terminal or a pipe, which report no release: each character counts as held for a
//! moment, and the terminal's repeats extend it. The settings of the terminal are restored at the
//! end.

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::io::{IsTerminal, Read};

use nix::sys::termios::{LocalFlags, SetArg, Termios, tcgetattr, tcsetattr};
use taktil_hal::Nanos;
use taktil_hal::link::{Receiver, link};

use super::input_state::InputState;
use super::map::key_of;

/// Number of polls for which a character counts as held.
const HOLD_POLLS: u32 = 15;
/// Number of characters that can wait.
const QUEUE_CAPACITY: usize = 256;

/// Standard input, character by character.
pub(super) struct Terminal {
    /// Received characters; `None` marks the end of the input.
    characters: RefCell<Receiver<Option<u8>>>,
    ended: Cell<bool>,
    before: Option<Termios>,
}

impl Terminal {
    /// Opens standard input; a terminal is switched to unbuffered input without echo.
    pub(super) fn open() -> anyhow::Result<Terminal> {
        let input = std::io::stdin();
        let before = if input.is_terminal() { Some(tcgetattr(&input)?) } else { None };
        if let Some(before) = &before {
            let mut raw = before.clone();
            raw.local_flags.remove(LocalFlags::ICANON | LocalFlags::ECHO);
            tcsetattr(&input, SetArg::TCSANOW, &raw)?;
        }
        let (mut characters, receiver) = link(QUEUE_CAPACITY);
        // The thread ends with the process, because a read from a terminal cannot be cancelled.
        std::thread::Builder::new().name("stdin".into()).spawn(move || {
            let bytes = std::io::stdin().lock().bytes().map_while(Result::ok);
            // A full queue blocks the reader and drops nothing, because a character may be the
            // command to stop.
            for word in bytes.map(Some).chain([None]) {
                while characters.send(word, Nanos::ZERO, Nanos::ZERO).is_err() {
                    std::thread::sleep(super::POLL_INTERVAL);
                }
            }
        })?;
        Ok(Terminal { characters: receiver.into(), ended: Cell::new(false), before })
    }

    /// The characters since the last poll; `None` after the end of the input.
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
pub(super) struct TimedPresses {
    left: BTreeMap<u16, u32>,
}

impl TimedPresses {
    /// True while a character counts as held.
    pub(super) fn is_any_held(&self) -> bool {
        !self.left.is_empty()
    }

    /// Processes one poll: typed keys are pressed, keys that were not repeated in time are
    /// released.
    pub(super) fn take(&mut self, characters: &[u8], input_state: &mut InputState) -> Vec<String> {
        self.left.retain(|code, left| {
            *left -= 1;
            if *left == 0 {
                input_state.key(0, *code, false);
            }
            *left > 0
        });
        let mut said = Vec::new();
        for code in characters.iter().filter_map(|character| key_of(*character)) {
            said.extend(input_state.key(0, code, true));
            self.left.insert(code, HOLD_POLLS);
        }
        said
    }
}

#[cfg(test)]
mod tests {
    use super::super::map::{DEFAULT_MAP, MapFile};
    use super::*;

    #[test]
    fn a_character_counts_as_held_for_a_moment_and_repeats_extend_it() {
        let map = toml::from_str::<MapFile>(DEFAULT_MAP).unwrap().check().unwrap();
        let mut input_state = InputState::new(map);
        input_state.connect(0, |_| false);
        let mut presses = TimedPresses::default();
        assert!(presses.take(b"e", &mut input_state).is_empty());
        for look in 0..40 {
            assert!(input_state.deflection().is_some(), "{look}");
            presses.take(if look < 20 { b"e" } else { b"" }, &mut input_state);
            if look == 34 {
                break;
            }
        }
        presses.take(b"", &mut input_state);
        assert!(input_state.deflection().is_none() && !presses.is_any_held());
        assert_eq!(presses.take(b"k", &mut input_state), ["manual_cartesian"]);
    }
}
