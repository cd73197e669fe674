//! Rules about words: module docs, names of files, ignored tests, and what no text of the project
//! may mention.

use crate::source::{Rust, Text};

/// Complaints about modules that do not open with `//!`.
pub(crate) fn undocumented_modules(files: &[Rust]) -> Vec<String> {
    files
        .iter()
        .filter(|file| !file.raw.starts_with("//! "))
        .map(|file| {
            format!("{}:1: the first line is not `//!` and what the module is for", file.path)
        })
        .collect()
}

/// Complaints about `#[ignore]` without a reason.
pub(crate) fn ignored_without_reason(files: &[Rust]) -> Vec<String> {
    let mut found = Vec::new();
    for file in files {
        for (number, line) in file.lines.iter().enumerate() {
            if line.code.replace(' ', "").contains("#[ignore]") {
                found.push(format!("{}:{}: say why: #[ignore = \"...\"]", file.path, number + 1));
            }
        }
    }
    found
}

/// Names that mean "whatever did not fit elsewhere".
const JUNK: &[&str] = &["utils", "util", "helpers", "helper", "misc", "prelude", "mod2"];

/// Complaints about files and folders with such names.
pub(crate) fn junk_drawers(files: &[Text]) -> Vec<String> {
    let mut found = Vec::new();
    for file in files {
        let bad =
            file.path.split('/').find(|part| JUNK.contains(&part.split('.').next().unwrap_or("")));
        if let Some(part) = bad {
            found.push(format!("{}: `{part}` says nothing; name what it holds", file.path));
        }
    }
    found
}

/// Words of one machine or one desk, not of the project. In pieces, so that this file is clean.
const FOREIGN: &[(&str, &str)] = &[
    (concat!("/wo", "rk/"), "a path of one machine"),
    (concat!("/tm", "p/"), "a path of one machine; use the system's temporary folder"),
    (concat!("/ho", "me/"), "a path of one machine"),
    (concat!("/ro", "ot/"), "a path of one machine"),
    (concat!("this ses", "sion"), "nobody reading has a session"),
    (concat!("TO", "DO"), "do it, or say in prose what is missing"),
    (concat!("FIX", "ME"), "mend it, or say in prose what is wrong"),
];

/// Parts of a host name that smell of a private mirror.
const PRIVATE: &[&str] =
    &["registry", "mirror", "artifact", "nexus", "proxy.", "internal", "localhost", "corp."];

/// Complaints about such words.
pub(crate) fn foreign_words(files: &[Text]) -> Vec<String> {
    let mut found = Vec::new();
    for file in files {
        if file.path == "Cargo.lock" || file.path.starts_with("LICENSE") {
            continue;
        }
        for (number, line) in file.raw.lines().enumerate() {
            for complaint in foreign_words_of_line(line) {
                found.push(format!("{}:{}: {complaint}", file.path, number + 1));
            }
        }
    }
    found
}

/// Complaints about one line.
fn foreign_words_of_line(line: &str) -> Vec<String> {
    let mut found = Vec::new();
    for (word, why) in FOREIGN {
        if line.contains(word) {
            found.push(format!("`{word}`: {why}"));
        }
    }
    let lower = line.to_lowercase();
    for (at, word) in lower.match_indices("issue") {
        let rest = lower[at + word.len()..].trim_start_matches('s');
        let number = rest.strip_prefix([' ', '-', '_']).map(|rest| rest.trim_start_matches('#'));
        if number.is_some_and(|rest| rest.starts_with(|c: char| c.is_ascii_digit())) {
            found.push("a numbered issue: say what it was about".to_string());
        }
    }
    for host in lower.split("://").skip(1) {
        let host = host.split(|c: char| !(c.is_alphanumeric() || "-._:".contains(c))).next();
        let host = host.unwrap_or("");
        if PRIVATE.iter().any(|part| host.contains(part)) {
            found.push(format!("`{host}` looks like a private host"));
        }
    }
    found
}

#[test]
fn a_module_without_a_purpose_is_seen() {
    let bad = [Rust::new("a.rs", "use b;\n//! late"), Rust::new("b.rs", "")];
    assert_eq!(undocumented_modules(&bad).len(), 2);
    assert!(undocumented_modules(&[Rust::new("a.rs", "//! What for.\n")]).is_empty());
}

#[test]
fn an_ignored_test_without_a_reason_is_seen() {
    let bad = Rust::new("a.rs", "//! x\n#[test]\n#[ignore]\nfn f() {}\n");
    assert_eq!(ignored_without_reason(&[bad]).len(), 1);
    let good = Rust::new("a.rs", "//! `#[ignore]`\n#[ignore = \"needs a board\"]\nfn f() {}\n");
    assert!(ignored_without_reason(&[good]).is_empty());
}

#[test]
fn a_junk_drawer_is_seen() {
    let text = |path: &str| Text { path: path.to_string(), raw: String::new() };
    assert_eq!(junk_drawers(&[text("sim/src/utils.rs"), text("hal/src/prelude/mod.rs")]).len(), 2);
    assert!(junk_drawers(&[text("sim/src/hash.rs")]).is_empty());
}

#[test]
fn a_foreign_word_is_seen() {
    for (word, _) in FOREIGN {
        assert_eq!(foreign_words_of_line(&format!("see {word}x")).len(), 1, "{word}");
    }
    for bad in [
        concat!("solves is", "sue 7"),
        concat!("Is", "sue #12"),
        concat!("issues", "-3"),
        concat!("https:/", "/registry.lab.example/x"),
    ] {
        assert_eq!(foreign_words_of_line(bad).len(), 1, "{bad}");
    }
    let good = "issues a command; https://crates.io, https://github.com/rust-lang/crates.io-index";
    assert!(foreign_words_of_line(good).is_empty());
}
