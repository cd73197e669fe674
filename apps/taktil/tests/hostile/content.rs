//! What stands at a path, and what has to be true of a process that reads it: an exit code, a few
//! words with place and remedy, and nothing that a terminal would obey.

use std::path::Path;
use std::process::Output;

/// Longest message (bytes).
const MESSAGE_BYTES_MAX: usize = 2048;

/// What stands at a path.
#[derive(Clone, Debug)]
pub(crate) enum Content {
    Bytes(Vec<u8>),
    /// A named pipe that nobody writes to.
    Pipe,
    Folder,
    /// A symbolic link to this path.
    Link(&'static str),
    Nothing,
}

/// What is expected of the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// It refuses the input.
    Refused,
    /// It may find nothing wrong with it.
    Any,
}

impl Content {
    pub(crate) fn write(&self, path: &Path) {
        match self {
            Content::Bytes(bytes) => std::fs::write(path, bytes).unwrap(),
            Content::Pipe => {
                nix::unistd::mkfifo(path, nix::sys::stat::Mode::S_IRWXU).unwrap();
            }
            Content::Folder => std::fs::create_dir(path).unwrap(),
            Content::Link(target) => std::os::unix::fs::symlink(target, path).unwrap(),
            Content::Nothing => {}
        }
    }
}

/// Takes away whatever stands at a path.
pub(crate) fn remove(path: &Path) {
    match path.symlink_metadata() {
        Ok(about) if about.is_dir() => std::fs::remove_dir_all(path).unwrap(),
        Ok(_) => std::fs::remove_file(path).unwrap(),
        Err(_) => {}
    }
}

/// What is wrong with the end and the words of a process.
pub(crate) fn judge(output: &Output, verdict: Verdict) -> Option<String> {
    let (out, err) = (&*output.stdout, &*output.stderr);
    let code = match output.status.code() {
        Some(code @ 0..=2) => code,
        _ => return Some(format!("ended by {}", output.status)),
    };
    let text = String::from_utf8_lossy(err);
    if text.contains("panicked") {
        return Some("a panic".to_owned());
    }
    let is_obeyed = |byte: &u8| byte.is_ascii_control() && !matches!(byte, b'\n' | b'\t');
    if out.iter().chain(err).any(is_obeyed) {
        return Some("a terminal would obey what was written".to_owned());
    }
    if code == 0 {
        return (verdict == Verdict::Refused).then(|| "was taken".to_owned());
    }
    if err.len() > MESSAGE_BYTES_MAX {
        return Some(format!("a message of {} bytes", err.len()));
    }
    // Remedies stand in a line of their own, behind a semicolon or after what an option takes.
    let has_remedy = ["\n  = ", "; ", ": give ", "--help"].iter().any(|sign| text.contains(sign));
    // A command that answers a question does so on standard output.
    let is_answer = err.is_empty() && !out.is_empty();
    let is_refusal = verdict == Verdict::Refused || (code == 2 && !is_answer);
    (is_refusal && !(text.contains("error: ") && has_remedy))
        .then(|| "a message without place or remedy".to_owned())
}
