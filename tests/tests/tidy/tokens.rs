//! Splits the code of a Rust file into names and punctuation, and lists what the file defines.
//! Strings, characters and comments are gone before: the tokens come from split lines.

use crate::source::{Rust, is_word};

/// A name, a number, or punctuation; `::`, `->` and `=>` are one token each.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Token {
    /// The characters of the token.
    pub(crate) text: String,
    /// The line where it stands, counted from one.
    pub(crate) line: usize,
}

/// One definition of a name.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Definition {
    /// `type`, `fn`, `const` or `module`.
    pub(crate) kind: &'static str,
    /// The name that is defined.
    pub(crate) name: String,
    /// The line where it stands, counted from one.
    pub(crate) line: usize,
}

/// The tokens of a file; lines of tests are left out unless `with_tests` is set.
pub(crate) fn tokens(file: &Rust, with_tests: bool) -> Vec<Token> {
    let mut found = Vec::new();
    for (number, line) in file.lines.iter().enumerate() {
        if with_tests || !line.test {
            push_line(&mut found, &line.code, number + 1);
        }
    }
    found
}

fn push_line(found: &mut Vec<Token>, code: &str, line: usize) {
    let mut rest = code.trim_start();
    while let Some(first) = rest.chars().next() {
        let pair = ["::", "->", "=>"].iter().any(|pair| rest.starts_with(pair));
        let length = if is_word(first) {
            rest.find(|c| !is_word(c)).unwrap_or(rest.len())
        } else if pair {
            2
        } else {
            first.len_utf8()
        };
        found.push(Token { text: rest[..length].to_string(), line });
        rest = rest[length..].trim_start();
    }
}

/// Whether a token can be a name.
pub(crate) fn is_name(text: &str) -> bool {
    text.starts_with(|c: char| c.is_alphabetic() || c == '_')
}

/// The types, functions, constants and modules that the tokens define.
pub(crate) fn definitions(tokens: &[Token]) -> Vec<Definition> {
    let mut found = Vec::new();
    for (at, token) in tokens.iter().enumerate() {
        let kind = match token.text.as_str() {
            "struct" | "enum" | "trait" | "type" | "union" => "type",
            "fn" => "fn",
            "const" | "static" => "const",
            "mod" => "module",
            _ => continue,
        };
        let next = tokens[at + 1..].iter().find(|token| token.text != "mut");
        let Some(next) = next.filter(|next| is_name(&next.text)) else { continue };
        // `const fn`, `const unsafe fn`, `*const T` and const parameters define no constant.
        let upper = next.text.chars().all(|c| c.is_uppercase() || c.is_numeric() || c == '_');
        if kind != "const" || upper {
            found.push(Definition { kind, name: next.text.clone(), line: next.line });
        }
    }
    found
}

#[test]
fn code_is_split_into_names_and_punctuation() {
    let file = Rust::new("a.rs", "fn f() -> a::B {\n  \"x\"\n}");
    let texts: Vec<String> = tokens(&file, true).into_iter().map(|token| token.text).collect();
    assert_eq!(texts, ["fn", "f", "(", ")", "->", "a", "::", "B", "{", "\"", "\"", "}"]);
    let test = Rust::new("hal/tests/a.rs", "fn f() {}");
    assert!(tokens(&test, false).is_empty());
}

#[test]
fn definitions_are_listed_with_their_kind() {
    let raw = "struct A;\nconst fn b() {}\nconst C_D: u8 = 1;\nmod e;\nlet f: *const G = A;";
    let found = definitions(&tokens(&Rust::new("a.rs", raw), true));
    let short: Vec<(&str, &str, usize)> =
        found.iter().map(|found| (found.kind, found.name.as_str(), found.line)).collect();
    let expected =
        [("type", "A", 1), ("fn", "b", 2), ("const", "C_D", 3), ("module", "e", 4)].to_vec();
    // `*const G` looks like a constant of one letter; nobody forbids such a name.
    assert_eq!(short[..4], expected);
}
