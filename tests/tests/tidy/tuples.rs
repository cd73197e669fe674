//! Finds parameters that are tuples with two members of one type: a caller can exchange the members
//! and no compiler sees it.

use crate::ratchet::Complaint;
use crate::source::Rust;
use crate::tokens::{Token, is_name, tokens};

/// Complaints about functions and closures with such a parameter.
pub(crate) fn alike_members(files: &[Rust]) -> Vec<Complaint> {
    let mut found = Vec::new();
    for file in files {
        let tokens = tokens(file, true);
        for (at, token) in tokens.iter().enumerate() {
            let parameters = match token.text.as_str() {
                "fn" => function_parameters(&tokens, at),
                "|" => closure_parameters(&tokens, at),
                _ => None,
            };
            for parameter in parameters.into_iter().flat_map(|inside| split_at_commas(inside)) {
                if let Some(member) = repeated_member(parameter) {
                    let text = format!("a tuple parameter has two members `{member}`; name them");
                    found.push(Complaint::new(&file.path, token.line, &text));
                }
            }
        }
    }
    found
}

/// The tokens between the parentheses of the function whose `fn` stands at `at`.
fn function_parameters(tokens: &[Token], at: usize) -> Option<&[Token]> {
    let mut open = at + 2;
    tokens.get(at + 1).filter(|name| is_name(&name.text))?;
    if tokens.get(open)?.text == "<" {
        let generics = tokens[open..].iter().scan(0i32, |depth, token| {
            *depth += nesting(&token.text);
            Some(*depth)
        });
        open += generics.take_while(|depth| *depth > 0).count() + 1;
    }
    tokens.get(open).filter(|token| token.text == "(")?;
    let mut depth = 0;
    for (end, token) in tokens.iter().enumerate().skip(open) {
        depth += nesting(&token.text);
        if depth == 0 {
            return Some(&tokens[open + 1..end]);
        }
    }
    None
}

/// The tokens between the bars of the closure whose first bar stands at `at`.
fn closure_parameters(tokens: &[Token], at: usize) -> Option<&[Token]> {
    let before = &tokens.get(at.checked_sub(1)?)?.text;
    if !["(", ",", "=", "{", ";", "=>", "move", "return"].contains(&before.as_str()) {
        return None;
    }
    let length = tokens[at + 1..].iter().position(|token| token.text == "|")?;
    Some(&tokens[at + 1..at + 1 + length])
}

/// How much deeper the text behind this token is nested.
fn nesting(text: &str) -> i32 {
    match text {
        "(" | "[" | "{" | "<" => 1,
        ")" | "]" | "}" | ">" => -1,
        _ => 0,
    }
}

/// The parts between the commas that no bracket holds.
fn split_at_commas(tokens: &[Token]) -> Vec<&[Token]> {
    let mut depth = 0;
    let parts = tokens.split(|token| {
        depth += nesting(&token.text);
        depth == 0 && token.text == ","
    });
    parts.filter(|part| !part.is_empty()).collect()
}

/// The first type that stands twice in a parameter which is a tuple.
fn repeated_member(parameter: &[Token]) -> Option<String> {
    let mut depth = 0;
    let colon = parameter.iter().position(|token| {
        depth += nesting(&token.text);
        depth == 0 && token.text == ":"
    })?;
    let mut kind = &parameter[colon + 1..];
    // References, lifetimes and `mut` in front of the type change nothing.
    while let [first, rest @ ..] = kind {
        match (first.text.as_str(), rest) {
            ("&" | "mut", _) => kind = rest,
            ("'", [_, rest @ ..]) => kind = rest,
            _ => break,
        }
    }
    let [first, members @ .., last] = kind else { return None };
    if first.text != "(" || last.text != ")" {
        return None;
    }
    let text = |member: &[Token]| {
        let words: Vec<&str> = member.iter().map(|token| token.text.as_str()).collect();
        words.join(" ")
    };
    let mut names: Vec<String> = split_at_commas(members).into_iter().map(text).collect();
    names.sort();
    names.windows(2).find(|pair| pair[0] == pair[1]).map(|pair| pair[0].clone())
}

#[cfg(test)]
fn count(raw: &str) -> usize {
    alike_members(&[Rust::new("hal/src/a.rs", raw)]).len()
}

#[test]
fn a_tuple_of_like_members_is_seen() {
    assert_eq!(count("fn f((wanted, guess): (f64, f64)) {}"), 1);
    assert_eq!(count("fn f<T: Into<Vec<u8>>>(\n    x: u8,\n    y: &'a mut (u8, T, u8),\n) {}"), 1);
    assert_eq!(count("fn f(x: (Vec<u8>, Vec<u8>), y: (bool, bool)) -> u8 {}"), 2);
    assert_eq!(count("let f = |(a, b): (f64, f64)| a;"), 1);
    assert_eq!(count("fn f<F: Fn(u8) -> u8>(x: (u8, u8)) {}"), 1);
}

#[test]
fn other_parameters_are_left_alone() {
    assert_eq!(count("fn f(x: (f64, usize), y: [f64; 2], z: f64, w: f64) -> (f64, f64) {}"), 0);
    assert_eq!(count("fn f(x: &[(f64, f64)], y: impl Fn(f64, f64)) {}"), 0);
    assert_eq!(count("let f = |(a, b)| a; let c = a | (b, c): d | e;"), 0);
    assert_eq!(count("// fn f(x: (f64, f64))\nlet s = \"fn f(x: (f64, f64))\";"), 0);
}
