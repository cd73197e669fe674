//! The port: opened and set by `serialport`, exclusive, with the shortest latency that the tty
//! offers; read and written without waiting.
#![allow(unsafe_code)]

use std::fs::File;
use std::io::{self, Read, Write};
use std::os::fd::{AsFd, AsRawFd, FromRawFd, IntoRawFd, OwnedFd};
use std::os::unix::fs::MetadataExt;

use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use serialport::{ClearBuffer, SerialPort, TTYPort};

use crate::config::Config;

/// Longest wait for bytes in one cycle (ms).
pub const POLL_MAX_MS: u8 = 10;
/// The kernel passes bytes on at once (include/uapi/linux/tty_flags.h).
const ASYNC_LOW_LATENCY: libc::c_int = 1 << 13;

/// Major numbers of the near ends of pseudo-terminals.
const PSEUDO_TERMINAL_MAJORS: std::ops::RangeInclusive<libc::c_uint> = 136..=143;

/// What the kernel tells of a serial port (include/uapi/linux/serial.h, `serial_struct`).
#[repr(C)]
struct SerialSettings {
    kind: libc::c_int,
    line: libc::c_int,
    port: libc::c_uint,
    irq: libc::c_int,
    flags: libc::c_int,
    xmit_fifo_size: libc::c_int,
    custom_divisor: libc::c_int,
    baud_base: libc::c_int,
    close_delay: libc::c_ushort,
    io_type: libc::c_char,
    reserved_char: [libc::c_char; 1],
    hub6: libc::c_int,
    closing_wait: libc::c_ushort,
    closing_wait2: libc::c_ushort,
    iomem_base: *mut libc::c_uchar,
    iomem_reg_shift: libc::c_ushort,
    port_high: libc::c_uint,
    iomap_base: libc::c_ulong,
}

/// An open port.
#[derive(Debug)]
pub struct SerialFile {
    file: File,
    low_latency: bool,
}

impl SerialFile {
    /// Opens the port, 8 bits, no parity, one stop bit, locked against other processes. Bytes that
    /// waited in it are thrown away.
    ///
    /// # Errors
    /// The system refuses it.
    pub fn open(config: &Config) -> Result<SerialFile, serialport::Error> {
        let port: TTYPort = serialport::new(&config.path, config.line_baud()).open_native()?;
        port.clear(ClearBuffer::All)?;
        // SAFETY: `into_raw_fd` gives up the port's ownership of a descriptor that is open.
        let owned = unsafe { OwnedFd::from_raw_fd(port.into_raw_fd()) };
        fcntl(&owned, FcntlArg::F_SETFL(OFlag::O_NONBLOCK)).map_err(io::Error::from)?;
        let file = File::from(owned);
        // The kernel forgets the mark of a line when its last holder is gone, but that of a
        // pseudo-terminal only when its other end is gone too: a killed process would leave it shut
        // to everybody but root. The advisory lock ends with the process, and is enough there.
        if is_pseudo_terminal(&file)? {
            clear_exclusive_mark(&file);
        }
        let low_latency = set_low_latency(&file);
        Ok(SerialFile { file, low_latency })
    }

    /// Whether the tty has taken the low-latency setting; pseudo-terminals and most USB ports have
    /// none.
    #[must_use]
    pub fn is_low_latency(&self) -> bool {
        self.low_latency
    }

    /// Waits for bytes, at most [`POLL_MAX_MS`], and reads what is there.
    ///
    /// # Errors
    /// The port is gone.
    pub fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let mut watched = [PollFd::new(self.file.as_fd(), PollFlags::POLLIN)];
        match poll(&mut watched, PollTimeout::from(POLL_MAX_MS)) {
            Ok(0) | Err(nix::errno::Errno::EINTR) => return Ok(0),
            Ok(_) => {}
            Err(error) => return Err(io::Error::from(error)),
        }
        match self.file.read(bytes) {
            Ok(0) => Err(io::Error::from(io::ErrorKind::BrokenPipe)),
            Err(error) if is_transient(&error) => Ok(0),
            result => result,
        }
    }

    /// Sends a request as far as the port takes it at once; a part that is lost is answered by the
    /// repetition of the dialogue.
    ///
    /// # Errors
    /// The port is gone.
    pub fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self.file.write(bytes) {
            Err(error) if is_transient(&error) => Ok(0),
            result => result,
        }
    }
}

impl Drop for SerialFile {
    fn drop(&mut self) {
        clear_exclusive_mark(&self.file);
    }
}

/// Whether the device is the near end of a pseudo-terminal (Documentation/admin-guide/devices.txt).
fn is_pseudo_terminal(file: &File) -> io::Result<bool> {
    Ok(PSEUDO_TERMINAL_MAJORS.contains(&libc::major(file.metadata()?.rdev())))
}

fn clear_exclusive_mark(file: &File) {
    // SAFETY: the descriptor is open; the request takes no argument.
    unsafe { libc::ioctl(file.as_raw_fd(), libc::TIOCNXCL) };
}

fn is_transient(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted)
}

fn set_low_latency(file: &File) -> bool {
    // SAFETY: all fields are integers or a raw pointer, for which zeros are values.
    let mut settings: SerialSettings = unsafe { std::mem::zeroed() };
    // SAFETY: the descriptor is open, and `settings` has the layout that the request writes.
    if unsafe { libc::ioctl(file.as_raw_fd(), libc::TIOCGSERIAL, &raw mut settings) } != 0 {
        return false;
    }
    settings.flags |= ASYNC_LOW_LATENCY;
    // SAFETY: the descriptor is open, and `settings` has the layout that the request reads.
    unsafe { libc::ioctl(file.as_raw_fd(), libc::TIOCSSERIAL, &raw const settings) == 0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_killed_process_leaves_a_pseudo_terminal_locked_to_nobody() {
        let (mut far, mut near) = (-1, -1);
        let mut name = [0_u8; 64];
        let null = std::ptr::null_mut();
        // SAFETY: the numbers and the buffer are there to be written, and the buffer is longer than
        // any name of a pseudo-terminal.
        let made = unsafe {
            libc::openpty(&raw mut far, &raw mut near, name.as_mut_ptr().cast(), null, null.cast())
        };
        assert_eq!(made, 0);
        // SAFETY: both descriptors were just made and belong to nobody else.
        let (_far, near) = unsafe { (File::from_raw_fd(far), File::from_raw_fd(near)) };
        let path = std::ffi::CStr::from_bytes_until_nul(&name).unwrap().to_str().unwrap();
        let config = Config { path: path.into(), ..Config::default() };
        let port = SerialFile::open(&config).unwrap();
        let mut marked = -1;
        // SAFETY: the descriptor is open, and the request writes one integer.
        unsafe { libc::ioctl(near.as_raw_fd(), libc::TIOCGEXCL, &raw mut marked) };
        assert_eq!(marked, 0, "the mark would outlive the process");
        assert!(SerialFile::open(&config).is_err(), "two processes read one line");
        drop(port);
        assert!(SerialFile::open(&config).is_ok());
    }
}
