//! Writes text for people to standard output and standard error. A reader that has closed its end,
//! such as `head`, is no error. A failed write is an error of the caller on standard output. On
//! standard error it is ignored, because a machine in motion must not end for that reason.
//!
//! A process in which no thread may wait for the reader of its standard error has a thread write
//! it: [`write_errors_behind`].

use std::fmt::Display;
use std::io::{ErrorKind, Write};
use std::sync::OnceLock;

use anyhow::Context;
use taktil_rtcore::Nanos;

use crate::background::BackgroundQueue;

/// Writes a text to standard output without a line end; returns false when its reader is gone.
///
/// # Errors
/// An output that cannot be written, such as a file on a full disk.
pub fn text(text: impl Display) -> anyhow::Result<bool> {
    deliver(&mut std::io::stdout().lock(), &text.to_string())
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
    let text = text.to_string();
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

/// Writes a text to `output`; returns false when its reader is gone.
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
    fn a_closed_pipe_is_distinguished_from_a_full_disk() {
        assert!(deliver(&mut Vec::new(), "words").unwrap());
        assert!(!deliver(&mut Closed(ErrorKind::BrokenPipe), "words").unwrap());
        let full = deliver(&mut Closed(ErrorKind::StorageFull), "words").unwrap_err();
        assert!(format!("{full:#}").starts_with("the output cannot be written: "), "{full:#}");
    }
}
