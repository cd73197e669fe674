//! Reads the files in which a host describes itself: the running host, or a recorded tree of
//! `/proc`, `/sys` and `/dev`. Nothing is written, no link is followed out of a recorded tree, no
//! read waits for a pipe, and every read has a bound. The reason of a failed read is a result too.

use std::fmt;
use std::io::Read;
use std::path::{Path, PathBuf};

use taktil_machine_console::option::BadOption;

/// Longest file that is read (bytes).
const FILE_BYTES_MAX: u64 = 4 << 20;

/// The reason why there is no text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReadError {
    /// Path of the file, from the root of the tree.
    pub path: String,
    /// Kind of the error.
    pub kind: ReadErrorKind,
}

/// The kinds of [`ReadError`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ReadErrorKind {
    /// There is no such file.
    Absent,
    /// The file has no byte.
    Empty,
    /// The file is there and cannot be read or understood.
    Unreadable(String),
}

impl fmt::Display for ReadError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.kind {
            ReadErrorKind::Absent => write!(f, "/{} is not there", self.path),
            ReadErrorKind::Empty => write!(f, "/{} is empty", self.path),
            ReadErrorKind::Unreadable(why) => write!(f, "/{}: {why}", self.path),
        }
    }
}

impl ReadError {
    /// The error of a file whose text cannot be parsed.
    #[must_use]
    pub fn unintelligible(path: &str) -> ReadError {
        ReadError {
            path: path.to_owned(),
            kind: ReadErrorKind::Unreadable("makes no sense".to_owned()),
        }
    }
}

/// The source of the facts.
#[derive(Clone, Debug)]
pub struct Host {
    root: PathBuf,
    live: bool,
}

impl Host {
    /// The running host.
    #[must_use]
    pub fn live() -> Host {
        Host { root: PathBuf::from("/"), live: true }
    }

    /// A recorded tree with `proc` or `sys` in it.
    ///
    /// A folder that does not exist or holds neither, because a mistyped path would otherwise look
    /// like a host of which nothing is known.
    pub fn recorded(root: &Path) -> Result<Host, BadOption> {
        let complain = |what: &str| Err(BadOption(format!("--root {}: {what}", root.display())));
        let Ok(root) = root.canonicalize() else {
            return complain("there is no such folder");
        };
        if !root.join("proc").is_dir() && !root.join("sys").is_dir() {
            return complain("holds neither `proc` nor `sys`; name the folder above them");
        }
        Ok(Host { root, live: false })
    }

    /// True for the running host, on which grants may be tried.
    #[must_use]
    pub fn is_live(&self) -> bool {
        self.live
    }

    fn resolved(&self, path: &str) -> Result<PathBuf, ReadError> {
        let read_error = |kind| ReadError { path: path.to_owned(), kind };
        let whole = self.root.join(path);
        if self.live {
            return Ok(whole);
        }
        let real = whole.canonicalize().map_err(|error| read_error(error_kind(&error)))?;
        if real.starts_with(&self.root) {
            return Ok(real);
        }
        Err(read_error(ReadErrorKind::Unreadable("a link out of the recorded tree".to_owned())))
    }

    /// The bytes of a file, at most `FILE_BYTES_MAX` of them; `path` without the leading slash.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn bytes(&self, path: &str) -> Result<Vec<u8>, ReadError> {
        let read_error = |kind| ReadError { path: path.to_owned(), kind };
        let place = self.resolved(path)?;
        if !self.live && !place.is_file() {
            return Err(read_error(ReadErrorKind::Unreadable("not a file".to_owned())));
        }
        let mut out = Vec::new();
        let file = std::fs::File::open(place).map_err(|error| read_error(error_kind(&error)))?;
        file.take(FILE_BYTES_MAX)
            .read_to_end(&mut out)
            .map_err(|error| read_error(error_kind(&error)))?;
        if out.is_empty() { Err(read_error(ReadErrorKind::Empty)) } else { Ok(out) }
    }

    /// The text of a file without white space at its ends; invalid UTF-8 is replaced.
    ///
    /// # Errors
    /// The file cannot be read. A file with nothing but a line feed is no error: the kernel writes
    /// "none" in this way.
    pub fn text(&self, path: &str) -> Result<String, ReadError> {
        Ok(String::from_utf8_lossy(&self.bytes(path)?).trim().to_owned())
    }

    /// The entries of a folder in order of their names; an empty list when it cannot be read.
    #[must_use]
    pub fn names(&self, path: &str) -> Vec<String> {
        let Ok(entries) = self.resolved(path).and_then(|place| {
            std::fs::read_dir(place)
                .map_err(|error| ReadError { path: path.to_owned(), kind: error_kind(&error) })
        }) else {
            return Vec::new();
        };
        let mut names: Vec<String> =
            entries.flatten().map(|entry| entry.file_name().to_string_lossy().into()).collect();
        names.sort_unstable();
        names
    }

    /// True when `path` exists.
    #[must_use]
    pub fn has(&self, path: &str) -> bool {
        self.resolved(path).is_ok_and(|place| place.exists())
    }
}

fn error_kind(error: &std::io::Error) -> ReadErrorKind {
    match error.kind() {
        std::io::ErrorKind::NotFound | std::io::ErrorKind::NotADirectory => ReadErrorKind::Absent,
        std::io::ErrorKind::PermissionDenied => {
            ReadErrorKind::Unreadable("reading it is not permitted".to_owned())
        }
        _ => ReadErrorKind::Unreadable("cannot be read".to_owned()),
    }
}
