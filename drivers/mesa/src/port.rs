//! The link to a card: a trait for datagrams, and its implementation by a UDP socket that is
//! connected and never blocks beyond the declared time.

use std::io::{self, ErrorKind};
use std::net::UdpSocket;
use std::os::fd::AsFd;
use std::time::Duration;

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::time::TimeSpec;
use nix::sys::timerfd::{ClockId, Expiration, TimerFd, TimerFlags, TimerSetTimeFlags};
use taktil_hal::Nanos;

/// Most calls of `recv` in one wait: each error of the network ends one of them.
const RECEIVE_CALLS_MAX: usize = 64;

/// A link that carries datagrams to a card and back. The card's own process and a model of it in
/// this process are both behind it.
pub trait Port: Send {
    /// Hands a datagram over; it may be lost.
    ///
    /// # Errors
    /// The system's, without allocating.
    fn send(&mut self, packet: &[u8]) -> io::Result<()>;

    /// Begins a wait: the calls of [`Port::receive`] that follow return within `wait` in all.
    fn start_wait(&mut self, wait: Nanos);

    /// The next datagram, with its length; `None` when the wait is over. A datagram that is longer
    /// than the buffer is cut.
    fn receive(&mut self, buffer: &mut [u8]) -> Option<usize>;
}

/// A UDP socket that is connected to a card.
///
/// System calls: `send`, `recv`, `poll`, `timerfd_settime`.
#[derive(Debug)]
pub struct UdpPort {
    socket: UdpSocket,
    timer: TimerFd,
    calls: usize,
}

impl UdpPort {
    /// Connects to a card; nothing is sent.
    ///
    /// # Errors
    /// The system's: no such network, no permission, no file descriptor left.
    pub fn connect(address: &str) -> io::Result<UdpPort> {
        let any = if address.starts_with('[') { "[::]:0" } else { "0.0.0.0:0" };
        let socket = UdpSocket::bind(any)?;
        socket.connect(address)?;
        socket.set_nonblocking(true)?;
        let flags = TimerFlags::TFD_NONBLOCK | TimerFlags::TFD_CLOEXEC;
        let timer = TimerFd::new(ClockId::CLOCK_MONOTONIC, flags)?;
        Ok(UdpPort { socket, timer, calls: 0 })
    }

    /// Waits for a datagram; whether there may be one.
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

impl Port for UdpPort {
    fn send(&mut self, packet: &[u8]) -> io::Result<()> {
        match self.socket.send(packet) {
            // The error of an earlier datagram, reported late: this one was not sent.
            Err(error) if error.kind() == ErrorKind::ConnectionRefused => {
                self.socket.send(packet).map(drop)
            }
            other => other.map(drop),
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

    fn receive(&mut self, buffer: &mut [u8]) -> Option<usize> {
        while self.calls > 0 {
            self.calls -= 1;
            match self.socket.recv(buffer) {
                Ok(bytes) => return Some(bytes),
                Err(error) if error.kind() == ErrorKind::WouldBlock => {
                    if !self.wait() {
                        self.calls = 0;
                    }
                }
                // An error of the network, such as a port that nobody listens on, is read once.
                Err(_) => {}
            }
        }
        None
    }
}
