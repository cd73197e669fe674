//! Opens a raw socket on a CAN interface of the kernel, before any job: frames of CAN FD and
//! reports of all errors are switched on, and the process's own frames do not come back to it.
#![allow(unsafe_code)]

use std::ffi::CString;
use std::io::{Error, ErrorKind, Result};
use std::mem::size_of;
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};

/// All classes of errors that a controller reports.
const ERROR_CLASSES_MASK: u32 = 0x1fff_ffff;
/// The kernel's request for the length of a queue, `SIOCGIFTXQLEN` of `linux/sockios.h`.
const QUEUE_LENGTH_REQUEST: libc::c_ulong = 0x8942;
/// A switch of a socket that is on.
const OPTION_ON: u32 = 1;

/// A socket that is bound to the interface `name`.
///
/// # Errors
/// The system's: no such interface, no support of CAN in the kernel, no permission.
pub(crate) fn open(name: &str) -> Result<OwnedFd> {
    let name = CString::new(name).map_err(|_| Error::from(ErrorKind::InvalidInput))?;
    // SAFETY: the name ends with a zero byte and lives until the call has returned.
    let index = unsafe { libc::if_nametoindex(name.as_ptr()) };
    let index = i32::try_from(index).unwrap_or(0);
    if index == 0 {
        return Err(Error::last_os_error());
    }
    let kind = libc::SOCK_RAW | libc::SOCK_CLOEXEC | libc::SOCK_NONBLOCK;
    // SAFETY: the call takes three numbers.
    let raw = unsafe { libc::socket(libc::PF_CAN, kind, libc::CAN_RAW) };
    if raw < 0 {
        return Err(Error::last_os_error());
    }
    // SAFETY: the kernel has just made the descriptor, and nothing else has it.
    let socket = unsafe { OwnedFd::from_raw_fd(raw) };
    // An interface without CAN FD takes the switch all the same.
    set(&socket, libc::CAN_RAW_FD_FRAMES, OPTION_ON)?;
    set(&socket, libc::CAN_RAW_ERR_FILTER, ERROR_CLASSES_MASK)?;
    // SAFETY: an address of zeros is one, of plain numbers.
    let mut address: libc::sockaddr_can = unsafe { std::mem::zeroed() };
    address.can_family = libc::AF_CAN as libc::sa_family_t;
    address.can_ifindex = index;
    let length = size_of::<libc::sockaddr_can>() as libc::socklen_t;
    // SAFETY: the address lives until the call has returned, and `length` is its length.
    let outcome = unsafe { libc::bind(socket.as_raw_fd(), (&raw const address).cast(), length) };
    if outcome < 0 { Err(Error::last_os_error()) } else { Ok(socket) }
}

/// Frames that the queue of the interface `name` holds; 0 stands for an interface without one.
///
/// # Errors
/// The system's: no such interface.
pub(crate) fn queue_frames(socket: &OwnedFd, name: &str) -> Result<u32> {
    // SAFETY: a request of zeros is one, of plain numbers.
    let mut request: libc::ifreq = unsafe { std::mem::zeroed() };
    let last = request.ifr_name.len() - 1;
    for (to, from) in request.ifr_name.iter_mut().take(last).zip(name.bytes()) {
        *to = from as libc::c_char;
    }
    // SAFETY: the request lives until the call has returned; the kernel writes into it alone.
    let outcome =
        unsafe { libc::ioctl(socket.as_raw_fd(), QUEUE_LENGTH_REQUEST, &raw mut request) };
    if outcome < 0 {
        return Err(Error::last_os_error());
    }
    // SAFETY: the call has succeeded, and this is the field that it fills.
    let length = unsafe { request.ifr_ifru.ifru_metric };
    Ok(u32::try_from(length).unwrap_or(0))
}

fn set(socket: &OwnedFd, option: i32, value: u32) -> Result<()> {
    let length = size_of::<u32>() as libc::socklen_t;
    let place = (&raw const value).cast();
    // SAFETY: the value lives until the call has returned, and `length` is its length.
    let outcome =
        unsafe { libc::setsockopt(socket.as_raw_fd(), libc::SOL_CAN_RAW, option, place, length) };
    if outcome < 0 { Err(Error::last_os_error()) } else { Ok(()) }
}
