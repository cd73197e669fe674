//! Finds numeric constants whose names say no quantity: a single word such as `STEPS` tells neither
//! what is counted nor in which unit.

use crate::ratchet::Complaint;
use crate::source::Rust;
use crate::tokens::{Token, tokens};

/// Types of numbers; a constant of such a type, or of an array of it, is a quantity.
const NUMERIC_TYPES: &[&str] = &[
    "f32", "f64", "u8", "u16", "u32", "u64", "u128", "usize", "i8", "i16", "i32", "i64", "i128",
    "isize", "Nanos", "Duration",
];

/// Names of associated constants that every reader knows from the standard library.
const KNOWN_NAMES: &[&str] = &["BITS", "MAX", "MIN", "ONE", "SIZE", "ZERO"];

/// Complaints about numeric constants of one word.
pub(crate) fn of_one_word(files: &[Rust]) -> Vec<Complaint> {
    let mut found = Vec::new();
    for file in files {
        let tokens = tokens(file, true);
        for (at, _) in tokens.iter().enumerate().filter(|(_, token)| token.text == "const") {
            let [name, colon, rest @ ..] = &tokens[at + 1..] else { continue };
            // What stands between angle brackets is a parameter of a generic item.
            let before = at.checked_sub(1).map(|before| tokens[before].text.as_str());
            if matches!(before, Some("<" | ",")) || KNOWN_NAMES.contains(&name.text.as_str()) {
                continue;
            }
            let word = name.text.chars().all(|c| c.is_uppercase() || c.is_numeric());
            if word && colon.text == ":" && is_numeric(rest) {
                let text = format!("`{}` is one word; name the quantity and its unit", name.text);
                found.push(Complaint::new(&file.path, name.line, &text));
            }
        }
    }
    found
}

/// Whether the tokens up to the end of a declaration name a numeric type.
fn is_numeric(tokens: &[Token]) -> bool {
    let mut depth = 0;
    let end = tokens.iter().position(|token| {
        match token.text.as_str() {
            "[" | "(" | "<" => depth += 1,
            "]" | ")" | ">" => depth -= 1,
            _ => {}
        }
        depth == 0 && ["=", ";"].contains(&token.text.as_str())
    });
    let kind = &tokens[..end.unwrap_or(0)];
    kind.iter().any(|token| NUMERIC_TYPES.contains(&token.text.as_str()))
}

#[cfg(test)]
fn count(raw: &str) -> usize {
    of_one_word(&[Rust::new("hal/src/a.rs", raw)]).len()
}

#[test]
fn a_numeric_constant_of_one_word_is_seen() {
    assert_eq!(count("const STEPS: usize = 4;"), 1);
    assert_eq!(count("pub(crate) const TIP: [[f64; 2]; 2] = [[0.0; 2]; 2];"), 1);
    assert_eq!(count("trait T {\n    const ORDER: u32;\n}"), 1);
    assert_eq!(count("fn f() {\n    const PERIOD: Nanos = Nanos::ZERO;\n}"), 1);
}

#[test]
fn other_constants_are_left_alone() {
    assert_eq!(count("const NEWTON_STEPS_MAX: usize = 4;\nconst NAME: &str = \"f64\";"), 0);
    assert_eq!(count("fn f<const N: usize>() {}\nstruct S<\n    const N: usize,\n>;"), 0);
    assert_eq!(count("struct S<T, const N: usize = 6>;\nlet one: f64 = 1.0;"), 0);
    assert_eq!(count("trait T {\n    const NAME: &'static str;\n    const SIZE: usize;\n}"), 0);
    assert_eq!(count("const fn f(x: usize) -> usize { x }\nlet p: *const u8 = q;"), 0);
}
