//! Joins an emulator with a CAN interface of the kernel, such as a `vcan`: a raw socket that passes
//! the bytes of frames, of which the emulator has a reader and a writer of its own.
#![allow(unsafe_code)]

use std::ffi::CString;
use std::io;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, FromRawFd, OwnedFd};

/// A switch of a socket that is on.
const OPTION_ON: u32 = 1;

/// A raw socket on an interface; it does not block.
#[derive(Debug)]
pub struct InterfaceSocket {
    socket: OwnedFd,
}

impl InterfaceSocket {
    /// Opens it; frames of CAN FD pass as well.
    ///
    /// # Errors
    /// The system's: no such interface, no support of CAN in the kernel, no permission.
    pub fn open(interface: &str) -> io::Result<InterfaceSocket> {
        let name = CString::new(interface)?;
        // SAFETY: the name ends with a zero byte and lives until the call has returned.
        let index = unsafe { libc::if_nametoindex(name.as_ptr()) };
        let index = i32::try_from(index).unwrap_or(0);
        if index == 0 {
            return Err(io::Error::last_os_error());
        }
        let kind = libc::SOCK_RAW | libc::SOCK_CLOEXEC | libc::SOCK_NONBLOCK;
        // SAFETY: the call takes three numbers.
        let raw = unsafe { libc::socket(libc::PF_CAN, kind, libc::CAN_RAW) };
        if raw < 0 {
            return Err(io::Error::last_os_error());
        }
        // SAFETY: the kernel has just made the descriptor, and nothing else has it.
        let socket = unsafe { OwnedFd::from_raw_fd(raw) };
        let (value, length) = (OPTION_ON, size_of::<u32>() as libc::socklen_t);
        let (level, option) = (libc::SOL_CAN_RAW, libc::CAN_RAW_FD_FRAMES);
        let place = (&raw const value).cast();
        // SAFETY: the value lives until the call has returned, and `length` is its length.
        let outcome = unsafe { libc::setsockopt(raw, level, option, place, length) };
        if outcome < 0 {
            return Err(io::Error::last_os_error());
        }
        // SAFETY: an address of zeros is one, of plain numbers.
        let mut address: libc::sockaddr_can = unsafe { std::mem::zeroed() };
        address.can_family = libc::AF_CAN as libc::sa_family_t;
        address.can_ifindex = index;
        let length = size_of::<libc::sockaddr_can>() as libc::socklen_t;
        // SAFETY: the address lives until the call has returned, and `length` is its length.
        let outcome = unsafe { libc::bind(raw, (&raw const address).cast(), length) };
        if outcome < 0 {
            return Err(io::Error::last_os_error());
        }
        Ok(InterfaceSocket { socket })
    }

    /// The bytes of the next frame that has come; `None` when none has.
    #[must_use]
    pub fn receive(&self, bytes: &mut [u8]) -> Option<usize> {
        let (raw, place) = (self.socket.as_raw_fd(), bytes.as_mut_ptr().cast());
        // SAFETY: the kernel writes at most as many bytes as there are.
        let count = unsafe { libc::recv(raw, place, bytes.len(), libc::MSG_DONTWAIT) };
        usize::try_from(count).ok()
    }

    /// Puts the bytes of a frame on the bus; a queue that is full loses it, as on every bus.
    pub fn send(&self, bytes: &[u8]) {
        let (raw, place) = (self.socket.as_raw_fd(), bytes.as_ptr().cast());
        // SAFETY: the kernel reads at most as many bytes as there are.
        let _ = unsafe { libc::send(raw, place, bytes.len(), libc::MSG_DONTWAIT) };
    }
}

impl AsFd for InterfaceSocket {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.socket.as_fd()
    }
}
