//! Counts complaints for each rule and room, and compares the counts with `ratchet.toml`: a count
//! may neither grow nor shrink without its entry, and an entry may only shrink.

use std::collections::BTreeMap;

/// One complaint of a rule that has exceptions.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Complaint {
    /// The room that the exception is counted for.
    pub(crate) room: String,
    /// Place, finding, remedy.
    pub(crate) text: String,
}

impl Complaint {
    /// A complaint about a line of a file; its room is the folder `src`, `tests` ... of the crate.
    pub(crate) fn new(path: &str, line: usize, text: &str) -> Complaint {
        Complaint { room: room_of(path), text: format!("{path}:{line}: {text}") }
    }

    /// A complaint about a whole room.
    pub(crate) fn of_room(room: &str, text: &str) -> Complaint {
        Complaint { room: room.to_string(), text: format!("{room}: {text}") }
    }
}

/// Folders that end the name of a room.
pub(crate) const ROOM_FOLDERS: &[&str] = &["src", "tests", "examples", "benches", "fuzz_targets"];

/// The room of a file: its path up to the first such folder below the top.
fn room_of(path: &str) -> String {
    let folders: Vec<&str> =
        path.rsplit_once('/').map_or(Vec::new(), |(folders, _)| folders.split('/').collect());
    let below = folders.iter().skip(1).position(|name| ROOM_FOLDERS.contains(name));
    folders[..below.map_or(folders.len(), |at| at + 2)].join("/")
}

/// Room -> number of complaints of one rule.
type Counts = BTreeMap<String, usize>;

/// A rule's name and all that it found.
pub(crate) type Findings = Vec<(&'static str, Vec<Complaint>)>;

/// Parts of the file that `sizes` reads.
const SIZES: &[&str] = &["files", "functions", "columns"];

/// Written above the numbers.
const HEADER: &str = "\
# Exceptions to the rules of the tidy suite: for each rule and room the number of complaints of
# today. A number may only shrink. `cargo test -p taktil-tests --test tidy ratchet` fails when a
# number is not today's, and prints the whole file as it should be.
";

/// Written below them, when they are printed.
const END: &str = "\n# The end of ratchet.toml.";

/// Complaints: a count beyond its entry, or an entry beyond its count. The last one is the whole
/// text of the file with today's counts.
pub(crate) fn violations(ratchet: &str, findings: &Findings) -> Vec<String> {
    let mut table: toml::Table = ratchet.parse().unwrap_or_else(|error| panic!("ratchet: {error}"));
    let mut found = Vec::new();
    for (rule, complaints) in findings {
        let entries = table.get(*rule).and_then(toml::Value::as_table).cloned().unwrap_or_default();
        let allowed = |room: &str| {
            let number = entries.get(room).and_then(toml::Value::as_integer).unwrap_or(0);
            usize::try_from(number).expect("a count is not negative")
        };
        let mut counts = Counts::new();
        entries.keys().for_each(|room| {
            counts.insert(room.clone(), 0);
        });
        for complaint in complaints {
            *counts.entry(complaint.room.clone()).or_default() += 1;
        }
        for (room, count) in &counts {
            let limit = allowed(room);
            if *count > limit {
                let here = complaints.iter().filter(|complaint| complaint.room == *room);
                found.extend(here.map(|complaint| format!("[{rule}] {}", complaint.text)));
                found.push(format!("[{rule}] \"{room}\" grew from {limit} to {count}"));
            } else if *count < limit {
                found.push(format!(
                    "[{rule}] \"{room}\" shrank from {limit} to {count}: lower the number"
                ));
            }
        }
        counts.retain(|_, count| *count > 0);
        if counts.is_empty() {
            table.remove(*rule);
        } else {
            let number = |count: usize| i64::try_from(count).expect("a count is small");
            let counts = counts.into_iter().map(|(room, count)| (room, number(count).into()));
            table.insert((*rule).to_string(), toml::Value::Table(counts.collect()));
        }
    }
    for part in table.clone().keys() {
        let rule = findings.iter().any(|(rule, _)| rule == part);
        if !rule && !SIZES.contains(&part.as_str()) {
            found.push(format!("[{part}] is no rule: remove its entries"));
            table.remove(part);
        }
    }
    if !found.is_empty() {
        let text = toml::to_string(&table).expect("a table of numbers is TOML");
        found.push(format!("\nratchet.toml with today's numbers:\n\n{HEADER}\n{text}{END}"));
    }
    found
}

#[cfg(test)]
fn findings(count: usize) -> Findings {
    vec![("rule", vec![Complaint::new("hal/src/a.rs", 7, "bad"); count])]
}

#[test]
fn a_count_that_grows_or_shrinks_is_seen() {
    let ratchet = "[rule]\n\"hal/src\" = 2\n";
    assert!(violations(ratchet, &findings(2)).is_empty());
    let grown = violations(ratchet, &findings(3));
    assert_eq!(grown[0], "[rule] hal/src/a.rs:7: bad");
    assert_eq!(grown[3], "[rule] \"hal/src\" grew from 2 to 3");
    let shrunk = violations(ratchet, &findings(1));
    assert!(shrunk[0].ends_with("lower the number"), "{shrunk:?}");
    assert_eq!(violations("", &findings(1)).len(), 3);
    let unknown = violations("[gone]\n\"hal/src\" = 1\n", &findings(0));
    assert!(unknown[0].contains("[gone] is no rule"), "{unknown:?}");
}

#[test]
fn the_whole_new_text_is_printed_and_holds() {
    let old = "[files]\n\"hal/src/a.rs\" = 600\n\n[rule]\n\"hal/src\" = 1\n\"gone/src\" = 4\n";
    for count in [0, 5] {
        let found = violations(old, &findings(count));
        let (_, text) = found.last().and_then(|text| text.split_once("\n\n")).expect("a text");
        assert!(text.contains("\"hal/src/a.rs\" = 600"), "{text}");
        assert!(violations(text, &findings(count)).is_empty(), "{text}");
    }
}

#[test]
fn a_room_is_a_folder_of_a_crate() {
    for (path, room) in [
        ("contact/src/space/pin/row.rs", "contact/src"),
        ("tasks/jog/src/lib.rs", "tasks/jog/src"),
        ("tests/tests/tidy/main.rs", "tests/tests"),
        ("tests/script/src/lib.rs", "tests/script/src"),
        ("tests/loom/build.rs", "tests/loom"),
    ] {
        assert_eq!(room_of(path), room);
    }
}
