//! A pseudo-terminal with a stable name, and the loop that serves a [`Line`] on it in real time.

use std::fs::File;
use std::io::{self, ErrorKind, Read, Write};
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd};
use std::path::{Path, PathBuf};

use nix::fcntl::{FcntlArg, OFlag, fcntl};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::pty::openpty;
use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};
use taktil_hal::{Clock, Nanos};

use crate::Line;

/// Longest wait of the serving loop (ms): how soon it sees a command or its end.
const WAIT_MAX_MS: i64 = 5;

/// A pseudo-terminal, perhaps behind a symbolic link; both vanish on drop, as a device does that is
/// pulled.
#[derive(Debug)]
pub struct Terminal {
    board: File,
    /// Keeps the terminal alive while no host has it open.
    _host: OwnedFd,
    path: PathBuf,
    link: Option<PathBuf>,
}

impl Terminal {
    /// Opens a pseudo-terminal.
    ///
    /// # Errors
    /// The system has no pseudo-terminal left.
    pub fn open() -> io::Result<Terminal> {
        let pair = openpty(None, None)?;
        let mut settings = tcgetattr(&pair.slave)?;
        cfmakeraw(&mut settings);
        tcsetattr(&pair.slave, SetArg::TCSANOW, &settings)?;
        fcntl(&pair.master, FcntlArg::F_SETFL(OFlag::O_NONBLOCK))?;
        let path = std::fs::read_link(format!("/proc/self/fd/{}", pair.slave.as_raw_fd()))?;
        Ok(Terminal { board: File::from(pair.master), _host: pair.slave, path, link: None })
    }

    /// Opens a pseudo-terminal and lets `link` lead to it, in place of a link that stood there.
    ///
    /// # Errors
    /// The system has no pseudo-terminal left, or the link cannot be made.
    pub fn new(link: &Path) -> io::Result<Terminal> {
        let mut terminal = Terminal::open()?;
        if std::fs::symlink_metadata(link).is_ok_and(|found| found.is_symlink()) {
            std::fs::remove_file(link)?;
        }
        std::os::unix::fs::symlink(&terminal.path, link)?;
        terminal.link = Some(link.to_owned());
        Ok(terminal)
    }

    /// The name under which a host opens it: that of the link where there is one.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.link.as_ref().unwrap_or(&self.path)
    }

    /// What the host has sent; 0 when there is nothing. Never waits.
    ///
    /// # Errors
    /// The terminal is broken.
    pub fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        match self.board.read(bytes) {
            Err(error) if error.kind() == ErrorKind::WouldBlock => Ok(0),
            // No host has it open.
            Err(error) if error.raw_os_error() == Some(nix::errno::Errno::EIO as i32) => Ok(0),
            result => result,
        }
    }

    /// Sends to the host what the terminal takes; the rest is lost, as on a line without handshake.
    ///
    /// # Errors
    /// The terminal is broken.
    pub fn write(&mut self, mut bytes: &[u8]) -> io::Result<()> {
        while !bytes.is_empty() {
            match self.board.write(bytes) {
                Ok(count) => bytes = &bytes[count..],
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(()),
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        if let Some(link) = &self.link {
            let _ = std::fs::remove_file(link);
        }
    }
}

impl AsFd for Terminal {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.board.as_fd()
    }
}

/// Serves a line behind `link` in the time of `clock` until `is_over` says so. While the plan has
/// the cable pulled, neither terminal nor link exist.
///
/// # Errors
/// The terminal cannot be opened or is broken.
pub fn serve(
    line: &mut Line,
    link: &Path,
    clock: &dyn Clock,
    image: &mut dyn FnMut(Nanos, &mut [u16]),
    is_over: &mut dyn FnMut(Nanos) -> bool,
) -> io::Result<()> {
    let mut terminal = None;
    let (mut heard, mut said) = ([0; 256], Vec::new());
    loop {
        let now = clock.now();
        if is_over(now) {
            return Ok(());
        }
        let wait =
            Nanos::from_millis(WAIT_MAX_MS).min(Nanos(line.next_due().0.saturating_sub(now.0)));
        said.clear();
        line.poll(now, image, &mut said);
        if !line.is_plugged(now) {
            terminal = None;
            clock.sleep_until(now + Nanos::from_millis(WAIT_MAX_MS));
            continue;
        }
        if terminal.is_none() {
            terminal = Some(Terminal::new(link)?);
        }
        let Some(open) = &mut terminal else { continue };
        open.write(&said)?;
        let count = open.read(&mut heard)?;
        line.receive(now, &heard[..count]);
        if count == 0 && said.is_empty() && wait > Nanos::ZERO {
            let whole_ms = u16::try_from(wait.0 / 1_000_000).unwrap_or(0);
            if whole_ms == 0 {
                clock.sleep_until(now + wait);
            } else {
                let mut watched = [PollFd::new(open.board.as_fd(), PollFlags::POLLIN)];
                poll(&mut watched, PollTimeout::from(whole_ms))?;
            }
        }
    }
}
