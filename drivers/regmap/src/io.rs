//! The mapped register block, the only place where registers are accessed. A block that is too
//! short, and a path that is no file and no UIO device, are errors when the board is opened; the
//! type [`Register`] allows no other offsets.
//!
//! If a mapped plain file is truncated afterwards, an access raises SIGBUS; a plain file is for
//! models of a board, not for a robot.
#![allow(unsafe_code)]

use std::ffi::c_void;
use std::fs::{File, Metadata, OpenOptions, TryLockError};
use std::io;
use std::os::fd::AsRawFd;
use std::os::unix::fs::{FileTypeExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::ptr::{self, NonNull};
use std::sync::atomic::{Ordering, fence};

use taktil_hal::OpenError;

use crate::config::Config;
use crate::error;
use crate::registers::{BLOCK_BYTES, Register};

/// A block of big-endian 16-bit registers, shared by the halves of a board.
///
/// Each access is one aligned 16-bit load or store that the compiler neither drops nor merges. The
/// halves write disjoint registers, so they need no lock; what must be read together is published
/// under a number (see [`registers`](crate::registers)).
#[derive(Debug)]
pub struct RegisterFile {
    /// First register. Points into the mapping, at an even address, with at least `BLOCK_BYTES`
    /// mapped bytes from there on.
    block: NonNull<u16>,
    mapping: NonNull<c_void>,
    mapping_bytes: usize,
    /// Keeps the device open and any lock held; `None` for anonymous memory.
    file: Option<File>,
}

// SAFETY: the mapping belongs to the process, not to a thread, and is unmapped only on drop.
unsafe impl Send for RegisterFile {}
// SAFETY: `&RegisterFile` allows nothing but single aligned volatile 16-bit accesses to memory that
// the kernel mapped and that no Rust reference, allocation or other type ever covers. A board or
// another process changes that memory at any time anyway, so no caller can rely on its being still;
// a 16-bit access is indivisible on every machine this is built for.
unsafe impl Sync for RegisterFile {}

impl RegisterFile {
    /// Maps the block that `config` names and brings its pages in.
    ///
    /// # Errors
    /// The path is missing, forbidden, a directory, neither a plain file nor a UIO device, too
    /// short, or cannot be mapped. The message names the path and the remedy.
    pub fn open(config: &Config) -> Result<RegisterFile, OpenError> {
        config.check()?;
        let path = config.path.as_path();
        let metadata = std::fs::metadata(path).map_err(|error| refused(path, &error))?;
        let window = Window::find(config, &metadata)?;
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .custom_flags(libc::O_SYNC | libc::O_CLOEXEC)
            .open(path)
            .map_err(|error| refused(path, &error))?;
        let mapping_bytes = window.block_bytes + config.length_bytes;
        let mapping = map(Some((&file, window.file_offset)), mapping_bytes).map_err(|error| {
            let what = format!("cannot be mapped into memory ({error})");
            error::device(path, what, "check `map`, `offset_bytes` and `length_bytes`")
        })?;
        // SAFETY: `mapping_bytes` bytes are mapped and `block_bytes` is less than that.
        let block = unsafe { mapping.byte_add(window.block_bytes) }.cast();
        Ok(RegisterFile { block, mapping, mapping_bytes, file: Some(file) })
    }

    /// A zeroed block in memory, for a model of the board in the same process.
    ///
    /// # Errors
    /// The kernel's, when it has no memory to give.
    pub fn anonymous() -> io::Result<RegisterFile> {
        let mapping = map(None, BLOCK_BYTES)?;
        let block = mapping.cast();
        Ok(RegisterFile { block, mapping, mapping_bytes: BLOCK_BYTES, file: None })
    }

    /// Locks the board for this process's outputs until the block is dropped; other processes may
    /// still map it and read.
    pub(crate) fn lock_outputs(&self, path: &Path) -> Result<(), OpenError> {
        match self.file.as_ref().map(File::try_lock) {
            None | Some(Ok(())) => Ok(()),
            Some(Err(TryLockError::WouldBlock)) => Err(error::device(
                path,
                "another process drives this board",
                "stop it first: two writers would fight over the outputs",
            )),
            Some(Err(TryLockError::Error(error))) => Err(refused(path, &error)),
        }
    }

    /// The word in a register.
    #[must_use]
    pub fn read(&self, register: Register) -> u16 {
        // SAFETY: a `Register` is at most BLOCK_BYTES - 2 from the start of the block, which has at
        // least BLOCK_BYTES mapped, readable bytes; see `word` for alignment.
        u16::from_be(unsafe { self.word(register).read_volatile() })
    }

    /// Writes the word of a register.
    pub fn write(&self, register: Register, word: u16) {
        // SAFETY: as for `read`; the mapping is writable.
        unsafe { self.word(register).write_volatile(word.to_be()) }
    }

    /// Everything read before is done before anything read after. Between single accesses to device
    /// memory the machine keeps that order anyway; to a plain file's memory it may not.
    pub fn order_reads(&self) {
        fence(Ordering::Acquire);
    }

    /// Everything written before can be seen before anything written after.
    pub fn order_writes(&self) {
        fence(Ordering::Release);
    }

    /// Always even and inside the block: offsets come in the type `Register`, and the block starts
    /// at an even address.
    fn word(&self, register: Register) -> *mut u16 {
        self.block.as_ptr().wrapping_byte_add(register.offset_bytes())
    }
}

impl Drop for RegisterFile {
    fn drop(&mut self) {
        // SAFETY: exactly what `mmap` returned; no pointer into it outlives `self`, because none is
        // handed out.
        unsafe { libc::munmap(self.mapping.as_ptr(), self.mapping_bytes) };
    }
}

/// The position of the block in the file or device.
struct Window {
    /// What `mmap` takes as the offset: a whole number of pages.
    file_offset: libc::off_t,
    /// From there to the block.
    block_bytes: usize,
}

impl Window {
    fn find(config: &Config, metadata: &Metadata) -> Result<Window, OpenError> {
        let path = config.path.as_path();
        let kind = metadata.file_type();
        let (file_offset, start, size) = if kind.is_file() {
            (0, 0, usize::try_from(metadata.len()).unwrap_or(usize::MAX))
        } else if kind.is_char_device() {
            let uio = UioMap::of(metadata.rdev(), config.map).map_err(|error| {
                let what = format!("has no UIO memory map {} ({error})", config.map);
                error::device(path, what, "give the /dev/uioN of the board and its `map`")
            })?;
            (libc::off_t::from(config.map) * page_bytes(), uio.start, uio.size)
        } else {
            let what = if kind.is_dir() { "is a directory" } else { "is no file and no device" };
            return Err(error::device(path, what, "name a UIO device or a plain file"));
        };
        let needed = config.offset_bytes + config.length_bytes;
        if size < needed {
            let what = format!(
                "holds {size} bytes, {} from offset {} are needed",
                config.length_bytes, config.offset_bytes
            );
            let remedy = "check that this is the board's file and `offset_bytes` is right";
            return Err(error::device(path, what, remedy));
        }
        Ok(Window { file_offset, block_bytes: start + config.offset_bytes })
    }
}

/// What the kernel tells about one memory map of a UIO device.
struct UioMap {
    /// Bytes from the page boundary to the memory.
    start: usize,
    size: usize,
}

impl UioMap {
    fn of(device: u64, map: u8) -> io::Result<UioMap> {
        let (major, minor) = (libc::major(device), libc::minor(device));
        let maps = PathBuf::from(format!("/sys/dev/char/{major}:{minor}/maps/map{map}"));
        let start = UioMap::attribute(&maps.join("offset"))?;
        if !start.is_multiple_of(2) {
            return Err(io::Error::other("it starts at an odd address"));
        }
        Ok(UioMap { start, size: UioMap::attribute(&maps.join("size"))? })
    }

    fn attribute(path: &Path) -> io::Result<usize> {
        let text = std::fs::read_to_string(path)?;
        parse_hex(&text).ok_or_else(|| io::Error::other(format!("unreadable size {text:?}")))
    }
}

fn parse_hex(text: &str) -> Option<usize> {
    usize::from_str_radix(text.trim().strip_prefix("0x")?, 16).ok()
}

fn page_bytes() -> libc::off_t {
    // SAFETY: asks for a constant of the system; no memory is involved.
    unsafe { libc::sysconf(libc::_SC_PAGESIZE) }
}

fn map(file: Option<(&File, libc::off_t)>, bytes: usize) -> io::Result<NonNull<c_void>> {
    let (fd, offset) = file.map_or((-1, 0), |(file, offset)| (file.as_raw_fd(), offset));
    let anonymous = if file.is_none() { libc::MAP_ANONYMOUS } else { 0 };
    // MAP_POPULATE: no page is left to be faulted in by a cycle.
    let flags = libc::MAP_SHARED | libc::MAP_POPULATE | anonymous;
    // SAFETY: a new mapping at an address of the kernel's choice disturbs no existing memory; `fd`
    // is open for the whole call, or -1 together with MAP_ANONYMOUS.
    let mapping = unsafe {
        libc::mmap(ptr::null_mut(), bytes, libc::PROT_READ | libc::PROT_WRITE, flags, fd, offset)
    };
    if mapping == libc::MAP_FAILED {
        return Err(io::Error::last_os_error());
    }
    NonNull::new(mapping).ok_or_else(|| io::Error::other("mapped at address 0"))
}

/// The error of a path that the system refused, with what to do about it.
fn refused(path: &Path, error: &io::Error) -> OpenError {
    let (what, remedy) = match error.kind() {
        io::ErrorKind::NotFound => {
            ("does not exist".to_owned(), "load the board's UIO driver, or correct the path")
        }
        io::ErrorKind::PermissionDenied => (
            "may not be read and written by this user".to_owned(),
            "give the service's group access with a udev rule, or run as that group",
        ),
        io::ErrorKind::IsADirectory => {
            ("is a directory".to_owned(), "name a UIO device or a plain file")
        }
        _ => (format!("cannot be opened ({error})"), "check the path and the device"),
    };
    error::device(path, what, remedy)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registers::{DAC_STROBE, ID, TACTILE};

    #[test]
    fn a_word_is_written_and_read_back_and_its_neighbours_stay() {
        let block = RegisterFile::anonymous().unwrap();
        block.write(DAC_STROBE, 0x1234);
        block.write(TACTILE.end, 0xfedc);
        assert_eq!(block.read(DAC_STROBE), 0x1234);
        assert_eq!(block.read(TACTILE.end), 0xfedc);
        assert_eq!(block.read(ID), 0);
    }

    #[test]
    fn refusals_name_path_and_remedy() {
        let path = Path::new("/dev/uio7");
        let denied = io::Error::from(io::ErrorKind::PermissionDenied);
        let text = refused(path, &denied).to_string();
        assert!(text.starts_with("/dev/uio7: may not be read and written"), "{text}");
        assert!(text.contains("udev rule"), "{text}");
        let busy = io::Error::from_raw_os_error(libc::EBUSY);
        assert!(refused(path, &busy).to_string().contains("cannot be opened"));
    }

    #[test]
    fn sizes_of_the_kernel_are_hexadecimal() {
        assert_eq!(parse_hex("0x00001000\n"), Some(4096));
        assert_eq!(parse_hex("4096"), None);
        assert_eq!(parse_hex("0x"), None);
        assert_eq!(parse_hex(""), None);
    }
}
