//! Writes text for people to standard output and standard error, without the characters that a
//! terminal would obey: what they hold may come from a file of somebody else. A reader that has
//! closed its end, such as `head`, is no error. A failed write is an error of the caller on
//! standard output. On standard error it is ignored, because a machine in motion must not end for
//! that reason.
//!
//! A process in which no thread may wait for the reader of its standard error has a thread write
//! it: [`write_errors_behind`].

use std::borrow::Cow;
use std::fmt::Display;
use std::io::{ErrorKind, Write};
use std::sync::OnceLock;

use anyhow::Context;
use taktil_rtcore::Nanos;
use taktil_rtcore::printable::{escaped, excerpt};

use crate::background::BackgroundQueue;

/// Writes a text to standard output without a line end; returns false when its reader is gone.
///
/// # Errors
/// An output that cannot be written, such as a file on a full disk.
pub fn text(text: impl Display) -> anyhow::Result<bool> {
    deliver(&mut std::io::stdout().lock(), &shown(&text.to_string()))
}

/// The text as it is written: carriage returns stay in front, where they begin a line anew, and at
/// the ends of lines, where a terminal in raw mode needs them.
fn shown(text: &str) -> Cow<'_, str> {
    if let Cow::Borrowed(text) = escaped(text) {
        return Cow::Borrowed(text);
    }
    let (front, rest) = text.split_at(usize::from(text.starts_with('\r')));
    let lines: Vec<Cow<'_, str>> = rest.split("\r\n").map(escaped).collect();
    Cow::Owned(format!("{front}{}", lines.join("\r\n")))
}

/// Longest complaint (bytes).
const COMPLAINT_BYTES_MAX: usize = 2000;

/// Writes an error with its causes to standard error, in one paragraph of bounded length.
pub fn complain(error: &anyhow::Error) {
    let text = format!("error: {error:#}");
    match text.len() <= COMPLAINT_BYTES_MAX {
        true => warn(text),
        false => warn(excerpt(&text, COMPLAINT_BYTES_MAX)),
    }
}

/// Writes a text and a line end, like [`text`].
///
/// # Errors
/// As [`text`].
pub fn line(line: impl Display) -> anyhow::Result<bool> {
    text(format_args!("{line}\n"))
}

/// Writes a line to standard error.
pub fn warn(line: impl Display) {
    hint(format_args!("{line}\n"));
}

/// Writes a text to standard error without a line end.
pub fn hint(text: impl Display) {
    let text = shown(&text.to_string()).into_owned();
    match ERRORS.get() {
        None => write_error(&text),
        Some(errors) => errors.send(text),
    }
}

fn write_error(text: &str) {
    // One write keeps the texts of two threads apart; a closed standard error is ignored.
    let _ = std::io::stderr().lock().write_all(text.as_bytes());
}

/// Texts that may wait for the reader of standard error; those beyond are dropped and counted.
const QUEUED_TEXTS_MAX: usize = 1024;

/// The texts for the thread that writes standard error, once there is one.
static ERRORS: OnceLock<BackgroundQueue<String>> = OnceLock::new();

/// From now on a thread writes standard error, for the whole process: nobody else waits for its
/// reader. What finds no room is dropped, and the next text says how many were.
///
/// # Errors
/// The operating system gives no thread.
pub fn write_errors_behind() -> std::io::Result<()> {
    let queue = BackgroundQueue::start("journal", QUEUED_TEXTS_MAX, |text: String, dropped| {
        if dropped > 0 {
            write_error(&format!("{dropped} lines found no room and are lost\n"));
        }
        write_error(&text);
    });
    // A second call finds the thread of the first one.
    let _ = ERRORS.set(queue?);
    Ok(())
}

/// Waits until all texts of this process are written, for `patience` at most.
pub fn flush_errors(patience: Nanos) {
    if let Some(errors) = ERRORS.get() {
        errors.flush(patience);
    }
}

/// Writes a text to `output` as it is; returns false when its reader is gone.
///
/// # Errors
/// As [`text`].
pub fn deliver(output: &mut dyn Write, text: &str) -> anyhow::Result<bool> {
    match output.write_all(text.as_bytes()).and_then(|()| output.flush()) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(false),
        Err(error) => Err(error).context("the output cannot be written"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Closed(ErrorKind);

    impl Write for Closed {
        fn write(&mut self, _bytes: &[u8]) -> std::io::Result<usize> {
            Err(self.0.into())
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn only_the_carriage_returns_of_the_program_itself_reach_a_terminal() {
        for (text, written) in [
            ("three\nlines\n", "three\nlines\n"),
            ("\rpair 3 of 4", "\rpair 3 of 4"),
            ("raw\r\n", "raw\r\n"),
            ("a\rb\u{1b}[2J\r\n", "a\\u000db\\u001b[2J\r\n"),
        ] {
            assert_eq!(shown(text), written);
        }
    }

    #[test]
    fn a_closed_pipe_is_distinguished_from_a_full_disk() {
        assert!(deliver(&mut Vec::new(), "words").unwrap());
        assert!(!deliver(&mut Closed(ErrorKind::BrokenPipe), "words").unwrap());
        let full = deliver(&mut Closed(ErrorKind::StorageFull), "words").unwrap_err();
        assert!(format!("{full:#}").starts_with("the output cannot be written: "), "{full:#}");
    }
}
