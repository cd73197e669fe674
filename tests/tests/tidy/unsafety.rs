//! Where `unsafe` may stand, and that each use is argued. A listed file without `unsafe` is a
//! complaint too: it leaves the list.

use crate::calls::find_word;
use crate::source::Rust;

/// The files that may hold `unsafe`, and what for.
pub(crate) const LISTED: &[(&str, &str)] = &[
    ("rtcore/src/guard.rs", "a global allocator that counts is an unsafe trait"),
    ("rtcore/tests/lane_start.rs", "a global allocator that counts is an unsafe trait"),
    ("rtcore/src/linux.rs", "no crate that we have reads a deadline reservation back"),
    ("rtcore/src/linux/runaway.rs", "a signal's handler"),
    ("rtcore/src/mapping.rs", "a flight recorder's file is mapped memory"),
    ("contact/src/numeric/wide.rs", "wider registers are used where the processor has them"),
    ("drivers/comedi/src/device.rs", "calls of the kernel take addresses of lists"),
    ("drivers/regmap/src/io.rs", "a mapped register file is volatile memory"),
    ("drivers/serial/src/port.rs", "no crate that we have sets a tty to low latency"),
    ("drivers/serial/tests/allocations.rs", "a global allocator that counts is an unsafe trait"),
    ("drivers/can/emulator/src/interface.rs", "no crate that we have opens a raw CAN socket"),
    ("drivers/can/src/socket.rs", "no crate that we have opens a raw CAN socket"),
    ("drivers/ethercat/src/port.rs", "no crate that we have makes an address of a raw socket"),
    ("drivers/ethercat/emulator/src/serve.rs", "no crate that we have binds a raw socket"),
    ("drivers/exchange/src/share.rs", "halves share an exchange, one at a time, without waiting"),
    ("machine/operator/src/access.rs", "no crate that we have tells a peer's groups"),
    ("tests/sanitizers/src/race.rs", "a race on purpose, which the sanitizer has to find"),
];

/// Lines above a use in which its argument may stand.
const ARGUMENT_DISTANCE_LINES: usize = 12;

/// Complaints about the tree.
pub(crate) fn violations(files: &[Rust]) -> Vec<String> {
    let mut found: Vec<String> = files.iter().flat_map(in_file).collect();
    for (path, _) in LISTED {
        let used = files.iter().any(|file| {
            file.path == *path && file.lines.iter().any(|line| find_word(&line.code, "unsafe"))
        });
        if !used {
            found.push(format!("{path}: listed for unsafe and holds none; take it off the list"));
        }
    }
    found
}

/// Complaints about one file.
pub(crate) fn in_file(file: &Rust) -> Vec<String> {
    let listed = LISTED.iter().any(|(path, _)| *path == file.path);
    let mut found = Vec::new();
    for (number, line) in file.lines.iter().enumerate() {
        let place = format!("{}:{}", file.path, number + 1);
        let allowed = ["allow(unsafe_code", "expect(unsafe_code"];
        if !listed && allowed.iter().any(|word| line.code.contains(word)) {
            found.push(format!("{place}: switches the lint off; the file is not on the list"));
        }
        if !find_word(&line.code, "unsafe") {
            continue;
        }
        // An `unsafe fn` is a promise asked of callers; its body argues block by block.
        let asked = find_word(&line.code, "unsafe fn");
        if !listed {
            found.push(format!("{place}: unsafe outside the listed files"));
        } else if !asked && !has_argument(file, number) {
            found.push(format!("{place}: unsafe without a `SAFETY:` comment above it"));
        }
    }
    found
}

/// An argument stands on the line, or above it within the same statement and its comments.
fn has_argument(file: &Rust, number: usize) -> bool {
    let says = |line: usize| {
        let comment = &file.lines[line].comment;
        comment.contains("SAFETY:")
    };
    if says(number) {
        return true;
    }
    for above in (number.saturating_sub(ARGUMENT_DISTANCE_LINES)..number).rev() {
        if says(above) {
            return true;
        }
        let code = file.lines[above].code.trim();
        let ends = code.ends_with(';') || code.ends_with('}') || code.ends_with('{');
        if ends || (code.is_empty() && file.lines[above].comment.is_empty()) {
            return false;
        }
    }
    false
}

#[cfg(test)]
fn complaints(path: &str, text: &str) -> usize {
    in_file(&Rust::new(path, text)).len()
}

#[test]
fn unsafe_in_an_unlisted_file_is_seen() {
    assert_eq!(complaints("hal/src/x.rs", "fn f() { unsafe { g() } }"), 1);
    assert_eq!(complaints("hal/src/x.rs", "#![allow(unsafe_code)]"), 1);
    assert_eq!(complaints("hal/src/x.rs", "// unsafe\nlet s = \"unsafe\"; // unsafe"), 0);
}

#[test]
fn unsafe_without_an_argument_is_seen() {
    let path = LISTED[0].0;
    assert_eq!(complaints(path, "fn f() {\n    unsafe { g() }\n}"), 1);
    assert_eq!(complaints(path, "// SAFETY: for f\nfn f() {\n    unsafe { g() }\n}"), 1);
    assert_eq!(complaints(path, "unsafe impl Send for X {}"), 1);
    assert_eq!(complaints(path, "unsafe fn f() {\n    unsafe { g() }\n}"), 1);
    assert_eq!(complaints(path, "fn f() {\n    // SAFETY: g is sound\n    unsafe { g() }\n}"), 0);
    assert_eq!(
        complaints(path, "// SAFETY: both\n// kinds\nlet x =\n    unsafe { g() };"),
        0,
        "a statement may span lines"
    );
}

#[test]
fn a_listed_file_without_unsafe_is_seen() {
    assert_eq!(violations(&[]).len(), LISTED.len());
}
