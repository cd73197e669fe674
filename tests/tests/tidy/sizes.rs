//! How long files, functions and lines may be. Today's exceptions stand in `ratchet.toml` with
//! their size; they may shrink and vanish, never grow.

use std::collections::BTreeMap;

use crate::calls::find_word;
use crate::source::{Rust, body, is_word};

/// Lines of a file.
const FILE_LINES: usize = 500;
/// Lines of a function, from `fn` to its closing brace.
const FUNCTION_LINES: usize = 70;
/// Characters of a line.
const LINE_COLUMNS: usize = 100;

type Sizes = BTreeMap<String, usize>;

/// Exceptions: file -> lines, file::function -> lines, file -> number of lines that are too wide.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Ratchet {
    files: Sizes,
    functions: Sizes,
    columns: Sizes,
}

impl Ratchet {
    /// Reads the checked-in exceptions.
    pub(crate) fn parse(text: &str) -> Ratchet {
        let table: toml::Table = text.parse().unwrap_or_else(|error| panic!("ratchet: {error}"));
        let part = |name: &str| {
            let entries = table.get(name).and_then(toml::Value::as_table);
            let size = |value: &toml::Value| value.as_integer().and_then(|n| n.try_into().ok());
            entries
                .into_iter()
                .flatten()
                .map(|(key, value)| (key.clone(), size(value).expect("a size is a number")))
                .collect()
        };
        Ratchet { files: part("files"), functions: part("functions"), columns: part("columns") }
    }
}

/// Bytes of a file.
const FILE_BYTES: u64 = 1_000_000;

/// Complaints about files that nobody wrote: packages, recordings, programs. Logs of runs, which
/// version control passes over, may lie about.
pub(crate) fn oversized_files(files: &[(String, u64)]) -> Vec<String> {
    let found =
        files.iter().filter(|(path, bytes)| *bytes > FILE_BYTES && !path.ends_with(".mcap"));
    found.map(|(path, bytes)| format!("{path}: {bytes} bytes are no source; remove it")).collect()
}

/// Complaints about the tree.
pub(crate) fn violations(files: &[Rust], ratchet: &Ratchet) -> Vec<String> {
    let now = measure(files);
    let mut found = compare("files", &now.files, &ratchet.files);
    found.extend(compare("functions", &now.functions, &ratchet.functions));
    found.extend(compare("columns", &now.columns, &ratchet.columns));
    found
}

/// What exceeds the house's numbers.
fn measure(files: &[Rust]) -> Ratchet {
    let mut now = Ratchet::default();
    for file in files {
        let lines = file.raw.lines().count();
        if lines > FILE_LINES {
            now.files.insert(file.path.clone(), lines);
        }
        for (name, lines) in functions(file).into_iter().filter(|(_, n)| *n > FUNCTION_LINES) {
            let size = now.functions.entry(format!("{}::{name}", file.path)).or_default();
            *size = lines.max(*size);
        }
        let wide = file.raw.lines().filter(|line| line.chars().count() > LINE_COLUMNS).count();
        if wide > 0 {
            now.columns.insert(file.path.clone(), wide);
        }
    }
    now
}

fn compare(part: &str, now: &Sizes, allowed: &Sizes) -> Vec<String> {
    let mut found = Vec::new();
    for (key, size) in now {
        match allowed.get(key) {
            Some(limit) if size == limit => {}
            Some(limit) if size < limit => found.push(format!(
                "[{part}] \"{key}\" shrank from {limit} to {size}: lower its entry in ratchet.toml"
            )),
            Some(limit) => found.push(format!("[{part}] \"{key}\" grew from {limit} to {size}")),
            None => found.push(format!("[{part}] \"{key}\" = {size} exceeds the house's number")),
        }
    }
    for key in allowed.keys().filter(|key| !now.contains_key(*key)) {
        found.push(format!("[{part}] \"{key}\" needs no exception any more: remove its entry"));
    }
    found
}

/// Names and lengths of the functions of a file, nested ones included.
fn functions(file: &Rust) -> Vec<(String, usize)> {
    let mut found = Vec::new();
    for (number, line) in file.lines.iter().enumerate() {
        if !find_word(&line.code, "fn") {
            continue;
        }
        let Some(at) = line.code.find("fn ") else { continue };
        let rest = &line.code[at + 3..];
        let name: String = rest.chars().take_while(|c| is_word(*c)).collect();
        let column = line.code[..at].chars().count();
        if let Some((_, end)) = body(&file.lines, number, column).filter(|_| !name.is_empty()) {
            found.push((name, end - number + 1));
        }
    }
    found
}

#[cfg(test)]
fn long(lines: usize, width: usize) -> Rust {
    let inner = format!("    // {}\n", "x".repeat(width)).repeat(lines - 2);
    Rust::new("hal/src/x.rs", &format!("fn f() {{\n{inner}}}\n"))
}

#[test]
fn what_is_too_long_is_seen() {
    let ratchet = Ratchet::default();
    assert!(violations(&[long(FUNCTION_LINES, 10)], &ratchet).is_empty());
    assert_eq!(violations(&[long(FUNCTION_LINES + 1, 10)], &ratchet).len(), 1);
    assert_eq!(violations(&[long(FILE_LINES + 1, 10)], &ratchet).len(), 2);
    assert_eq!(violations(&[long(3, LINE_COLUMNS)], &ratchet).len(), 1);
}

#[test]
fn what_is_too_heavy_is_seen() {
    let file = |path: &str, bytes| (path.to_string(), bytes);
    assert_eq!(oversized_files(&[file("x.whl", FILE_BYTES + 1)]).len(), 1);
    assert!(oversized_files(&[file("x.csv", FILE_BYTES), file("x.mcap", u64::MAX)]).is_empty());
}

#[test]
fn an_exception_may_only_shrink() {
    let ratchet = |size| Ratchet::parse(&format!("[functions]\n\"hal/src/x.rs::f\" = {size}\n"));
    let file = [long(80, 10)];
    assert!(violations(&file, &ratchet(80)).is_empty());
    assert!(violations(&file, &ratchet(79))[0].contains("grew"));
    assert!(violations(&file, &ratchet(81))[0].contains("lower its entry"));
    assert!(violations(&[long(20, 10)], &ratchet(80))[0].contains("remove its entry"));
}

#[test]
fn functions_are_measured_with_their_signature() {
    let raw =
        "trait T {\n    fn none(&self);\n    fn two(\n        x: [u8; 3],\n    ) {\n    }\n}\n";
    let names = functions(&Rust::new("a.rs", raw));
    assert_eq!(names, [("two".to_string(), 4)]);
}
