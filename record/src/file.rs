//! The file of a log that is being written: locked by its writer, a regular file whatever its name
//! says, touched only when there is something to write, and whole records only.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Error, ErrorKind, Read, Seek, SeekFrom, Write};
use std::os::unix::fs::{FileTypeExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use anyhow::{anyhow, bail};
use mcap::records::op;
use nix::fcntl::OFlag;
use nix::unistd::geteuid;

use crate::METADATA_END;

/// Bytes that a flush writes, reserved from the start.
const BUFFER_BYTES: usize = 1 << 18;

/// A file for one writer. Bytes are collected and reach the kernel in one write at each flush; the
/// first flush replaces what the file held. What a failed write left half is cut off again.
#[derive(Debug)]
pub struct LogFile {
    file: File,
    path: PathBuf,
    buffer: Vec<u8>,
    written: u64,
    begun: bool,
    broken: bool,
    created: bool,
}

impl LogFile {
    /// Opens `path`, or makes it, and locks it. What it holds stays until the first flush.
    ///
    /// # Errors
    /// A directory, a device, a pipe or a socket; a file that another process is writing; what the
    /// kernel refuses.
    pub fn open(path: &Path) -> anyhow::Result<LogFile> {
        let shown = path.display();
        let created = !path.exists();
        let refuse = |why| anyhow!("cannot write a log to {shown}: {why:#}; name another file");
        let file = open_regular(path).map_err(refuse)?;
        lock(&file).map_err(refuse)?;
        Ok(LogFile {
            file,
            path: path.to_owned(),
            buffer: Vec::with_capacity(BUFFER_BYTES),
            written: 0,
            begun: false,
            broken: false,
            created,
        })
    }

    /// Whether the file holds something that is not this writer's.
    #[must_use]
    pub fn holds_another(&self) -> bool {
        !self.begun && self.file.metadata().is_ok_and(|about| about.len() > 0)
    }

    /// Closes a file whose last write failed: behind its last whole chunk it gets the metadata
    /// record [`METADATA_END`] with `json` and a footer without an index. That takes less room than
    /// the chunk that was cut off. A file in which nothing stands is deleted.
    ///
    /// # Errors
    /// Not even that could be written; then the file ends with its last whole chunk.
    pub fn close_short(&mut self, json: &str) -> std::io::Result<()> {
        self.buffer.clear();
        self.broken = true;
        if !self.begun || self.written == 0 {
            self.begun = true;
            return std::fs::remove_file(&self.path);
        }
        let end = short_end(json);
        let written = self.file.write_all(&end);
        if written.is_err() {
            let _ = self.file.set_len(self.written);
        }
        written
    }

    fn write_buffer(&mut self) -> std::io::Result<()> {
        if !self.begun {
            self.file.set_len(0)?;
            self.begun = true;
        }
        self.file.write_all(&self.buffer)?;
        self.written += self.buffer.len() as u64;
        self.buffer.clear();
        Ok(())
    }
}

impl Write for LogFile {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        if self.broken {
            return Err(Error::other("an earlier write failed"));
        }
        self.buffer.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        if self.broken {
            return Err(Error::other("an earlier write failed"));
        }
        self.write_buffer().inspect_err(|_| {
            self.broken = true;
            // Half a chunk would be damage; shortening a file needs no room.
            let _ = self.file.set_len(self.written);
            let _ = self.file.seek(SeekFrom::Start(self.written));
        })
    }
}

impl Seek for LogFile {
    /// Tells the position; moving it is an error, because a log only grows.
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        match to {
            SeekFrom::Current(0) => Ok(self.written + self.buffer.len() as u64),
            _ => Err(Error::from(ErrorKind::Unsupported)),
        }
    }
}

