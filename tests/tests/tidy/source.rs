//! The repository as text: files found by walking the tree, Rust split into code and comments.
//! Strings, comments, braces and test modules are all that is understood of Rust.

use std::fs;
use std::path::Path;

pub(crate) use taktil_tests::root;

/// One line of Rust, split.
#[derive(Clone, Debug, Default)]
pub(crate) struct Line {
    /// The code; strings, characters and comments are blanks.
    pub(crate) code: String,
    /// The comment, its slashes included.
    pub(crate) comment: String,
    /// Inside a `#[cfg(test)]` item, a `#[test]` function or a file of tests.
    pub(crate) test: bool,
}

/// One Rust file.
#[derive(Clone, Debug)]
pub(crate) struct Rust {
    /// Path from the root, with forward slashes.
    pub(crate) path: String,
    /// As it stands.
    pub(crate) raw: String,
    /// Split, one entry a line.
    pub(crate) lines: Vec<Line>,
}

/// One file of any kind of text.
#[derive(Clone, Debug)]
pub(crate) struct Text {
    /// Path from the root, with forward slashes.
    pub(crate) path: String,
    /// As it stands.
    pub(crate) raw: String,
}

/// Everything that the rules look at.
pub(crate) struct Tree {
    /// Rust files.
    pub(crate) rust: Vec<Rust>,
    /// All text files, Rust included.
    pub(crate) text: Vec<Text>,
    /// Paths and bytes of all files, text or not.
    pub(crate) sizes: Vec<(String, u64)>,
}

