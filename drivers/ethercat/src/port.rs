//! The cable to a segment: a trait for Ethernet frames, and its implementation by a raw socket that
//! never blocks beyond the declared time.
#![allow(unsafe_code)]

use std::io;
use std::os::fd::{AsFd, AsRawFd, OwnedFd};
use std::time::Duration;

use nix::errno::Errno;
use nix::net::if_::if_nametoindex;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::sys::socket::{
    AddressFamily, LinkAddr, MsgFlags, SockFlag, SockType, SockaddrLike, bind, recv, send, socket,
};
use nix::sys::time::TimeSpec;
use nix::sys::timerfd::{ClockId, Expiration, TimerFd, TimerFlags, TimerSetTimeFlags};
use taktil_hal::Nanos;

/// Type of EtherCAT in an Ethernet header.
const ETHERNET_TYPE: u16 = 0x88a4;
/// Most calls of `recv` in one wait: each error of the network ends one of them.
const RECEIVE_CALLS_MAX: usize = 64;
/// A timer that nobody waits for shows how much time has passed since the opening.
const AGE_TIMER: Duration = Duration::from_secs(100 * 365 * 86_400);

/// A cable that carries Ethernet frames to a segment and back.
pub trait Port: Send {
    /// Hands a frame over; it may be lost.
    ///
    /// # Errors
    /// The system's, without allocating.
    fn send(&mut self, frame: &[u8]) -> io::Result<()>;

    /// Begins a wait: the calls of [`Port::receive`] that follow return within `wait` in all. With
    /// a wait of zero they take what has come already.
    fn start_wait(&mut self, wait: Nanos);

    /// The next frame, with its length; `None` when the wait is over. A frame that is longer than
    /// the buffer is cut.
    fn receive(&mut self, buffer: &mut [u8]) -> Option<usize>;

    /// The time since the port was made; asked only while a bus is set up.
    fn elapsed(&mut self) -> Nanos;
}

/// A raw socket on an interface, which sees EtherCAT only.
///
/// System calls: [`SYSTEM_CALLS`](crate::SYSTEM_CALLS).
#[derive(Debug)]
pub struct RawPort {
    socket: OwnedFd,
    timer: TimerFd,
    age: TimerFd,
    calls: usize,
    /// The wait is longer than zero.
    may_wait: bool,
}

impl RawPort {
    /// Opens a socket on an interface such as `eth1`.
    ///
    /// # Errors
    /// The system's: no such interface, no permission (`CAP_NET_RAW`), no file descriptor left.
    pub fn open(interface: &str) -> io::Result<RawPort> {
        let index = if_nametoindex(interface)?;
        let flags = SockFlag::SOCK_NONBLOCK | SockFlag::SOCK_CLOEXEC;
        let socket = socket(AddressFamily::Packet, SockType::Raw, flags, None)?;
        let address = libc::sockaddr_ll {
            sll_family: libc::AF_PACKET as u16,
            sll_protocol: ETHERNET_TYPE.to_be(),
            sll_ifindex: index.cast_signed(),
            sll_hatype: 0,
            sll_pkttype: 0,
            sll_halen: 0,
            sll_addr: [0; 8],
        };
        let size = size_of_val(&address) as libc::socklen_t;
        // SAFETY: the address is a whole `sockaddr_ll` of its own family and of the stated size,
        // and it is copied before the call returns.
        let link = unsafe { LinkAddr::from_raw((&raw const address).cast(), Some(size)) };
        bind(socket.as_raw_fd(), &link.ok_or(Errno::EINVAL)?)?;
        let flags = TimerFlags::TFD_NONBLOCK | TimerFlags::TFD_CLOEXEC;
        let timer = TimerFd::new(ClockId::CLOCK_MONOTONIC, flags)?;
        let age = TimerFd::new(ClockId::CLOCK_MONOTONIC, flags)?;
        age.set(once(AGE_TIMER), TimerSetTimeFlags::empty())?;
        Ok(RawPort { socket, timer, age, calls: 0, may_wait: false })
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

fn once(wait: Duration) -> Expiration {
    Expiration::OneShot(TimeSpec::from_duration(wait))
}

impl Port for RawPort {
    fn send(&mut self, frame: &[u8]) -> io::Result<()> {
        send(self.socket.as_raw_fd(), frame, MsgFlags::MSG_DONTWAIT)?;
        Ok(())
    }

    fn start_wait(&mut self, wait: Nanos) {
        self.may_wait = wait > Nanos::ZERO;
        if !self.may_wait {
            self.calls = RECEIVE_CALLS_MAX;
            return;
        }
        let wait = Duration::from_nanos(wait.0.cast_unsigned());
        let is_set = self.timer.set(once(wait), TimerSetTimeFlags::empty()).is_ok();
        // Without the timer nothing would end a wait.
        self.calls = if is_set { RECEIVE_CALLS_MAX } else { 0 };
    }

    fn receive(&mut self, buffer: &mut [u8]) -> Option<usize> {
        while self.calls > 0 {
            self.calls -= 1;
            match recv(self.socket.as_raw_fd(), buffer, MsgFlags::MSG_DONTWAIT) {
                Ok(bytes) => return Some(bytes),
                Err(Errno::EAGAIN) => {
                    if !self.may_wait || !self.wait() {
                        self.calls = 0;
                    }
                }
                // An interface that goes down says so once.
                Err(_) => {}
            }
        }
        None
    }

    fn elapsed(&mut self) -> Nanos {
        let left = match self.age.get() {
            Ok(Some(Expiration::OneShot(left))) => Duration::from(left),
            _ => Duration::ZERO,
        };
        Nanos(i64::try_from(AGE_TIMER.saturating_sub(left).as_nanos()).unwrap_or(i64::MAX))
    }
}
