//! The mapped register block, the only place where registers are accessed. A block that is too
//! short, a path that is no file and no UIO device, and another device than the one asked for are
//! errors when the board is opened. An access outside the block or between two registers does
//! nothing and reads all ones, as on a bus without a board.
//!
//! If a mapped plain file is truncated afterwards, an access raises SIGBUS; a plain file is for
//! models of a board, not for a robot. The files of a PCI device's memory cannot be truncated.
#![allow(unsafe_code)]

use std::ffi::c_void;
use std::fs::{File, Metadata, OpenOptions};
use std::io;
use std::os::fd::AsRawFd;
use std::os::unix::fs::{FileTypeExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::ptr::{self, NonNull};
use std::sync::atomic::{Ordering, fence};

use taktil_hal::OpenError;

use crate::boards;
use crate::config::Config;
use crate::error;
use crate::registers::{BLOCK_BYTES, Register};

/// A block of registers, shared by the halves of a board.
///
/// Each access is one aligned load or store of 8, 16 or 32 bits that the compiler neither drops nor
/// merges. The halves write disjoint registers, so they need no lock; what must be read together is
/// published under a number, latched or read again.
#[derive(Debug)]
pub struct RegisterFile {
    /// First byte of the block. Points into the mapping, with at least `block_bytes` mapped bytes
    /// from there on.
    block: NonNull<u8>,
    block_bytes: usize,
    mapping: NonNull<c_void>,
    mapping_bytes: usize,
    /// Where the block starts in the file or device, as far as locks are concerned.
    lock_start: libc::off_t,
    /// Keeps the device open and any lock held; `None` for anonymous memory.
    file: Option<File>,
}

// SAFETY: the mapping belongs to the process, not to a thread, and is unmapped only on drop.
unsafe impl Send for RegisterFile {}
// SAFETY: `&RegisterFile` allows nothing but single aligned volatile accesses of 8, 16 or 32 bits
// to memory that the kernel mapped and that no Rust reference, allocation or other type ever
// covers. A board or another process changes that memory at any time anyway, so no caller can rely
// on its being still; such an access is indivisible on every machine this is built for.
unsafe impl Sync for RegisterFile {}

impl RegisterFile {
    /// Maps the block that `config` names and brings its pages in.
    ///
    /// # Errors
    /// The path is missing, forbidden, a directory, neither a plain file nor a UIO device, another
    /// device, too short, or cannot be mapped. The message names the path and the remedy.
    pub fn open(config: &Config) -> Result<RegisterFile, OpenError> {
        config.check()?;
        let description = boards::description(config)?;
        let length = boards::window_bytes(config, &description);
        RegisterFile::map(config, length, description.bus_bytes())
    }

    /// Maps `length_bytes` bytes whose registers have `bus_bytes` bytes.
    pub(crate) fn map(
        config: &Config,
        length_bytes: usize,
        bus_bytes: usize,
    ) -> Result<RegisterFile, OpenError> {
        let path = config.path.as_path();
        let metadata = std::fs::metadata(path).map_err(|error| refused(path, &error))?;
        let wanted = Wanted { offset_bytes: config.offset_bytes, length_bytes, bus_bytes };
        let window = Window::find(config, &metadata, &wanted)?;
        identify(config, &metadata)?;
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .custom_flags(libc::O_SYNC | libc::O_CLOEXEC)
            .open(path)
            .map_err(|error| refused(path, &error))?;
        let mapping_bytes = window.block_bytes + length_bytes;
        let mapping = map(Some((&file, window.file_offset)), mapping_bytes).map_err(|error| {
            let what = format!("cannot be mapped into memory ({error})");
            let remedy = "name memory, not ports: for a PCI device another resourceN, or enable it";
            error::device(path, what, remedy)
        })?;
        // SAFETY: `mapping_bytes` bytes are mapped and `block_bytes` is less than that.
        let block = unsafe { mapping.byte_add(window.block_bytes) }.cast();
        Ok(RegisterFile {
            block,
            block_bytes: length_bytes,
            mapping,
            mapping_bytes,
            lock_start: window.file_offset + window.block_bytes as libc::off_t,
            file: Some(file),
        })
    }

    /// A zeroed block in memory, for a model of the board in the same process: that of the
    /// project's own layout.
    ///
    /// # Errors
    /// The kernel's, when it has no memory to give.
    pub fn anonymous() -> io::Result<RegisterFile> {
        let mapping = map(None, BLOCK_BYTES)?;
        let (block, block_bytes, mapping_bytes) = (mapping.cast(), BLOCK_BYTES, BLOCK_BYTES);
        Ok(RegisterFile { block, block_bytes, mapping, mapping_bytes, lock_start: 0, file: None })
    }

    /// Locks the block for whoever has mapped it, until it is dropped; others may still map it and
    /// read. Another block of the same file is another board, behind one bridge for example.
    pub(crate) fn lock_outputs(&self, path: &Path) -> Result<(), OpenError> {
        let Some(file) = &self.file else { return Ok(()) };
        // SAFETY: all fields of the C structure are integers, for which zero is a value.
        let mut lock: libc::flock = unsafe { std::mem::zeroed() };
        lock.l_type = libc::F_WRLCK as libc::c_short;
        lock.l_whence = libc::SEEK_SET as libc::c_short;
        (lock.l_start, lock.l_len) = (self.lock_start, self.block_bytes as libc::off_t);
        // SAFETY: the call reads `lock`, which lives longer, and the descriptor is open.
        let answer = unsafe { libc::fcntl(file.as_raw_fd(), libc::F_OFD_SETLK, &raw const lock) };
        if answer == 0 {
            return Ok(());
        }
        let error = io::Error::last_os_error();
        match error.raw_os_error() {
            Some(libc::EAGAIN | libc::EACCES) => Err(error::device(
                path,
                "another process drives this board, or another device of this one",
                "stop it, or correct `offset_bytes`: two writers would fight over the outputs",
            )),
            _ => Err(refused(path, &error)),
        }
    }

    /// The big-endian word of 16 bits in a register.
    #[must_use]
    pub fn read(&self, register: Register) -> u16 {
        u16::from_be(self.load16(register.offset_bytes()))
    }

    /// Writes the big-endian word of 16 bits of a register.
    pub fn write(&self, register: Register, word: u16) {
        self.store16(register.offset_bytes(), word.to_be());
    }

    /// The byte at an offset.
    pub(crate) fn load8(&self, offset: usize) -> u8 {
        // SAFETY: `register` gives only places inside the mapping, aligned for their type.
        self.register::<u8>(offset).map_or(u8::MAX, |at| unsafe { at.read_volatile() })
    }

    /// The 16 bits at an offset, in the machine's order of bytes.
    pub(crate) fn load16(&self, offset: usize) -> u16 {
        // SAFETY: as for `load8`.
        self.register::<u16>(offset).map_or(u16::MAX, |at| unsafe { at.read_volatile() })
    }

    /// The 32 bits at an offset, in the machine's order of bytes.
    pub(crate) fn load32(&self, offset: usize) -> u32 {
        // SAFETY: as for `load8`.
        self.register::<u32>(offset).map_or(u32::MAX, |at| unsafe { at.read_volatile() })
    }

    /// Writes the byte at an offset.
    pub(crate) fn store8(&self, offset: usize, word: u8) {
        if let Some(at) = self.register::<u8>(offset) {
            // SAFETY: as for `load8`; the mapping is writable.
            unsafe { at.write_volatile(word) }
        }
    }

    /// Writes the 16 bits at an offset, in the machine's order of bytes.
    pub(crate) fn store16(&self, offset: usize, word: u16) {
        if let Some(at) = self.register::<u16>(offset) {
            // SAFETY: as for `load8`; the mapping is writable.
            unsafe { at.write_volatile(word) }
        }
    }

    /// Writes the 32 bits at an offset, in the machine's order of bytes.
    pub(crate) fn store32(&self, offset: usize, word: u32) {
        if let Some(at) = self.register::<u32>(offset) {
            // SAFETY: as for `load8`; the mapping is writable.
            unsafe { at.write_volatile(word) }
        }
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

    /// The place of a register, if it lies inside the block and is aligned.
    fn register<T>(&self, offset: usize) -> Option<*mut T> {
        let bytes = size_of::<T>();
        if offset > self.block_bytes.checked_sub(bytes)? {
            return None;
        }
        let place = self.block.as_ptr().wrapping_add(offset).cast::<T>();
        place.is_aligned().then_some(place)
    }
}

impl Drop for RegisterFile {
    fn drop(&mut self) {
        // SAFETY: exactly what `mmap` returned; no pointer into it outlives `self`, because none is
        // handed out.
        unsafe { libc::munmap(self.mapping.as_ptr(), self.mapping_bytes) };
    }
}

/// What is to be mapped.
struct Wanted {
    offset_bytes: usize,
    length_bytes: usize,
    bus_bytes: usize,
}

/// The position of the block in the file or device.
struct Window {
    /// What `mmap` takes as the offset: a whole number of pages.
    file_offset: libc::off_t,
    /// From there to the block.
    block_bytes: usize,
}

impl Window {
    fn find(config: &Config, metadata: &Metadata, wanted: &Wanted) -> Result<Window, OpenError> {
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
            let remedy = "name a UIO device, the resource file of a PCI device or a plain file";
            return Err(error::device(path, what, remedy));
        };
        let start = start.saturating_add(wanted.offset_bytes);
        if !start.is_multiple_of(wanted.bus_bytes) {
            let what =
                format!("has no register at {start:#x}: they have {} bytes", wanted.bus_bytes);
            let remedy = "give a multiple of a register's bytes as `offset_bytes`";
            return Err(error::device(path, what, remedy));
        }
        let needed = wanted.offset_bytes.saturating_add(wanted.length_bytes);
        if size < needed {
            let what = format!(
                "holds {size} bytes, {} from offset {} are needed",
                wanted.length_bytes, wanted.offset_bytes
            );
            let remedy = "check that this is the board's file and `offset_bytes` is right";
            return Err(error::device(path, what, remedy));
        }
        Ok(Window { file_offset, block_bytes: start })
    }
}

/// Checks that the device is the one that is asked for, by what the kernel says of it.
fn identify(config: &Config, metadata: &Metadata) -> Result<(), OpenError> {
    let path = config.path.as_path();
    let attribute = |file: &Path| {
        std::fs::read_to_string(file).map(|text| text.trim().to_owned()).map_err(|error| {
            let what = format!("cannot be identified: {}: {error}", file.display());
            let remedy = "name the device itself, or leave `pci_id` and `uio_name` out";
            error::device(path, what, remedy)
        })
    };
    let found = if let Some(wanted) = &config.pci_id {
        let [vendor, device] =
            ["vendor", "device"].map(|name| attribute(&path.with_file_name(name)));
        let [vendor, device] = [vendor?, device?];
        let bare = |id: &str| id.trim_start_matches("0x").to_ascii_lowercase();
        let found = format!("{}:{}", bare(&vendor), bare(&device));
        (found, wanted.to_ascii_lowercase(), "PCI device")
    } else if let Some(wanted) = &config.uio_name {
        let (major, minor) = (libc::major(metadata.rdev()), libc::minor(metadata.rdev()));
        let found = attribute(Path::new(&format!("/sys/dev/char/{major}:{minor}/name")))?;
        (found, wanted.clone(), "UIO device")
    } else {
        return Ok(());
    };
    let (found, wanted, kind) = found;
    if found == wanted {
        return Ok(());
    }
    let what = format!("is the {kind} {found}, not {wanted}");
    Err(error::device(path, what, "name the path of the board: it may move with the slots"))
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
            ("does not exist".to_owned(), "load the board's driver, or correct the path")
        }
        io::ErrorKind::PermissionDenied => (
            "may not be read and written by this user".to_owned(),
            "give the service's group access, for a UIO device by a udev rule",
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
    fn beyond_the_block_and_between_registers_is_nothing() {
        let block = RegisterFile::anonymous().unwrap();
        for offset in [BLOCK_BYTES, BLOCK_BYTES + 1, usize::MAX - 3, usize::MAX] {
            block.store8(offset, 0x12);
            assert_eq!(block.load8(offset), u8::MAX, "{offset}");
        }
        for offset in [1, BLOCK_BYTES - 1, BLOCK_BYTES, usize::MAX - 1] {
            block.store16(offset, 0x1234);
            assert_eq!(block.load16(offset), u16::MAX, "{offset}");
        }
        for offset in [1, 2, BLOCK_BYTES - 2, BLOCK_BYTES, usize::MAX - 3] {
            block.store32(offset, 0x1234_5678);
            assert_eq!(block.load32(offset), u32::MAX, "{offset}");
        }
        assert!((0..BLOCK_BYTES).all(|offset| block.load8(offset) == 0), "nothing was written");
        block.store32(4, 0x1234_5678);
        assert_eq!(block.load32(4), 0x1234_5678);
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
