//! Names that were given up and must not come back: `old_names.txt` lists them, one `crate kind
//! name` a line. Only definitions are looked at; a local variable may be called as it likes.

use std::collections::BTreeSet;

use crate::ratchet::ROOM_FOLDERS;
use crate::source::{Rust, Text, body};
use crate::tokens::{definitions, is_name, tokens};

/// What a listed name may not be the name of.
const KINDS: &[&str] = &["type", "fn", "const", "module", "file", "field", "port", "key"];

/// One line of the list.
#[derive(Clone, Debug, PartialEq)]
struct OldName<'a> {
    /// The crate or folder, `*` for everywhere.
    place: &'a str,
    kind: &'a str,
    name: &'a str,
}

/// One name that stands in the tree.
struct Site {
    path: String,
    line: usize,
    kind: &'static str,
    name: String,
}

/// Complaints: a definition of a listed name, a line that is not understood, a crate that is none.
pub(crate) fn violations(list: &str, rust: &[Rust], text: &[Text]) -> Vec<String> {
    let mut found = Vec::new();
    let (names, bad) = parse(list);
    found.extend(bad);
    let listed: BTreeSet<(&str, &str)> = names.iter().map(|name| (name.kind, name.name)).collect();
    let mut sites: Vec<Site> = rust.iter().flat_map(sites_of_rust).collect();
    sites.extend(text.iter().flat_map(sites_of_toml));
    for site in sites.iter().filter(|site| listed.contains(&(site.kind, site.name.as_str()))) {
        let same = |old: &&OldName| old.kind == site.kind && old.name == site.name;
        if names.iter().filter(same).any(|old| is_in(&site.path, old.place)) {
            let place = format!("{}:{}", site.path, site.line);
            found.push(format!("{place}: the {} `{}` is an old name", site.kind, site.name));
        }
    }
    for place in names.iter().map(|name| name.place).collect::<BTreeSet<&str>>() {
        if place != "*" && !text.iter().any(|file| is_in(&file.path, place)) {
            found.push(format!("old_names.txt: `{place}` is no crate and no folder"));
        }
    }
    found
}

/// The lines of the list, and complaints about those that are none.
fn parse(list: &str) -> (Vec<OldName<'_>>, Vec<String>) {
    let mut names = Vec::new();
    let mut bad = Vec::new();
    for (number, line) in list.lines().enumerate() {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[..] {
            [] => {}
            [first, ..] if first.starts_with('#') => {}
            [place, kind, name] if KINDS.contains(&kind) => {
                names.push(OldName { place, kind, name });
            }
            _ => bad.push(format!("old_names.txt:{}: not `crate kind name`", number + 1)),
        }
    }
    (names, bad)
}

/// Whether a file belongs to a crate or a folder, which may leave out the shelf in front:
/// `tactile_servo` and `tasks/tactile_servo` are the same.
fn is_in(path: &str, place: &str) -> bool {
    let place = place.strip_prefix("taktil-").unwrap_or(place);
    let start = format!("{place}/");
    let below_shelf = || path.split_once('/').is_some_and(|(_, below)| below.starts_with(&start));
    // `tests` is the folder at the root, not that of each crate.
    let folder_of_each = ROOM_FOLDERS.contains(&place);
    place == "*" || path.starts_with(&start) || (!folder_of_each && below_shelf())
}

/// The definitions of a Rust file, its own name and its text literals.
fn sites_of_rust(file: &Rust) -> Vec<Site> {
    let site = |line: usize, kind: &'static str, name: &str| Site {
        path: file.path.clone(),
        line,
        kind,
        name: name.to_string(),
    };
    let defined = definitions(&tokens(file, true));
    let mut found: Vec<Site> =
        defined.iter().map(|found| site(found.line, found.kind, &found.name)).collect();
    for part in file.path.split('/') {
        let stem = part.strip_suffix(".rs").unwrap_or(part);
        found.push(site(1, "file", stem));
        found.push(site(1, "module", stem));
    }
    // A table of renamed ports names the old ones.
    let is_table = file.path.ends_with("/renamed.rs");
    for (number, line) in file.raw.lines().enumerate().filter(|_| !is_table) {
        let literals = line.split('"').skip(1).step_by(2);
        found.extend(literals.map(|literal| site(number + 1, "port", literal)));
    }
    for found_struct in defined.iter().filter(|found| found.kind == "type") {
        let start = found_struct.line - 1;
        let code = file.lines[start].code.trim_start();
        let is_struct = code.split_whitespace().any(|word| word == "struct");
        let Some((first, last)) = body(&file.lines, start, 0).filter(|_| is_struct) else {
            continue;
        };
        for (number, line) in file.lines.iter().enumerate().take(last + 1).skip(first) {
            for part in line.code.split([',', '{']) {
                let name = part.split(':').next().unwrap_or("").split_whitespace().last();
                let name = name.filter(|name| part.contains(':') && is_name(name));
                // The key of a file is the field of the structure that it is read into.
                for kind in ["field", "key"] {
                    found.extend(name.map(|name| site(number + 1, kind, name)));
                }
            }
        }
    }
    found
}

