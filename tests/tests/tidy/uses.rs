//! Lists the paths that a Rust file uses: its imports, name by name, and the paths in its code.
//! Macros are read as the code that they look like.

use crate::tokens::{Token, is_name};

/// One path that a file uses.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Use {
    /// Its segments.
    pub(crate) path: Vec<String>,
    /// What it is called in the file; `*` for all names of a module.
    pub(crate) name: String,
    /// Whether it stands in a `use`.
    pub(crate) imports: bool,
    /// A public import whose name the rest of the file does not use: a door, not a use.
    pub(crate) forwards: bool,
}

/// All paths of a file.
pub(crate) fn uses(tokens: &[Token]) -> Vec<Use> {
    let mut found: Vec<Use> = Vec::new();
    let mut names = Vec::new();
    let mut at = 0;
    while at < tokens.len() {
        let before = at.checked_sub(1).map_or("", |before| tokens[before].text.as_str());
        let text = tokens[at].text.as_str();
        let next = tokens.get(at + 1).map_or("", |next| next.text.as_str());
        if text == "use" && (is_name(next) || next == "{" || next == "::") {
            let first = found.len();
            at = push_tree(&mut found, tokens, at + 1, &[]);
            let public = before == "pub" || before == ")";
            found[first..].iter_mut().for_each(|import| import.forwards = public);
            continue;
        }
        if is_name(text) && next == "::" && !["::", ".", "$"].contains(&before) {
            let mut path = vec![text.to_string()];
            names.push(text);
            while let [separator, name, ..] = &tokens[at + 1..] {
                if separator.text != "::" || !is_name(&name.text) {
                    break;
                }
                path.push(name.text.clone());
                at += 2;
            }
            let name = path.last().cloned().unwrap_or_default();
            found.push(Use { path, name, imports: false, forwards: false });
        } else if is_name(text) {
            names.push(text);
        }
        at += 1;
    }
    for import in found.iter_mut().filter(|import| import.forwards) {
        import.forwards = !names.contains(&import.name.as_str());
    }
    found
}

/// Adds the imports of the tree that begins at `at`; gives where it ends.
fn push_tree(found: &mut Vec<Use>, tokens: &[Token], at: usize, prefix: &[String]) -> usize {
    let mut path = prefix.to_vec();
    let mut name = None;
    let mut at = at;
    while let Some(token) = tokens.get(at) {
        match token.text.as_str() {
            "{" => {
                at += 1;
                while tokens.get(at).is_some_and(|token| token.text != "}") {
                    at = push_tree(found, tokens, at, &path);
                    at += usize::from(tokens.get(at).is_some_and(|token| token.text == ","));
                }
                return at + 1;
            }
            "*" => name = Some("*".to_string()),
            "as" => {
                name = tokens.get(at + 1).map(|token| token.text.clone());
                at += 1;
            }
            "," | "}" | ";" => break,
            text if is_name(text) => path.push(text.to_string()),
            _ => {}
        }
        at += 1;
    }
    if path.len() > 1 && path.last().is_some_and(|last| last == "self") {
        path.pop();
    }
    let name = name.or_else(|| path.last().cloned()).unwrap_or_default();
    found.push(Use { path, name, imports: true, forwards: false });
    at
}

#[cfg(test)]
fn listed(raw: &str) -> Vec<(String, String)> {
    let file = crate::source::Rust::new("a.rs", raw);
    let found = uses(&crate::tokens::tokens(&file, false));
    found.into_iter().map(|found| (found.path.join("::"), found.name)).collect()
}

#[test]
fn imports_are_listed_name_by_name() {
    let expected = [("a::b", "b"), ("a::c::D", "E"), ("a::c", "*"), ("f", "f")];
    let found = listed("use a::{b::{self}, c::{D as E, *}};\nuse f;");
    let found: Vec<(&str, &str)> = found.iter().map(|(a, b)| (a.as_str(), b.as_str())).collect();
    assert_eq!(found, expected);
}

#[test]
fn paths_of_code_are_listed() {
    let found = listed("fn f() { super::a::g(); x.h::<u8>(); $crate::i(); B::C }");
    let found: Vec<&str> = found.iter().map(|(path, _)| path.as_str()).collect();
    assert_eq!(found, ["super::a::g", "B::C"]);
}

#[test]
fn a_public_import_that_is_not_used_is_a_door() {
    let doors = |raw: &str| {
        let file = crate::source::Rust::new("a.rs", raw);
        let found = uses(&crate::tokens::tokens(&file, false));
        found.into_iter().filter(|found| found.forwards).count()
    };
    assert_eq!(doors("pub use a::B;\npub(crate) use c::D;\nuse e::F;"), 2);
    assert_eq!(doors("pub use a::B;\nstruct S { b: B }"), 0);
}
