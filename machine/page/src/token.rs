//! The control token: whoever knows it may command from a page. It lies in a file that only its
//! owner may read, and goes nowhere else: no address, no log, no answer holds it.

use std::fmt;
use std::fs::{self, File, OpenOptions};
use std::io::{Read, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use taktil_rtcore::Invalid;

/// Random bytes of a token that is made here.
const MADE_BYTES: usize = 32;
/// Shortest and longest token that a file may hold (characters).
const CHARACTERS_MIN: usize = 32;
const CHARACTERS_MAX: usize = 1024;

/// Where the token comes from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TokenSource {
    /// A file that is there, with a secret of at least 32 characters.
    Existing(PathBuf),
    /// A file that is made with a new secret, and removed at the end.
    Made(PathBuf),
}

/// The secret of a server.
pub struct ControlToken {
    secret: String,
    path: PathBuf,
    is_made: bool,
}

impl fmt::Debug for ControlToken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ControlToken").field("path", &self.path).finish_non_exhaustive()
    }
}

impl ControlToken {
    /// Reads or makes the token.
    ///
    /// # Errors
    /// A file that cannot be read or made, that others may read, or whose secret is too short.
    pub fn from_source(source: TokenSource) -> Result<ControlToken, Invalid> {
        match source {
            TokenSource::Existing(path) => {
                let secret = read(&path)?;
                Ok(ControlToken { secret, path, is_made: false })
            }
            TokenSource::Made(path) => {
                let secret = make(&path).map_err(|error| {
                    let what = format!("`{}` cannot be made: {error}", path.display());
                    Invalid::new("--token-file", what, "name a file with a secret of your own")
                })?;
                Ok(ControlToken { secret, path, is_made: true })
            }
        }
    }

    /// The file that holds it.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether somebody knows the token. The time that this takes does not depend on how much of
    /// it is right.
    #[must_use]
    pub fn is_matched_by(&self, offered: &str) -> bool {
        let (secret, offered) = (self.secret.as_bytes(), offered.trim().as_bytes());
        let mut difference = secret.len() ^ offered.len();
        for (at, byte) in secret.iter().enumerate() {
            let other = offered.get(at).copied().unwrap_or(0);
            difference |= usize::from(core::hint::black_box(byte ^ other));
        }
        core::hint::black_box(difference) == 0
    }
}

impl Drop for ControlToken {
    fn drop(&mut self) {
        if self.is_made {
            let _ = fs::remove_file(&self.path);
        }
    }
}

/// Where a token is put that was made for the page at a port.
pub(crate) fn default_path(port: u16) -> PathBuf {
    let folder = std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from);
    let folder = folder.filter(|folder| folder.is_dir()).unwrap_or_else(std::env::temp_dir);
    folder.join(format!("taktil-page-{port}.token"))
}

fn read(path: &Path) -> Result<String, Invalid> {
    let bad = |what: String, remedy: &str| Err(Invalid::new("--token-file", what, remedy));
    let shown = path.display();
    let opened = File::open(path).and_then(|file| Ok((file.metadata()?, file)));
    let (about, file) = match opened {
        Ok(opened) => opened,
        Err(error) => return bad(format!("`{shown}` cannot be read: {error}"), "make it first"),
    };
    if !about.is_file() || about.mode() & 0o077 != 0 {
        let what = format!("`{shown}` is no file that only its owner may read");
        return bad(what, "chmod 600 it");
    }
    let mut text = String::new();
    let most = CHARACTERS_MAX as u64 + 2;
    if file.take(most).read_to_string(&mut text).is_err() {
        return bad(format!("`{shown}` is no text"), "write a line of letters and digits");
    }
    let secret = text.trim();
    if !(CHARACTERS_MIN..=CHARACTERS_MAX).contains(&secret.len()) {
        let what = format!("`{shown}` holds {} characters", secret.len());
        return bad(what, "give a secret of 32 to 1024 characters: `openssl rand -hex 32`");
    }
    Ok(secret.to_owned())
}

/// Makes the file; one that is there belongs to a server that was killed, or the folder's rights
/// keep it from being removed.
fn make(path: &Path) -> std::io::Result<String> {
    let mut bytes = [0; MADE_BYTES];
    File::open("/dev/urandom")?.read_exact(&mut bytes)?;
    let secret: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    if fs::symlink_metadata(path).is_ok() {
        fs::remove_file(path)?;
    }
    let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(path)?;
    file.write_all(format!("{secret}\n").as_bytes())?;
    Ok(secret)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    fn place(name: &str) -> PathBuf {
        std::env::temp_dir().join(format!("taktil-token-{}-{name}", std::process::id()))
    }

    #[test]
    fn a_made_token_is_for_its_owner_alone_differs_each_time_and_goes_with_its_server() {
        let path = place("made");
        let first = ControlToken::from_source(TokenSource::Made(path.clone())).unwrap();
        let text = fs::read_to_string(&path).unwrap();
        assert_eq!(fs::metadata(&path).unwrap().mode() & 0o777, 0o600);
        assert!(first.is_matched_by(text.trim()) && first.is_matched_by(&text));
        let wrong = [
            "".to_owned(),
            text[..63].to_owned(),
            format!("{}0", text.trim()),
            text.trim().replace(|c: char| c.is_ascii_digit(), "z"),
            "\0".repeat(64),
        ];
        for wrong in wrong {
            assert!(!first.is_matched_by(&wrong), "{wrong}");
        }
        assert!(!format!("{first:?}").contains(&first.secret), "no debug output holds it");
        let second = ControlToken::from_source(TokenSource::Made(path.clone())).unwrap();
        assert!(!second.is_matched_by(&first.secret));
        drop(second);
        assert!(!path.exists());
    }

    #[test]
    fn a_file_that_others_may_read_or_that_says_too_little_is_refused() {
        let path = place("given");
        for (text, mode, says) in [
            ("0123456789abcdef0123456789abcdef\n", 0o644, "only its owner"),
            ("0123456789abcdef0123456789abcdef\n", 0o640, "only its owner"),
            ("short\n", 0o600, "5 characters"),
            ("", 0o600, "0 characters"),
        ] {
            fs::write(&path, text).unwrap();
            fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
            let bad = ControlToken::from_source(TokenSource::Existing(path.clone())).unwrap_err();
            assert!(bad.what.contains(says), "{bad:?}");
        }
        fs::write(&path, "0123456789abcdef0123456789abcdef\n").unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o600)).unwrap();
        let token = ControlToken::from_source(TokenSource::Existing(path.clone())).unwrap();
        assert!(token.is_matched_by("0123456789abcdef0123456789abcdef"));
        drop(token);
        assert!(path.exists(), "somebody else's file stays");
        fs::remove_file(&path).unwrap();
        assert!(ControlToken::from_source(TokenSource::Existing(path)).is_err());
    }
}
