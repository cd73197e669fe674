//! A file in memory, mapped into the process: other processes see what is written there at once,
//! also after the process was killed. A file system that writes back to a disk is refused, because
//! its writers may have to wait; an access outside the mapping does nothing.
#![allow(unsafe_code)]

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Error, ErrorKind, Write};
use std::num::NonZeroUsize;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::ptr::NonNull;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering, fence};

use nix::sys::mman::{MapFlags, ProtFlags, mmap, munmap};
use nix::sys::statfs::{TMPFS_MAGIC, statfs};
use taktil_hal::Invalid;

/// The mapped bytes; unmapped when the last part of them is dropped. The file is open, and thereby
/// locked, for as long.
#[derive(Debug)]
struct Mapping {
    start: NonNull<u8>,
    bytes: usize,
    _file: File,
}

// SAFETY: the mapping belongs to the process, not to a thread, and is unmapped only on drop.
unsafe impl Send for Mapping {}
// SAFETY: `&Mapping` gives out nothing; memory is reached through `MappedRegion` only, and parts
// are disjoint.
unsafe impl Sync for Mapping {}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: `start` and `bytes` are those of a mapping that `Mapping::of` made, and no part
        // of it is left: each holds an `Arc` of this.
        let _ = unsafe { munmap(self.start.cast(), self.bytes) };
    }
}

/// A part of a mapping with one owner, who alone writes it.
#[derive(Debug)]
pub(crate) struct MappedRegion {
    map: Arc<Mapping>,
    first: usize,
    bytes: usize,
}

/// Creates `path` with `bytes` zero bytes, all of them there, locks it for this process and maps
/// it; parts of the given sizes, which together are the file.
///
/// # Errors
/// A path that cannot be created or that another process has locked, a file system that is no
/// memory, too little of it. The place is `path`.
pub(crate) fn create(path: &Path, sizes: &[usize]) -> Result<Vec<MappedRegion>, Invalid> {
    let bad = |what: String, remedy: &str| Invalid::new("path", what, remedy);
    let shown = path.display();
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let system = statfs(folder)
        .map_err(|error| bad(format!("{}: {error}", folder.display()), "make that folder first"))?;
    let kind = system.filesystem_type();
    if kind != TMPFS_MAGIC {
        let what = format!(
            "{shown} lies on a file system that writes back to a disk (type {:#x}): a lane that \
             writes there may have to wait",
            kind.0
        );
        return Err(bad(what, "name a file in /run or /dev/shm"));
    }
    let full = "make room there, or record fewer seconds";
    let whole = |error: std::io::Error| bad(format!("{shown}: {error}"), full);
    let bytes: usize = sizes.iter().sum();
    let file = open(path).map_err(|error| {
        bad(format!("{shown} cannot be created: {error}"), "name a file that can be made")
    })?;
    // Written, not only sized: a page that is not there would be a fault in a lane, or its end.
    let zeros = vec![0; 1 << 16];
    let mut left = bytes;
    while left > 0 {
        let now = left.min(zeros.len());
        (&file).write_all(&zeros[..now]).map_err(whole)?;
        left -= now;
    }
    let map = Arc::new(Mapping::of(file, bytes).map_err(|error| whole(error.into()))?);
    let mut first = 0;
    let part = |size: &usize| {
        let part = MappedRegion { map: Arc::clone(&map), first, bytes: *size };
        first += size;
        part
    };
    Ok(sizes.iter().map(part).collect())
}

/// A new file of its own, locked, also where one is already: somebody may still be reading that.
/// One that another process writes is left alone, and so is whatever is no file.
fn open(path: &Path) -> std::io::Result<File> {
    let flags = libc::O_CLOEXEC | libc::O_NOFOLLOW | libc::O_NONBLOCK;
    match std::fs::symlink_metadata(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => {}
        Err(error) => return Err(error),
        Ok(about) if !about.is_file() => {
            return Err(Error::new(ErrorKind::InvalidInput, "there is something that is no file"));
        }
        Ok(_) => {
            lock(&OpenOptions::new().read(true).custom_flags(flags).open(path)?)?;
            std::fs::remove_file(path)?;
        }
    }
    let mut options = OpenOptions::new();
    options.read(true).write(true).create_new(true).mode(0o640).custom_flags(flags);
    let file = options.open(path)?;
    lock(&file)?;
    Ok(file)
}

/// Locks a file for as long as it is open.
fn lock(file: &File) -> std::io::Result<()> {
    file.try_lock().map_err(|error| match error {
        TryLockError::WouldBlock => Error::other("another process is writing it"),
        TryLockError::Error(error) => error,
    })
}

impl Mapping {
    fn of(file: File, bytes: usize) -> nix::Result<Mapping> {
        let length = NonZeroUsize::new(bytes).ok_or(nix::errno::Errno::EINVAL)?;
        let access = ProtFlags::PROT_READ | ProtFlags::PROT_WRITE;
        let flags = MapFlags::MAP_SHARED | MapFlags::MAP_POPULATE;
        // SAFETY: a new mapping at an address of the kernel's choice covers nothing that exists.
        let start = unsafe { mmap(None, length, access, flags, &file, 0) }?;
        Ok(Mapping { start: start.cast(), bytes, _file: file })
    }
}

