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
/// Most looks at the socket in one call of a wait that does not sleep; at a microsecond each they
/// last longer than the longest wait that a configuration may ask for.
const LOOKS_MAX: usize = 1_000_000;

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

    /// Whether the network told since the last [`Port::start_wait`] that nobody listens there.
    fn is_refused(&self) -> bool {
        false
    }
}

/// A UDP socket that is connected to a card.
///
/// System calls: [`SYSTEM_CALLS`](crate::SYSTEM_CALLS).
#[derive(Debug)]
pub struct UdpPort {
    socket: UdpSocket,
    timer: TimerFd,
    calls: usize,
    busy: bool,
    refused: bool,
}

impl UdpPort {
    /// Connects to a card from `local_port`, 0 for any that is free; nothing is sent. With `busy`
    /// a wait asks again and again instead of sleeping.
    ///
    /// # Errors
    /// The system's: the port is in use, no such network, no permission, no file descriptor left.
    pub fn connect(address: &str, local_port: u16, busy: bool) -> io::Result<UdpPort> {
        let any = if address.starts_with('[') { "[::]" } else { "0.0.0.0" };
        let socket = UdpSocket::bind(format!("{any}:{local_port}"))?;
        socket.connect(address)?;
        socket.set_nonblocking(true)?;
        let flags = TimerFlags::TFD_NONBLOCK | TimerFlags::TFD_CLOEXEC;
        let timer = TimerFd::new(ClockId::CLOCK_MONOTONIC, flags)?;
        Ok(UdpPort { socket, timer, calls: 0, busy, refused: false })
    }

    /// Waits for a datagram; whether there may be one.
    fn wait(&self) -> bool {
        let mut ends = [
            PollFd::new(self.socket.as_fd(), PollFlags::POLLIN),
            PollFd::new(self.timer.as_fd(), PollFlags::POLLIN),
        ];
        let pause = if self.busy { PollTimeout::ZERO } else { PollTimeout::NONE };
        for _ in 0..LOOKS_MAX {
            match poll(&mut ends, pause) {
                Ok(0) => core::hint::spin_loop(),
                Ok(_) => return ends[0].any() == Some(true),
                // A signal: look again.
                Err(_) => return true,
            }
        }
        false
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
        self.refused = false;
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
                Err(error) => self.refused |= error.kind() == ErrorKind::ConnectionRefused,
            }
        }
        None
    }

    fn is_refused(&self) -> bool {
        self.refused
    }
}
