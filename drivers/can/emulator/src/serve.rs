//! Joins an emulator with a link, such as a socket, until it is told to end.

use std::io::{self, ErrorKind};
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::path::Path;
use std::time::Duration;

use taktil_hal::Clock;

use crate::emulator::Emulator;

/// Longest time between two looks at what is due and whether to go on.
const WAIT_TIME: Duration = Duration::from_millis(5);
/// Shortest wait: below it a time-out would mean none.
const WAIT_TIME_MIN: Duration = Duration::from_micros(20);
/// Room for a frame.
const FRAME_BYTES_MAX: usize = 128;

/// What carries frames to a host and back, each as Linux lays it out.
pub trait Link {
    /// Waits at most for `wait` for a frame; its length, `None` when none came.
    ///
    /// # Errors
    /// The link is broken.
    fn receive(&mut self, bytes: &mut [u8], wait: Duration) -> io::Result<Option<usize>>;

    /// Hands a frame to the host, who may be gone.
    fn send(&mut self, bytes: &[u8]);
}

impl Link for UnixDatagram {
    fn receive(&mut self, bytes: &mut [u8], wait: Duration) -> io::Result<Option<usize>> {
        self.set_read_timeout(Some(wait))?;
        match self.recv(bytes) {
            Ok(count) => Ok(Some(count)),
            Err(error) if is_passing(error.kind()) => Ok(None),
            Err(error) => Err(error),
        }
    }

    fn send(&mut self, bytes: &[u8]) {
        let _ = UnixDatagram::send(self, bytes);
    }
}

/// A socket of Unix at a path, behind which hosts come and go: answers go to whoever spoke last.
#[derive(Debug)]
pub struct PathLink {
    socket: UnixDatagram,
    peer: Option<SocketAddr>,
}

impl PathLink {
    /// Listens at a path, where nothing may be.
    ///
    /// # Errors
    /// The system's.
    pub fn bind(path: &Path) -> io::Result<PathLink> {
        Ok(PathLink { socket: UnixDatagram::bind(path)?, peer: None })
    }
}

impl Link for PathLink {
    fn receive(&mut self, bytes: &mut [u8], wait: Duration) -> io::Result<Option<usize>> {
        self.socket.set_read_timeout(Some(wait))?;
        match self.socket.recv_from(bytes) {
            Ok((count, from)) => {
                self.peer = Some(from);
                Ok(Some(count))
            }
            Err(error) if is_passing(error.kind()) => Ok(None),
            Err(error) => Err(error),
        }
    }

    fn send(&mut self, bytes: &[u8]) {
        if let Some(peer) = &self.peer {
            let _ = self.socket.send_to_addr(bytes, peer);
        }
    }
}

fn is_passing(kind: ErrorKind) -> bool {
    matches!(kind, ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted)
}

/// Answers on `link` as long as `goes_on` says so.
///
/// # Errors
/// The link is broken.
pub fn serve(
    emulator: &mut Emulator,
    link: &mut dyn Link,
    clock: &dyn Clock,
    goes_on: &mut dyn FnMut() -> bool,
) -> io::Result<()> {
    let mut buffer = [0; FRAME_BYTES_MAX];
    let mut frames = Vec::new();
    while goes_on() {
        let now = clock.now();
        let wait = emulator
            .next_due()
            .map_or(WAIT_TIME, |due| Duration::from_nanos((due - now).0.max(0).cast_unsigned()));
        let wait = wait.clamp(WAIT_TIME_MIN, WAIT_TIME);
        if let Some(count) = link.receive(&mut buffer, wait)? {
            emulator.receive(clock.now(), &buffer[..count]);
        }
        emulator.poll(clock.now(), &mut frames);
        for frame in frames.drain(..) {
            link.send(&frame);
        }
    }
    Ok(())
}
