//! The bugs of tests/planted: each still applies to the source that it changes.

use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};

/// Why a patch does not apply to the tree below `root`, or nothing. Changes no file.
///
/// # Errors
/// When there is no program `git`.
fn refusal(root: &Path, patch: &str) -> std::io::Result<Option<String>> {
    let mut git = Command::new("git")
        .args(["apply", "--check", "-"])
        .current_dir(root)
        .stdin(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()?;
    if let Some(mut input) = git.stdin.take() {
        input.write_all(patch.as_bytes())?;
    }
    let output = git.wait_with_output()?;
    let said = String::from_utf8_lossy(&output.stderr).trim().replace('\n', "; ");
    Ok((!output.status.success()).then_some(said))
}

/// Complaints about patches, given as paths and texts. `None` where there is no program `git`.
pub(crate) fn stale(root: &Path, patches: &[(String, String)]) -> Option<Vec<String>> {
    let mut found = Vec::new();
    for (path, text) in patches {
        match refusal(root, text) {
            Ok(None) => {}
            Ok(Some(said)) => found.push(format!("{path} does not apply: {said}")),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return None,
            Err(error) => found.push(format!("{path} could not be tried: {error}")),
        }
    }
    Some(found)
}

#[test]
fn complains_about_a_patch_of_lines_that_are_gone() {
    let patch = "diff --git a/Cargo.toml b/Cargo.toml\n--- a/Cargo.toml\n+++ b/Cargo.toml\n\
                 @@ -1,1 +1,1 @@\n-No line of a manifest says this.\n+Nor this.\n";
    let patches = [("planted/old.patch".to_owned(), patch.to_owned())];
    let Some(found) = stale(&crate::source::root(), &patches) else { return };
    assert_eq!(found.len(), 1, "{found:?}");
    assert!(found[0].starts_with("planted/old.patch does not apply: error:"), "{found:?}");
}
