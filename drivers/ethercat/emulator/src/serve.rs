//! Joins a segment with an interface of this machine: a raw socket that takes and gives frames.
#![allow(unsafe_code)]

use std::ffi::CString;
use std::io;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, FromRawFd, OwnedFd};

use taktil_hal::{Clock, Nanos};

use crate::datagram::ETHERNET_TYPE_BYTES;
use crate::segment::Segment;

/// Longest time between two looks at what is due and whether to go on.
const WAIT_TIME: Nanos = Nanos::from_millis(5);
/// Room for a frame.
const FRAME_BYTES_MAX: usize = 2_048;

/// A raw socket on one interface that sees EtherCAT only.
#[derive(Debug)]
pub struct RawSocket {
    socket: OwnedFd,
}

impl RawSocket {
    /// Opens it.
    ///
    /// # Errors
    /// The system's: no such interface, no permission (`CAP_NET_RAW`).
    pub fn open(interface: &str) -> io::Result<RawSocket> {
        let name = CString::new(interface)?;
        // SAFETY: `name` is a string with an end; the call keeps nothing of it.
        let index = unsafe { libc::if_nametoindex(name.as_ptr()) };
        let index = i32::try_from(index).unwrap_or(0);
        if index == 0 {
            return Err(io::Error::last_os_error());
        }
        let kind = libc::SOCK_RAW | libc::SOCK_NONBLOCK | libc::SOCK_CLOEXEC;
        let protocol = u16::from_ne_bytes(ETHERNET_TYPE_BYTES);
        // SAFETY: plain numbers go in, and a descriptor or -1 comes out.
        let raw = unsafe { libc::socket(libc::AF_PACKET, kind, i32::from(protocol)) };
        if raw < 0 {
            return Err(io::Error::last_os_error());
        }
        // SAFETY: the descriptor was made just now and belongs to nobody else.
        let socket = unsafe { OwnedFd::from_raw_fd(raw) };
        let address = libc::sockaddr_ll {
            sll_family: libc::AF_PACKET as u16,
            sll_protocol: protocol,
            sll_ifindex: index,
            sll_hatype: 0,
            sll_pkttype: 0,
            sll_halen: 0,
            sll_addr: [0; 8],
        };
        let size = size_of_val(&address) as libc::socklen_t;
        // SAFETY: the address is a `sockaddr_ll` of the stated size, which lives through the call.
        let bound = unsafe { libc::bind(raw, (&raw const address).cast(), size) };
        if bound < 0 { Err(io::Error::last_os_error()) } else { Ok(RawSocket { socket }) }
    }

    /// The next frame, if there is one.
    ///
    /// # Errors
    /// The system's, such as an interface that was taken away.
    pub fn receive(&self, buffer: &mut [u8]) -> io::Result<Option<usize>> {
        let raw = self.socket.as_raw_fd();
        // SAFETY: the buffer is as long as stated, and the kernel writes no further.
        let count = unsafe { libc::recv(raw, buffer.as_mut_ptr().cast(), buffer.len(), 0) };
        match usize::try_from(count) {
            Ok(count) => Ok(Some(count)),
            Err(_) => match io::Error::last_os_error() {
                error if error.kind() == io::ErrorKind::WouldBlock => Ok(None),
                // The interface went down for a while.
                error if error.raw_os_error() == Some(libc::ENETDOWN) => Ok(None),
                error if error.kind() == io::ErrorKind::Interrupted => Ok(None),
                error => Err(error),
            },
        }
    }

    /// Sends a frame. One that the interface does not take is lost, as on a cable.
    pub fn send(&self, frame: &[u8]) {
        let raw = self.socket.as_raw_fd();
        // SAFETY: the kernel reads as many bytes as the slice has.
        let _ = unsafe { libc::send(raw, frame.as_ptr().cast(), frame.len(), 0) };
    }

    fn wait(&self, wait: Nanos) {
        let mut look =
            libc::pollfd { fd: self.socket.as_raw_fd(), events: libc::POLLIN, revents: 0 };
        let time = libc::timespec { tv_sec: 0, tv_nsec: wait.0.clamp(0, 999_999_999) };
        // SAFETY: one entry is stated and one is there; the time lives through the call.
        let _ = unsafe { libc::ppoll(&raw mut look, 1, &raw const time, std::ptr::null()) };
    }
}

impl AsFd for RawSocket {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}

/// Answers on `socket` as long as `goes_on` says so of the segment.
///
/// # Errors
/// The socket's, such as an interface that was taken away.
pub fn serve(
    segment: &mut Segment,
    socket: &RawSocket,
    clock: &dyn Clock,
    goes_on: &mut dyn FnMut(&mut Segment, Nanos) -> bool,
) -> io::Result<()> {
    let mut buffer = [0; FRAME_BYTES_MAX];
    let mut answers = Vec::new();
    while goes_on(segment, clock.now()) {
        while let Some(count) = socket.receive(&mut buffer)? {
            segment.receive(clock.now(), &buffer[..count]);
            segment.poll(clock.now(), &mut answers);
            for answer in answers.drain(..) {
                socket.send(&answer);
            }
        }
        let now = clock.now();
        segment.advance(now);
        segment.poll(now, &mut answers);
        for answer in answers.drain(..) {
            socket.send(&answer);
        }
        let due = segment.next_due().map_or(WAIT_TIME, |due| due - now);
        socket.wait(due.min(WAIT_TIME));
    }
    Ok(())
}
