//! The page of requirements: every test that it names exists, and every fault stands in a row.

use std::collections::BTreeSet;
use std::path::Path;

/// What a cell names in backticks.
fn names(line: &str) -> impl Iterator<Item = &str> {
    line.split('`').skip(1).step_by(2)
}

/// Complaints about a page of requirements. `read` gives the text of a file below the root, and
/// `faults` are the names of the fault codes.
pub(crate) fn complaints(
    page: &str,
    faults: &BTreeSet<String>,
    read: impl Fn(&Path) -> Option<String>,
) -> Vec<String> {
    let mut found = Vec::new();
    let mut left: BTreeSet<&str> = faults.iter().map(String::as_str).collect();
    for (at, line) in page.lines().enumerate().filter(|(_, line)| line.starts_with("| ")) {
        let mut complain = |what: String| {
            found.push(format!("docs/requirements.md:{}: {what}", at + 1));
        };
        let mut shown = 0;
        for name in names(line) {
            let Some((path, test)) = name.split_once("::") else {
                if name.contains('/') {
                    shown += 1;
                    if read(Path::new(name)).is_none() {
                        complain(format!("there is no file {name}"));
                    }
                } else if !left.remove(name) && !faults.contains(name) {
                    complain(format!("{name} is neither a fault nor a file"));
                }
                continue;
            };
            shown += 1;
            let is_there = read(Path::new(path)).is_some_and(|text| {
                let definition = format!("fn {test}(");
                text.split("#[test]").skip(1).any(|behind| {
                    behind.find("fn ").is_some_and(|at| behind[at..].starts_with(&definition))
                })
            });
            if !is_there {
                complain(format!("there is no test {name}"));
            }
        }
        let is_head = line.starts_with("| promise") || line.starts_with("| fault |");
        if shown == 0 && !is_head {
            complain("names no test".to_owned());
        }
    }
    found.extend(left.iter().map(|fault| format!("no row has the fault {fault}")));
    found
}

/// The names of the fault codes in the source that declares them.
pub(crate) fn fault_names(source: &str) -> BTreeSet<String> {
    let declared = source.lines().filter_map(|line| {
        let (name, rest) = line.trim().split_once(" = ")?;
        let code = rest.split(',').next()?;
        let is_name = name.chars().all(char::is_alphanumeric);
        (is_name && code.parse::<u16>().is_ok() && rest.ends_with(';')).then(|| name.to_owned())
    });
    declared.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(page: &str) -> Vec<String> {
        let faults = ["JointLost", "LaneLost"].map(str::to_owned).into();
        let read = |path: &Path| match path.to_str()? {
            "a/b.rs" => Some("#[test]\nfn it_holds() {}\nfn helper() {}\n".to_owned()),
            "tests/run" => Some(String::new()),
            _ => None,
        };
        complaints(page, &faults, read)
    }

    #[test]
    fn a_page_whose_tests_exist_is_silent() {
        let page = "| fault | codes |\n|---|---|\n| gone | `JointLost`, `LaneLost` | \
                    `a/b.rs::it_holds`, `tests/run` |\n";
        assert_eq!(found(page), Vec::<String>::new());
    }

    #[test]
    fn a_missing_test_file_fault_or_row_is_seen() {
        let page = "| one | `JointLost` | `a/b.rs::helper` |\n| two | `a/c.rs::it_holds` |\n\
                    | three | `tests/ran` |\n| four | `Joint` | none |\n";
        let complaints = found(page);
        for what in [
            "there is no test a/b.rs::helper",
            "there is no test a/c.rs::it_holds",
            "there is no file tests/ran",
            "Joint is neither a fault nor a file",
            "names no test",
            "no row has the fault LaneLost",
        ] {
            assert!(complaints.iter().any(|found| found.ends_with(what)), "{what}: {complaints:?}");
        }
    }

    #[test]
    fn faults_are_read_from_their_declaration() {
        let source =
            "    /// Text.\n    EncoderJump = 1, DriveOff, \"an encoder\";\n    let x = 3;\n";
        assert_eq!(fault_names(source), ["EncoderJump".to_owned()].into());
    }
}
