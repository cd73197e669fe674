//! The build script of the crates whose programs say their version: `TAKTIL_VERSION` is the
//! version, with the commit in brackets where the source is a clone.

use std::io::Write as _;
use std::process::Command;

fn main() {
    let version = std::env::var("CARGO_PKG_VERSION").unwrap_or_default();
    let version = match git(&["rev-parse", "--short=12", "HEAD"]) {
        Some(commit) => format!("{version} ({commit})"),
        None => version,
    };
    // Cargo reads this script's output; without it the build says what is missing.
    let _ = writeln!(std::io::stdout(), "cargo::rustc-env=TAKTIL_VERSION={version}");
    // The log of the head changes with each commit, the head itself with each change of branch.
    for name in ["HEAD", "logs/HEAD"] {
        let path = git(&["rev-parse", "--path-format=absolute", "--git-path", name]);
        // A file that is not there would count as changed in every build.
        if let Some(path) = path.filter(|path| std::path::Path::new(path).is_file()) {
            let _ = writeln!(std::io::stdout(), "cargo::rerun-if-changed={path}");
        }
    }
}

/// What git answers; `None` without git or a clone.
fn git(arguments: &[&str]) -> Option<String> {
    let said = Command::new("git").args(arguments).output().ok()?;
    let text = String::from_utf8(said.stdout).ok()?.trim().to_owned();
    (said.status.success() && !text.is_empty()).then_some(text)
}
