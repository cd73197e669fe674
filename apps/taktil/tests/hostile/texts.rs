//! Hostile texts, made of good ones: what is wrong with any text, what is wrong with a text of
//! TOML, and numbers that are none where a number stands.

use crate::content::{Content, Verdict};
use crate::draws::Draws;

/// Bytes of a line that nobody reads to its end.
const LONG_LINE_BYTES: usize = 1 << 20;
/// Bytes that a configuration does not have.
const HUGE_BYTES: usize = 5 << 20;
/// How deep something is nested.
const ITEMS_NESTED: usize = 20_000;

/// What may stand where a file is meant, whatever is to be in it.
pub(crate) fn no_files() -> Vec<(&'static str, Content)> {
    let bytes = |bytes: &[u8]| Content::Bytes(bytes.to_vec());
    vec![
        ("missing", Content::Nothing),
        ("folder", Content::Folder),
        ("pipe", Content::Pipe),
        ("link to nothing", Content::Link("nowhere")),
        ("link to itself", Content::Link("hostile")),
        ("link to a device", Content::Link("/dev/zero")),
        ("link to a kernel file", Content::Link("/proc/self/mem")),
        ("empty", bytes(b"")),
        ("blank", bytes(b" \n\t\n")),
        ("zeros", Content::Bytes(vec![0; 10_000])),
        ("no UTF-8", bytes(b"title = \"\xff\xfe\"\n")),
        ("UTF-16", bytes(b"\xff\xfet\0i\0t\0l\0e\0\n\0")),
        ("only a byte order mark", bytes("\u{feff}".as_bytes())),
        ("only an end of line", bytes(b"\r\n")),
        ("huge", Content::Bytes(b"a = 1 # x\n".repeat(HUGE_BYTES / 10))),
        ("one long line", Content::Bytes(vec![b'['; LONG_LINE_BYTES])),
        ("noise", Content::Bytes(noise(4096))),
        ("escape sequences", bytes(b"\x1b]0;owned\x07\x1b[2J\x9b31m")),
    ]
}

fn noise(bytes: usize) -> Vec<u8> {
    let mut draws = Draws::new(1);
    (0..bytes).map(|_| u8::try_from(draws.below(256)).unwrap()).collect()
}

/// What is wrong with a TOML text of this content, and whether it has to be refused.
pub(crate) fn toml_kinds(text: &str) -> Vec<(String, Vec<u8>, Verdict)> {
    use Verdict::{Any, Refused};
    let with = |end: &str| format!("{text}\n{end}\n").into_bytes();
    let before = |start: &str| format!("{start}\n{text}").into_bytes();
    let long = "a".repeat(LONG_LINE_BYTES);
    let mut all = vec![
        ("byte order mark", format!("\u{feff}{text}").into_bytes(), Any),
        ("ends of lines of another system", text.replace('\n', "\r\n").into_bytes(), Any),
        ("NUL in a comment", with("# \0"), Refused),
        ("NUL in a string", with("[hostile]\na = \"\0\""), Refused),
        ("escape sequence as a key", with("[hostile]\n\"\\u001b[2J\" = 1"), Refused),
        ("escape sequence in the text", with("[hostile]\n\x1b[2J = 1"), Refused),
        ("turned writing as a key", with("[hostile]\n\"\\u202e\" = 1"), Refused),
        ("unknown table", with("[hostile]\na = 1"), Refused),
        ("unknown key", before("hostile = 1"), Refused),
        ("the whole twice", with(text), Any),
        ("long comment", with(&format!("# {long}")), Any),
        ("long key", before(&format!("{long} = 1")), Refused),
        ("long table", with(&format!("[{long}]")), Refused),
        ("long string", before(&format!("hostile = \"{long}\"")), Refused),
        ("long number", before(&format!("hostile = {}", "1".repeat(LONG_LINE_BYTES))), Refused),
        ("long line of dots", before(&format!("a{} = 1", ".a".repeat(ITEMS_NESTED))), Refused),
        ("long table of dots", with(&format!("[a{}]", ".a".repeat(ITEMS_NESTED))), Refused),
        ("nested lists", before(&format!("a = {}", "[".repeat(ITEMS_NESTED))), Refused),
        ("closed nested lists", before(&nested("[", "]")), Refused),
        ("nested tables", before(&nested("{a=", "}")), Refused),
        ("many tables", with(&numbered("[[hostile]]\na = N\n")), Refused),
        ("many keys", before(&numbered("hostileN = N\n")), Refused),
        ("keys of dots", before(&numbered("hostile.aN.b = N\n")), Refused),
        ("many mistakes", before(&"= \n".repeat(ITEMS_NESTED)), Refused),
        ("many quotes", before(&"\"".repeat(LONG_LINE_BYTES)), Refused),
        ("many escapes", before(&format!("a = \"{}\"", "\\q".repeat(ITEMS_NESTED))), Refused),
        ("huge list", before(&format!("hostile = [{}]", "1,".repeat(LONG_LINE_BYTES))), Refused),
    ]
    .into_iter()
    .map(|(name, text, verdict)| (name.to_owned(), text, verdict))
    .collect::<Vec<_>>();
    let mut draws = Draws::new(2);
    for number in 0..8 {
        let cut = text.floor_char_boundary(1 + draws.below(text.len() - 1));
        all.push((format!("cut at {cut}"), text.as_bytes()[..cut].to_vec(), Any));
        let mut flipped = text.as_bytes().to_vec();
        for _ in 0..=number {
            let at = draws.below(flipped.len());
            flipped[at] ^= 1 << draws.below(8);
        }
        all.push((format!("{} bits flipped", number + 1), flipped, Any));
    }
    all
}

