//! The listening end of the socket: made with the right mode, taken over from a killed process and
//! never from a living one, and removed at the end only if it is still the same file.

use std::os::unix::fs::{FileTypeExt, MetadataExt, PermissionsExt};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};

use taktil_rtcore::Invalid;

/// A socket's file, by device and number.
type FileId = (u64, u64);

/// A socket that listens.
#[derive(Debug)]
pub(crate) struct Listener {
    listener: UnixListener,
    path: PathBuf,
    file: Option<FileId>,
}

impl Listener {
    /// Listens at `path`, for everyone who may reach it or else for the owner and the group of the
    /// process.
    ///
    /// # Errors
    /// A path on which another process listens, which is not a socket, or cannot be made.
    pub(crate) fn bind(path: &Path, for_everyone: bool) -> Result<Listener, Invalid> {
        let shown = path.display();
        let bad = |what: String, remedy: &str| Err(Invalid::new("socket", what, remedy));
        if let Ok(about) = std::fs::symlink_metadata(path) {
            if !about.file_type().is_socket() {
                return bad(format!("`{shown}` is there and no socket"), "name another path");
            }
            if UnixStream::connect(path).is_ok() {
                let what = format!("somebody listens at `{shown}` already");
                return bad(what, "end the other run, or name another path");
            }
            // The socket is left over from a process that was killed.
            let _ = std::fs::remove_file(path);
        }
        let mode = if for_everyone { 0o666 } else { 0o660 };
        let listener = UnixListener::bind(path).and_then(|listener| {
            listener.set_nonblocking(true)?;
            std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode))?;
            Ok(listener)
        });
        match listener {
            Err(error) => bad(
                format!("cannot listen at `{shown}`: {error}"),
                "name a path of at most 100 characters in a folder that can be written",
            ),
            Ok(listener) => Ok(Listener { listener, path: path.to_owned(), file: file_id(path) }),
        }
    }

    /// The socket, to wait for it.
    pub(crate) fn socket(&self) -> &UnixListener {
        &self.listener
    }

    /// The next connection that waits, not blocking.
    pub(crate) fn accept(&self) -> Option<UnixStream> {
        let (stream, _) = self.listener.accept().ok()?;
        stream.set_nonblocking(true).ok()?;
        Some(stream)
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        // A file that another process has put there in the meantime stays.
        if self.file.is_some() && file_id(&self.path) == self.file {
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

fn file_id(path: &Path) -> Option<FileId> {
    let about = std::fs::symlink_metadata(path).ok()?;
    Some((about.dev(), about.ino()))
}
