//! The link to a bus: a trait for frames, and its implementation by a socket that never blocks
//! beyond the declared time, be it one of the kernel's CAN interfaces or one of Unix behind which
//! another process has a bus.

use std::io::ErrorKind;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd};
use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::time::Duration;

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::socket::{MsgFlags, recv, send};
use nix::sys::time::TimeSpec;
use nix::sys::timerfd::{ClockId, Expiration, TimerFd, TimerFlags, TimerSetTimeFlags};
use taktil_hal::Nanos;

use crate::frame::{FLEXIBLE_BYTES, Frame};
use crate::socket;

/// Most calls of `recv` in one wait: a bus at 1 Mbit/s carries some 10 frames a millisecond.
const RECEIVE_CALLS_MAX: usize = 4_096;

/// Errors and strange datagrams that are passed over in one look.
const OTHERS_MAX: usize = 16;

/// Buses behind sockets of Unix that one process opens at most.
const OWN_SOCKETS_MAX: u32 = 64;

/// Why a frame was not handed over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SendError {
    /// The queue of the interface is full.
    Full,
    /// The interface is down or gone, or nobody is behind the socket.
    Down,
}

/// A link that carries frames to a bus and back. A bus in another process and a model of one in
/// this process are both behind it.
pub trait Port: Send {
    /// Hands a frame over; it may be lost.
    ///
    /// # Errors
    /// The frame was not handed over; nothing was tried again.
    fn send(&mut self, frame: &Frame) -> Result<(), SendError>;

    /// Begins a wait: the calls of [`Port::receive`] that follow return within `wait` in all.
    fn start_wait(&mut self, wait: Nanos);

    /// The next frame; `None` when the wait is over.
    fn receive(&mut self) -> Option<Frame>;

    /// The next frame that has arrived already, without a wait.
    fn receive_now(&mut self) -> Option<Frame>;
}

/// What a look at the socket found.
enum Look {
    Frame(Frame),
    Nothing,
    /// An error, or bytes that are no frame.
    Other,
}

/// A socket with an address of its own, to which the other side sends.
fn own_socket() -> std::io::Result<UnixDatagram> {
    let mut outcome = Err(ErrorKind::AddrInUse.into());
    for number in 0..OWN_SOCKETS_MAX {
        let name = format!("taktil-can-{}-{number}", std::process::id());
        outcome = UnixDatagram::bind_addr(&SocketAddr::from_abstract_name(name)?);
        if outcome.is_ok() {
            break;
        }
    }
    outcome
}

/// A socket that carries frames as the kernel lays them out, one a datagram.
///
/// System calls: [`SYSTEM_CALLS`](crate::SYSTEM_CALLS).
#[derive(Debug)]
pub struct SocketPort {
    socket: OwnedFd,
    timer: TimerFd,
    calls: usize,
    queue_frames: Option<u32>,
}

impl SocketPort {
    /// Opens an interface of the kernel such as `can0`, or, when the name holds a `/`, a socket of
    /// Unix at that path.
    ///
    /// # Errors
    /// The system's: no such interface, no permission, nobody listens at the path.
    pub fn open(name: &str) -> std::io::Result<SocketPort> {
        if !name.contains('/') {
            let socket = socket::open(name)?;
            let queue_frames = Some(socket::queue_frames(&socket, name)?).filter(|n| *n > 0);
            return Ok(SocketPort { queue_frames, ..SocketPort::from_socket(socket)? });
        }
        let socket = own_socket()?;
        socket.connect(name)?;
        SocketPort::from_socket(socket.into())
    }

    /// Takes a socket that exists already, such as one end of a pair.
    ///
    /// # Errors
    /// The system's: no file descriptor left for the timer.
    pub fn from_socket(socket: OwnedFd) -> std::io::Result<SocketPort> {
        let flags = TimerFlags::TFD_NONBLOCK | TimerFlags::TFD_CLOEXEC;
        let timer = TimerFd::new(ClockId::CLOCK_MONOTONIC, flags)?;
        Ok(SocketPort { socket, timer, calls: 0, queue_frames: None })
    }

    /// Frames that the queue of the kernel's interface holds; `None` where there is none.
    #[must_use]
    pub fn queue_frames(&self) -> Option<u32> {
        self.queue_frames
    }

    fn take(&self) -> Look {
        let mut bytes = [0; FLEXIBLE_BYTES];
        match recv(self.socket.as_raw_fd(), &mut bytes, MsgFlags::MSG_DONTWAIT) {
            Ok(count) => bytes.get(..count).and_then(Frame::read).map_or(Look::Other, Look::Frame),
            Err(Errno::EAGAIN) => Look::Nothing,
            // An interface that is down reports it once; what comes of it is silence.
            Err(_) => Look::Other,
        }
    }

    /// Waits for a frame; whether there may be one.
    fn wait(&self) -> bool {
        let mut ends = [
            PollFd::new(self.socket.as_fd(), PollFlags::POLLIN),
            PollFd::new(self.timer.as_fd(), PollFlags::POLLIN),
        ];
        match poll(&mut ends, PollTimeout::NONE) {
            Ok(_) => ends[0].any() == Some(true),
            // A signal: look again.
            Err(_) => true,
        }
    }
}

impl AsFd for SocketPort {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

impl Port for SocketPort {
    fn send(&mut self, frame: &Frame) -> Result<(), SendError> {
        let mut bytes = [0; FLEXIBLE_BYTES];
        let count = frame.write(&mut bytes);
        let flags = MsgFlags::MSG_DONTWAIT | MsgFlags::MSG_NOSIGNAL;
        match send(self.socket.as_raw_fd(), &bytes[..count], flags) {
            Ok(_) => Ok(()),
            Err(Errno::ENOBUFS | Errno::EAGAIN) => Err(SendError::Full),
            Err(_) => Err(SendError::Down),
        }
    }

    fn start_wait(&mut self, wait: Nanos) {
        let wait = Duration::from_nanos(wait.0.max(1).cast_unsigned());
        let once = Expiration::OneShot(TimeSpec::from_duration(wait));
        self.calls = RECEIVE_CALLS_MAX;
        if self.timer.set(once, TimerSetTimeFlags::empty()).is_err() {
            // Without the timer nothing would end a wait.
            self.calls = 0;
        }
    }

    fn receive(&mut self) -> Option<Frame> {
        while self.calls > 0 {
            self.calls -= 1;
            match self.take() {
                Look::Frame(frame) => return Some(frame),
                Look::Nothing => {
                    if !self.wait() {
                        self.calls = 0;
                    }
                }
                Look::Other => {}
            }
        }
        None
    }

    fn receive_now(&mut self) -> Option<Frame> {
        for _ in 0..OTHERS_MAX {
            match self.take() {
                Look::Frame(frame) => return Some(frame),
                Look::Nothing => return None,
                Look::Other => {}
            }
        }
        None
    }
}