fn nested(open: &str, close: &str) -> String {
    format!("a = {}1{}", open.repeat(ITEMS_NESTED), close.repeat(ITEMS_NESTED))
}

fn numbered(line: &str) -> String {
    (0..ITEMS_NESTED).map(|number| line.replace('N', &number.to_string())).collect()
}

/// What stands in the place of a number or a list of numbers.
const HOSTILE_VALUES: [&str; 24] = [
    "nan",
    "-nan",
    "inf",
    "-inf",
    "1e308",
    "-1e308",
    "5e-324",
    "-0.0",
    "0",
    "-1",
    "1000000000",
    "1000000000.0",
    "9223372036854775807",
    "-9223372036854775808",
    "18446744073709551616",
    "\"1 mm\"",
    "\"\"",
    "true",
    "[]",
    "{}",
    "[nan, inf, -inf, 1e308, -1e308, 0]",
    "[1, 2, 3, 4, 5, 6, 7, 8, 9]",
    "[[[[[]]]]]",
    "1979-05-27",
];

/// The text with another value behind one of its keys, for each key and `count` drawn values.
pub(crate) fn hostile_values(text: &str, count: usize, seed: u64) -> Vec<(String, String)> {
    let mut draws = Draws::new(seed);
    let mut all = Vec::new();
    let lines: Vec<&str> = text.lines().collect();
    for (at, line) in lines.iter().enumerate() {
        let Some((key, _)) = line.split_once(" = ") else { continue };
        if line.starts_with('#') || line.ends_with('[') {
            continue;
        }
        for _ in 0..count {
            let value = *draws.one_of(&HOSTILE_VALUES);
            let altered = format!("{key} = {value}");
            let mut lines = lines.clone();
            lines[at] = &altered;
            all.push((format!("line {}: {altered}", at + 1), lines.join("\n")));
        }
    }
    all
}

/// The same for one entry that is added, key by key of a schema: `path` leads to it.
pub(crate) fn added_key(path: &[String], value: &str) -> Option<String> {
    let (last, tables) = path.split_last()?;
    if let Some(at) = path.iter().position(|part| part == "[]") {
        let (list, inner) = (path[..at].join("."), &path[at + 1..]);
        let inner: Vec<&str> =
            inner.iter().map(String::as_str).filter(|part| *part != "[]").collect();
        return (!inner.is_empty()).then(|| format!("[[{list}]]\n{} = {value}\n", inner.join(".")));
    }
    match tables.is_empty() {
        true => Some(format!("{last} = {value}\n")),
        false => Some(format!("[{}]\n{last} = {value}\n", tables.join("."))),
    }
}

/// A drawn value.
pub(crate) fn drawn_value(draws: &mut Draws) -> &'static str {
    draws.one_of::<&'static str>(&HOSTILE_VALUES)
}