impl MappedRegion {
    /// Bytes of it.
    pub(crate) fn len(&self) -> usize {
        self.bytes
    }

    /// Copies `bytes` to `at`; what does not fit is left out whole.
    pub(crate) fn write(&mut self, at: usize, bytes: &[u8]) {
        if at.checked_add(bytes.len()).is_none_or(|end| end > self.bytes) {
            return;
        }
        // SAFETY: `first + at .. + bytes.len()` lies within this part, which lies within the
        // mapping, which lives as long as `map`. Nobody else writes this part (`&mut self`), no
        // reference to it exists, and `bytes` is a borrow of other memory. Another process may read
        // it meanwhile; it has to make sense of what it finds.
        unsafe {
            let to = self.map.start.as_ptr().add(self.first + at);
            core::ptr::copy_nonoverlapping(bytes.as_ptr(), to, bytes.len());
        }
    }

    /// Copies from `at` into `bytes`; outside the part it leaves them as they are.
    pub(crate) fn read(&self, at: usize, bytes: &mut [u8]) {
        if at.checked_add(bytes.len()).is_none_or(|end| end > self.bytes) {
            return;
        }
        // SAFETY: as in `write`; the only writer is the owner, who is here.
        unsafe {
            let from = self.map.start.as_ptr().add(self.first + at);
            core::ptr::copy_nonoverlapping(from, bytes.as_mut_ptr(), bytes.len());
        }
    }

    /// Stores a word at `at`, a multiple of 8, after everything that was written before and before
    /// everything that is written after.
    pub(crate) fn store_ordered(&self, at: usize, word: u64) {
        self.atomic(at, |cell| {
            // The fence keeps what follows behind the store, the order of the store what precedes
            // before it: a process killed anywhere leaves them in this order.
            cell.store(word.to_le(), Ordering::Release);
            fence(Ordering::SeqCst);
        });
    }

    /// Stores a word at `at`, a multiple of 8, in no particular order.
    pub(crate) fn store_relaxed(&self, at: usize, word: u64) {
        self.atomic(at, |cell| cell.store(word.to_le(), Ordering::Relaxed));
    }

    fn atomic(&self, at: usize, store: impl FnOnce(&AtomicU64)) {
        let (first, end) = (self.first + at, at.checked_add(8));
        if !first.is_multiple_of(8) || end.is_none_or(|end| end > self.bytes) {
            return;
        }
        // SAFETY: the 8 bytes lie within this part and the mapping, which lives as long as `map`;
        // the mapping starts at a page, so the address is aligned. Nobody else writes them.
        store(unsafe { AtomicU64::from_ptr(self.map.start.as_ptr().add(first).cast()) });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    #[test]
    fn parts_are_disjoint_bounded_and_in_the_file() {
        let path = Path::new("/dev/shm").join(format!("taktil-mapping-{}", std::process::id()));
        if statfs("/dev/shm").map(|found| found.filesystem_type()) != Ok(TMPFS_MAGIC) {
            let _ = writeln!(std::io::stderr(), "SKIPPED: /dev/shm is no tmpfs here");
            return;
        }
        let mut parts = create(&path, &[16, 24, 4096]).unwrap();
        parts[1].write(0, &[7; 24]);
        parts[1].write(1, &[9; 24]);
        parts[1].write(usize::MAX, &[9; 24]);
        parts[0].store_ordered(8, 0x0102);
        parts[0].store_ordered(9, u64::MAX);
        parts[0].store_relaxed(16, u64::MAX);
        let mut found = [1; 24];
        parts[1].read(0, &mut found);
        assert_eq!(found, [7; 24]);
        let file = std::fs::read(&path).unwrap();
        assert_eq!(file.len(), 16 + 24 + 4096);
        assert_eq!(file[..16], [0, 0, 0, 0, 0, 0, 0, 0, 2, 1, 0, 0, 0, 0, 0, 0]);
        assert_eq!((&file[16..40], file[40]), (&[7; 24][..], 0));
        let refused = create(&path, &[8]).unwrap_err();
        assert!(refused.what.contains("another process is writing it"), "{refused}");
        drop(parts);
        drop(create(&path, &[8]).unwrap());
        std::fs::remove_file(&path).unwrap();
    }

    #[test]
    fn unusable_paths_are_refused_with_a_remedy() {
        let somewhere = Path::new("/proc/taktil");
        assert_eq!(create(somewhere, &[8]).unwrap_err().remedy, "name a file in /run or /dev/shm");
        let folder = Path::new("/dev/shm");
        if statfs(folder).map(|found| found.filesystem_type()) == Ok(TMPFS_MAGIC) {
            let pipe = folder.join(format!("taktil-mapping-pipe-{}", std::process::id()));
            nix::unistd::mkfifo(&pipe, nix::sys::stat::Mode::S_IRWXU).unwrap();
            let refused = create(&pipe, &[8]).unwrap_err();
            assert!(refused.what.contains("something that is no file"), "{refused}");
            std::fs::remove_file(&pipe).unwrap();
        }
        let nowhere = Path::new("/nowhere/at/all");
        assert_eq!(create(nowhere, &[8]).unwrap_err().remedy, "make that folder first");
    }
}