impl Drop for LogFile {
    fn drop(&mut self) {
        // An empty file that was made here and never used would only be in the way.
        if self.created && !self.begun {
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// The end of a log that has no room for its own: a metadata record, the end of the data and a
/// footer, without checksums and without an index.
fn short_end(json: &str) -> Vec<u8> {
    let mut end = Vec::new();
    let mut body = Vec::new();
    let mut table = Vec::new();
    append_text(&mut table, "json");
    append_text(&mut table, json);
    append_text(&mut body, METADATA_END);
    body.extend(u32::try_from(table.len()).unwrap_or(0).to_le_bytes());
    body.extend(table);
    for (opcode, body) in
        [(op::METADATA, body), (op::DATA_END, vec![0; 4]), (op::FOOTER, vec![0; 20])]
    {
        end.push(opcode);
        end.extend((body.len() as u64).to_le_bytes());
        end.extend(body);
    }
    end.extend(mcap::MAGIC);
    end
}

/// A text of the format: its length and its bytes.
fn append_text(out: &mut Vec<u8>, text: &str) {
    out.extend(u32::try_from(text.len()).unwrap_or(0).to_le_bytes());
    out.extend(text.as_bytes());
}

/// Opens a file for reading and writing without waiting for anybody, and refuses everything that is
/// no regular file, also behind a link.
///
/// # Errors
/// What stands there, in words, or what the kernel refuses.
pub(crate) fn open_regular(path: &Path) -> anyhow::Result<File> {
    // A device is not even opened: that alone may move something.
    if let Ok(about) = std::fs::metadata(path) {
        require_regular(about.file_type())?;
    }
    let mut options = OpenOptions::new();
    options.read(true).write(true).create(true).truncate(false).mode(0o640);
    options.custom_flags((OFlag::O_NONBLOCK | OFlag::O_CLOEXEC | OFlag::O_NOCTTY).bits());
    let file = options.open(path).map_err(|error| match error.kind() {
        ErrorKind::NotFound => anyhow::anyhow!("{error}; does its directory exist?"),
        _ => anyhow::anyhow!("{error}"),
    })?;
    require_regular(file.metadata()?.file_type())?;
    Ok(file)
}

/// Refuses whatever is no regular file.
fn require_regular(kind: std::fs::FileType) -> anyhow::Result<()> {
    let what = match () {
        () if kind.is_file() => return Ok(()),
        () if kind.is_dir() => "it is a directory; name a file in it",
        () if kind.is_fifo() => "it is a pipe; name a file",
        () if kind.is_socket() => "it is a socket; name a file",
        () => "it is a device; name a file",
    };
    bail!("{what}")
}

/// Takes the lock of a file for as long as it is open.
///
/// # Errors
/// Another process, or another writer in this one, holds it.
pub(crate) fn lock(file: &File) -> anyhow::Result<()> {
    match file.try_lock() {
        Ok(()) => Ok(()),
        Err(TryLockError::WouldBlock) => {
            bail!("another process is writing it; name another file, or end that process")
        }
        Err(TryLockError::Error(error)) => bail!("it cannot be locked: {error}"),
    }
}

/// A regular file of this user, locked, and its contents; `None` where there is none. Neither a
/// link is followed nor a pipe waited for.
///
/// # Errors
/// Another kind of file, one of another user, one that another process has locked.
pub(crate) fn own_contents(path: &Path) -> anyhow::Result<Option<(File, Vec<u8>)>> {
    let mut options = OpenOptions::new();
    options.read(true);
    let flags = OFlag::O_NONBLOCK | OFlag::O_CLOEXEC | OFlag::O_NOFOLLOW | OFlag::O_NOCTTY;
    let about = match std::fs::symlink_metadata(path) {
        Ok(about) => about,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        Err(error) => bail!("it cannot be looked at: {error}"),
    };
    if about.file_type().is_symlink() {
        bail!("it is a link; name the file itself");
    }
    require_regular(about.file_type())?;
    let user = geteuid().as_raw();
    if about.uid() != user {
        bail!("it belongs to user {}, this process is user {user}", about.uid());
    }
    let mut file = options.custom_flags(flags.bits()).open(path)?;
    require_regular(file.metadata()?.file_type())?;
    lock(&file)?;
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes)?;
    Ok(Some((file, bytes)))
}
