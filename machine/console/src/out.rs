//! Writes text for people to standard output and standard error. A reader who has gone, such as
//! `head`, is no error. An output that cannot be written is the caller's error on standard output;
//! on standard error it is ignored, because a machine in motion does not end for that.

use std::fmt::Display;
use std::io::{ErrorKind, Write};

use anyhow::Context;

/// Writes a text to standard output as it is; false when nobody reads there any more.
///
/// # Errors
/// An output that cannot be written, such as a file on a full disk.
pub fn text(text: impl Display) -> anyhow::Result<bool> {
    deliver(&mut std::io::stdout().lock(), &text.to_string())
}

/// As [`text`], and ends the line.
///
/// # Errors
/// As [`text`].
pub fn line(line: impl Display) -> anyhow::Result<bool> {
    text(format_args!("{line}\n"))
}

/// A line on standard error.
pub fn warn(line: impl Display) {
    hint(format_args!("{line}\n"));
}

/// As [`warn`], and goes on in the same line.
pub fn hint(text: impl Display) {
    // In one piece, so that two threads do not mix their words; whoever closed it wants none.
    let _ = std::io::stderr().lock().write_all(text.to_string().as_bytes());
}

/// Writes to `output`; false when its reader has gone.
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
    fn a_reader_who_has_gone_is_told_apart_from_a_full_disk() {
        assert!(deliver(&mut Vec::new(), "words").unwrap());
        assert!(!deliver(&mut Closed(ErrorKind::BrokenPipe), "words").unwrap());
        let full = deliver(&mut Closed(ErrorKind::StorageFull), "words").unwrap_err();
        assert!(format!("{full:#}").starts_with("the output cannot be written: "), "{full:#}");
    }
}