/// The keys of a TOML file at any depth, and the texts among its values.
fn sites_of_toml(file: &Text) -> Vec<Site> {
    let mut found = Vec::new();
    if !file.path.ends_with(".toml") {
        return found;
    }
    for (number, line) in file.raw.lines().enumerate() {
        let mut push = |kind, name: &str| {
            let (path, name) = (file.path.clone(), name.trim().trim_matches('"').to_string());
            found.push(Site { path, line: number + 1, kind, name });
        };
        let line = line.split(" #").next().unwrap_or("").trim();
        line.split('"').skip(1).step_by(2).for_each(|literal| push("port", literal));
        if line.starts_with('[') {
            line.trim_matches(['[', ']']).split('.').for_each(|key| push("key", key));
        }
        // `key = value`, also inside an inline table.
        for before in line.split('=').rev().skip(1) {
            let key = before.rsplit(['{', ',']).next().unwrap_or("");
            key.split('.').for_each(|key| push("key", key));
        }
    }
    found
}

#[cfg(test)]
fn count(list: &str, path: &str, raw: &str) -> usize {
    let text = [Text { path: path.to_string(), raw: raw.to_string() }];
    let rust: Vec<Rust> = if path.ends_with(".rs") { vec![Rust::new(path, raw)] } else { vec![] };
    violations(list, &rust, &text).len()
}

#[test]
fn an_old_name_is_seen() {
    let path = "tasks/jog/src/desk.rs";
    let raw = "pub struct Desk {\n    pub hand: u8,\n    leash: u8,\n}\n\
               const TIP: u8 = 1;\nfn told() {}\nmod ear {}\nlet x = \"jog.old\";\n";
    for line in [
        "* type Desk",
        "jog type Desk",
        "tasks/jog type Desk",
        "taktil-jog const TIP",
        "* fn told",
        "* module ear",
        "* module desk",
        "* file desk",
        "* field hand",
        "jog field leash",
        "jog key leash",
        "* port jog.old",
    ] {
        assert_eq!(count(line, path, raw), 1, "{line}");
    }
    let toml = "[arm.wrist]\nreach = 1 # span = 2\nplace = { at = [\"jog.old\"], \"by\" = 2 }\n";
    for line in ["sim key wrist", "* key reach", "* key place", "* key by", "* port jog.old"] {
        assert_eq!(count(line, "sim/a.toml", toml), 1, "{line}");
    }
}

#[test]
fn other_names_are_left_alone() {
    let raw =
        "use a::Desk;\nfn f() { let told = 1; told() }\n// struct Desk\nlet d = Desk { tip: 1 };";
    for line in ["* type Desk", "* fn told", "* field tip", "jog fn f", "# words", "* port Desk"] {
        let known = usize::from(line.starts_with("jog"));
        assert_eq!(count(line, "sim/src/a.rs", raw), known, "{line}");
    }
    assert_eq!(count("tests fn f", "jog/tests/a.rs", "fn f() {}"), 1, "jog is not in tests");
    assert_eq!(count("* port jog.old", "signal/src/renamed.rs", "const A: &str = \"jog.old\";"), 0);
    assert_eq!(count("* key span", "sim/a.toml", "reach = 1 # span = 2\n"), 0);
}

#[test]
fn a_line_that_says_nothing_is_seen() {
    assert_eq!(count("* type\n* verb go\n", "a/b.rs", ""), 2);
}
