//! The client's end of the operator's socket: lines to a running machine and lines from it, as
//! `docs/guides/protocol.md` describes them. Nothing here waits for the machine, except where a
//! function says so and for how long.

mod questions;

pub use questions::{MachineAnswer, MachineClient};
pub use serde_json::Value;

use std::collections::VecDeque;
use std::io::{Error, ErrorKind, Read, Write};
use std::os::fd::{AsFd, AsRawFd, BorrowedFd};
use std::os::unix::net::UnixStream;
use std::path::Path;

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::socket::{AddressFamily, SockFlag, SockType, UnixAddr, connect, socket};

/// Default path of the service's socket.
pub const SERVICE_SOCKET: &str = "/run/taktil/operator.sock";

/// Longest line that a machine sends (bytes): it disconnects a client for which more would wait.
const LINE_BYTES_MAX: usize = 2 << 20;
/// Bytes that may wait for the machine; a client that has more to say is too fast.
const OUTPUT_BYTES_MAX: usize = 1 << 16;
/// Bytes that are read at once.
const READ_BYTES_MAX: usize = 1 << 16;

/// A connection to a running machine that never blocks.
#[derive(Debug)]
pub struct OperatorSocket {
    stream: UnixStream,
    input: Vec<u8>,
    /// Bytes of the input in which no line ends.
    looked_through: usize,
    output: VecDeque<u8>,
}

impl OperatorSocket {
    /// Connects to the socket of a run or of the service.
    ///
    /// # Errors
    /// Nobody listens there, or too many others wait to be heard.
    pub fn connect(path: &Path) -> Result<OperatorSocket, Error> {
        let flags = SockFlag::SOCK_NONBLOCK | SockFlag::SOCK_CLOEXEC;
        let end = socket(AddressFamily::Unix, SockType::Stream, flags, None)?;
        connect(end.as_raw_fd(), &UnixAddr::new(path)?)?;
        let (input, output) = (Vec::new(), VecDeque::new());
        Ok(OperatorSocket { stream: UnixStream::from(end), input, looked_through: 0, output })
    }

    /// Sends a line, or as much of it as the machine takes now; [`OperatorSocket::flush`] sends
    /// the rest.
    ///
    /// # Errors
    /// The machine has gone, or takes nothing.
    pub fn send(&mut self, line: &str) -> Result<(), Error> {
        if self.output.len() + line.len() >= OUTPUT_BYTES_MAX {
            return Err(Error::new(ErrorKind::TimedOut, "the machine does not listen"));
        }
        self.output.extend(line.as_bytes());
        self.output.push_back(b'\n');
        self.flush()
    }

    /// Sends what waits, as far as the machine takes it.
    ///
    /// # Errors
    /// The machine has gone.
    pub fn flush(&mut self) -> Result<(), Error> {
        while !self.output.is_empty() {
            let (first, _) = self.output.as_slices();
            match self.stream.write(first) {
                Ok(0) => return Err(gone()),
                Ok(count) => drop(self.output.drain(..count)),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(()),
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// Whether something waits to be sent.
    #[must_use]
    pub fn wants_output(&self) -> bool {
        !self.output.is_empty()
    }

    /// The next line that has come, without its end; `None` when none has.
    ///
    /// # Errors
    /// The machine has gone, or sends a line without an end.
    pub fn receive(&mut self) -> Result<Option<String>, Error> {
        if let Some(line) = self.buffered_line() {
            return Ok(Some(line));
        }
        let mut bytes = vec![0; READ_BYTES_MAX];
        match self.stream.read(&mut bytes) {
            Ok(0) => Err(gone()),
            Ok(count) => {
                self.input.extend_from_slice(&bytes[..count]);
                let line = self.buffered_line();
                if line.is_none() && self.input.len() > LINE_BYTES_MAX {
                    return Err(Error::new(ErrorKind::InvalidData, "a line without an end"));
                }
                Ok(line)
            }
            Err(error)
                if [ErrorKind::WouldBlock, ErrorKind::Interrupted].contains(&error.kind()) =>
            {
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    fn buffered_line(&mut self) -> Option<String> {
        let new = &self.input[self.looked_through..];
        let Some(end) = new.iter().position(|byte| *byte == b'\n') else {
            self.looked_through = self.input.len();
            return None;
        };
        let end = self.looked_through + end;
        let line = String::from_utf8_lossy(&self.input[..end]).into_owned();
        self.input.drain(..=end);
        self.looked_through = 0;
        Some(line)
    }

    /// Waits until something has come, at most for a time (ms).
    pub fn wait(&self, timeout_ms: u16) {
        let mut polled = [PollFd::new(self.stream.as_fd(), PollFlags::POLLIN)];
        // An interrupted wait is a short one.
        let _ = poll(&mut polled, PollTimeout::from(timeout_ms));
    }
}

impl AsFd for OperatorSocket {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.stream.as_fd()
    }
}

fn gone() -> Error {
    Error::new(ErrorKind::UnexpectedEof, "the machine has gone")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::net::UnixListener;

    #[test]
    fn lines_come_whole_however_their_bytes_arrive_and_an_end_is_told() {
        let folder = std::env::temp_dir().join(format!("taktil-client-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("s");
        assert!(OperatorSocket::connect(&path).is_err(), "nobody listens");
        let listener = UnixListener::bind(&path).unwrap();
        let mut here = OperatorSocket::connect(&path).unwrap();
        let (mut there, _) = listener.accept().unwrap();
        assert_eq!(here.receive().unwrap(), None);
        there.write_all(b"one\ntw").unwrap();
        assert_eq!(here.receive().unwrap().as_deref(), Some("one"));
        assert_eq!(here.receive().unwrap(), None);
        there.write_all(b"o\n\nlast").unwrap();
        assert_eq!(here.receive().unwrap().as_deref(), Some("two"));
        assert_eq!(here.receive().unwrap().as_deref(), Some(""));
        here.send("status").unwrap();
        let mut said = [0; 7];
        there.read_exact(&mut said).unwrap();
        assert_eq!(&said, b"status\n");
        // Nobody reads: at last there is too much to say.
        let many = (0..100_000).find(|_| here.send("status").is_err());
        assert!(many.is_some() && here.wants_output());
        drop(there);
        let end = (0..10).find_map(|_| here.receive().err());
        assert!(end.is_some(), "the end is told");
        let _ = std::fs::remove_dir_all(&folder);
    }
}
