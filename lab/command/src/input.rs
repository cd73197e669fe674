//! Lines of the standard input for a program that goes on with something else meanwhile.
#![expect(clippy::disallowed_types, reason = "a person is waited for, far from any lane")]

use std::io::BufRead as _;
use std::sync::mpsc::{Receiver, channel};

/// The lines, as they come, until the input ends: they are read in a thread of their own.
pub(crate) fn lines_of_input() -> Receiver<String> {
    let (sender, lines) = channel();
    std::thread::spawn(move || {
        for line in std::io::stdin().lock().lines().map_while(Result::ok) {
            if sender.send(line).is_err() {
                break;
            }
        }
    });
    lines
}