/// A file of the repository, by its path from the root.
pub(crate) fn read(path: &str) -> String {
    fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// Folders that are nobody's source: build output, caches, version control.
fn is_skipped(name: &str) -> bool {
    name == ".git"
        || name == "target"
        || name.starts_with("target-")
        || name == "out"
        || name == "__pycache__"
        || name == "node_modules"
}

fn walk(folder: &Path, prefix: &str, found: &mut Tree) {
    let mut entries: Vec<_> = fs::read_dir(folder)
        .unwrap_or_else(|error| panic!("{}: {error}", folder.display()))
        .filter_map(Result::ok)
        .collect();
    entries.sort_by_key(fs::DirEntry::file_name);
    for entry in entries {
        let name = entry.file_name().to_string_lossy().into_owned();
        let path = format!("{prefix}{name}");
        let kind = entry.file_type().expect("a file has a type");
        if kind.is_dir() {
            // Cargo marks its output folders, whatever they are called.
            if !is_skipped(&name) && !entry.path().join("CACHEDIR.TAG").exists() {
                walk(&entry.path(), &format!("{path}/"), found);
            }
        } else if kind.is_file() && name != ".git" {
            // In a linked work tree `.git` is a file with a path of the machine.
            let bytes = entry.metadata().expect("a file has a size").len();
            found.sizes.push((path.clone(), bytes));
            if let Ok(raw) = fs::read_to_string(entry.path()) {
                found.text.push(Text { path, raw });
            }
        }
    }
}

impl Tree {
    /// Reads the whole repository; files that are not UTF-8 are not text.
    pub(crate) fn read() -> Tree {
        let mut tree = Tree { rust: Vec::new(), text: Vec::new(), sizes: Vec::new() };
        walk(&root(), "", &mut tree);
        let rust = tree.text.iter().filter(|file| file.path.ends_with(".rs"));
        tree.rust = rust.map(|file| Rust::new(&file.path, &file.raw)).collect();
        tree
    }
}

impl Rust {
    /// Splits a file.
    pub(crate) fn new(path: &str, raw: &str) -> Rust {
        let mut lines = split(raw);
        if is_test_file(path) {
            lines.iter_mut().for_each(|line| line.test = true);
        } else {
            mark_tests(&mut lines);
        }
        Rust { path: path.to_string(), raw: raw.to_string(), lines }
    }
}

/// Files that hold nothing but tests, benchmarks or examples.
fn is_test_file(path: &str) -> bool {
    path.split('/').any(|part| matches!(part, "tests" | "benches" | "examples" | "tests.rs"))
}

/// What the splitter is inside of.
#[derive(Clone, Copy, PartialEq)]
enum Inside {
    Code,
    LineComment,
    BlockComment(usize),
    Text { hashes: Option<usize> },
}

/// Splits Rust into code and comments.
pub(crate) fn split(raw: &str) -> Vec<Line> {
    let chars: Vec<char> = raw.chars().collect();
    let mut lines = vec![Line::default()];
    let mut inside = Inside::Code;
    let mut at = 0;
    while at < chars.len() {
        let c = chars[at];
        if c == '\n' {
            if inside == Inside::LineComment {
                inside = Inside::Code;
            }
            lines.push(Line::default());
            at += 1;
            continue;
        }
        let line = lines.last_mut().expect("there is always a line");
        let (next, used) = match inside {
            Inside::Code => code_step(&chars, at, line),
            Inside::LineComment => {
                line.comment.push(c);
                (inside, 1)
            }
            Inside::BlockComment(depth) => block_step(&chars, at, depth, line),
            Inside::Text { hashes } => text_step(&chars, at, hashes, line),
        };
        inside = next;
        at += used;
    }
    lines
}

/// One step outside strings and comments: what comes next, and how many characters were used.
fn code_step(chars: &[char], at: usize, line: &mut Line) -> (Inside, usize) {
    let c = chars[at];
    let peek = |n: usize| chars.get(at + n).copied().unwrap_or('\0');
    if c == '/' && peek(1) == '/' {
        line.comment.push('/');
        return (Inside::LineComment, 1);
    }
    if c == '/' && peek(1) == '*' {
        line.comment.push_str("/*");
        return (Inside::BlockComment(1), 2);
    }
    if c == '"' {
        line.code.push('"');
        return (Inside::Text { hashes: None }, 1);
    }
    let after_name = at > 0 && is_word(chars[at - 1]) && !matches!(chars[at - 1], 'b' | 'c');
    if c == 'r' && !after_name {
        let hashes = chars[at + 1..].iter().take_while(|c| **c == '#').count();
        if peek(1 + hashes) == '"' {
            line.code.push('"');
            return (Inside::Text { hashes: Some(hashes) }, 2 + hashes);
        }
    }
    if c == '\'' {
        let length = character_length(chars, at);
        line.code.push('\'');
        return (Inside::Code, length);
    }
    line.code.push(c);
    (Inside::Code, 1)
}

/// Characters of a character literal, or 1 for the quote of a lifetime.
fn character_length(chars: &[char], at: usize) -> usize {
    let peek = |n: usize| chars.get(at + n).copied().unwrap_or('\0');
    if peek(1) == '\\' {
        // The escaped character itself may be a quote.
        return chars[at + 3..].iter().position(|c| *c == '\'').map_or(1, |n| n + 4);
    }
    if peek(2) == '\'' { 3 } else { 1 }
}

fn block_step(chars: &[char], at: usize, depth: usize, line: &mut Line) -> (Inside, usize) {
    let peek = chars.get(at + 1).copied().unwrap_or('\0');
    line.comment.push(chars[at]);
    match (chars[at], peek) {
        ('*', '/') if depth == 1 => (Inside::Code, 2),
        ('*', '/') => (Inside::BlockComment(depth - 1), 2),
        ('/', '*') => (Inside::BlockComment(depth + 1), 2),
        _ => (Inside::BlockComment(depth), 1),
    }
}

fn text_step(chars: &[char], at: usize, hashes: Option<usize>, line: &mut Line) -> (Inside, usize) {
    match (chars[at], hashes) {
        ('\\', None) if chars.get(at + 1) != Some(&'\n') => {
            line.code.push_str("  ");
            return (Inside::Text { hashes }, 2);
        }
        ('"', None) => {
            line.code.push('"');
            return (Inside::Code, 1);
        }
        ('"', Some(n)) if chars[at + 1..].iter().take_while(|c| **c == '#').count() >= n => {
            line.code.push('"');
            return (Inside::Code, 1 + n);
        }
        _ => line.code.push(' '),
    }
    (Inside::Text { hashes }, 1)
}

/// A character of a name.
pub(crate) fn is_word(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// The first and last line of the braces that open at or after `(line, column)`; `None` when a
/// semicolon ends the item first.
pub(crate) fn body(lines: &[Line], line: usize, column: usize) -> Option<(usize, usize)> {
    let mut braces = 0usize;
    let mut others = 0usize;
    let mut first = None;
    for (number, text) in lines.iter().enumerate().skip(line) {
        let skip = if number == line { column } else { 0 };
        for c in text.code.chars().skip(skip) {
            match c {
                '{' => {
                    first.get_or_insert(number);
                    braces += 1;
                }
                '}' => {
                    braces = braces.checked_sub(1)?;
                    if braces == 0 {
                        return first.map(|first| (first, number));
                    }
                }
                '(' | '[' => others += 1,
                ')' | ']' => others = others.saturating_sub(1),
                ';' if braces == 0 && others == 0 => return None,
                _ => {}
            }
        }
    }
    None
}

fn mark_tests(lines: &mut [Line]) {
    let opens = ["#[cfg(test)]", "#[cfg(all(test", "#[test]"];
    for start in 0..lines.len() {
        let code = lines[start].code.trim_start();
        let Some(opener) = opens.iter().find(|opener| code.starts_with(**opener)) else { continue };
        let column = lines[start].code.find(opener).unwrap_or(0) + opener.len();
        if let Some((_, end)) = body(lines, start, column) {
            lines[start..=end].iter_mut().for_each(|line| line.test = true);
        }
    }
}

#[test]
fn strings_and_comments_are_not_code() {
    let raw =
        "let a = \"un//safe {\"; // sa\\fe \"x\nlet b = r#\"a \" b\"#; /* one /* two */ x\n*/ c";
    let lines = split(raw);
    assert_eq!(lines[0].code.trim_end(), "let a = \"          \";");
    assert_eq!(lines[0].comment, "// sa\\fe \"x");
    assert_eq!(lines[1].code.trim_end(), "let b = \"     \";");
    assert_eq!(lines[2].code, " c");
}

#[test]
fn lifetimes_are_not_characters() {
    let lines = split("fn f<'a>(x: &'a str) { y('{', '\\'', '\\u{7d}', b'}'); }");
    assert_eq!(lines[0].code.matches('{').count(), 1);
    assert_eq!(lines[0].code.matches('}').count(), 1);
    assert!(lines[0].code.contains("&'a str"));
}

#[test]
fn test_modules_are_marked() {
    let raw = "fn a() {}\n#[cfg(test)]\nmod tests {\n    fn b() {}\n}\nfn c() {}\n";
    let file = Rust::new("hal/src/x.rs", raw);
    let marked: Vec<bool> = file.lines.iter().map(|line| line.test).collect();
    assert_eq!(marked, [false, true, true, true, true, false, false]);
    assert!(Rust::new("hal/tests/x.rs", raw).lines.iter().all(|line| line.test));
}
