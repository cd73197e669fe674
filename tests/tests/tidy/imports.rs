//! Who may import whom: compares the table of ARCHITECTURE.md with what `cargo metadata` says of
//! normal and build dependencies. Every crate has exactly one row, every row has a crate.

use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

use serde_json::Value;

use crate::source::root;

/// A room's name is its folder; a `/*` at the end stands for every crate on a shelf.
#[derive(Clone, Debug, PartialEq)]
struct Row {
    rooms: Vec<String>,
    ours: Vec<String>,
    others: Vec<String>,
}

/// The import table.
#[derive(Clone, Debug, Default)]
pub(crate) struct Table {
    rows: Vec<Row>,
}

/// One crate of the workspace as cargo sees it.
#[derive(Clone, Debug, Default)]
pub(crate) struct Crate {
    /// Folders of our crates that it imports.
    pub(crate) ours: BTreeSet<String>,
    /// Names of crates from elsewhere.
    pub(crate) others: BTreeSet<String>,
    /// Names of our crates imported with a feature that is for tests only.
    pub(crate) for_tests: BTreeSet<String>,
}

/// Features of our crates that only dev-dependencies may ask for.
const TEST_FEATURES: &[&str] = &["conformance"];

impl Table {
    /// Reads the table whose header starts with `| room | may import |`: names stand in backticks.
    pub(crate) fn parse(markdown: &str) -> Table {
        let rows = markdown
            .lines()
            .skip_while(|line| !line.starts_with("| room | may import |"))
            .skip(2)
            .take_while(|line| line.starts_with('|'))
            .map(|line| {
                let mut cells = line.trim_matches('|').split('|').map(names);
                let mut cell = || cells.next().unwrap_or_default();
                Row { rooms: cell(), ours: cell(), others: cell() }
            })
            .collect();
        Table { rows }
    }

    /// The row of a crate: the one that names it, or else the one that names its shelf.
    fn row(&self, room: &str) -> Result<&Row, usize> {
        let exact: Vec<&Row> =
            self.rows.iter().filter(|row| row.rooms.iter().any(|name| name == room)).collect();
        let shelf = || self.rows.iter().filter(|row| covers(&row.rooms, room)).collect();
        let rows: Vec<&Row> = if exact.is_empty() { shelf() } else { exact };
        if rows.len() == 1 { Ok(rows[0]) } else { Err(rows.len()) }
    }
}

/// The names in backticks of a table's cell.
fn names(cell: &str) -> Vec<String> {
    cell.split('`').skip(1).step_by(2).map(str::to_string).collect()
}

/// Whether a list of names and shelves covers a room.
fn covers(list: &[String], room: &str) -> bool {
    list.iter().any(|name| {
        name == "*"
            || name == room
            || name.strip_suffix("/*").is_some_and(|shelf| {
                room.strip_prefix(shelf).is_some_and(|rest| rest.starts_with('/'))
            })
    })
}

/// What `cargo metadata` says of the workspace.
pub(crate) fn metadata() -> Value {
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".to_string());
    let output = Command::new(cargo)
        .args(["metadata", "--no-deps", "--format-version", "1", "--manifest-path"])
        .arg(root().join("Cargo.toml"))
        .output()
        .expect("cargo runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("cargo speaks JSON")
}

/// Every crate of the workspace by its folder.
pub(crate) fn crates() -> BTreeMap<String, Crate> {
    from_metadata(&metadata())
}

fn text<'a>(value: &'a Value, key: &str) -> &'a str {
    value[key].as_str().unwrap_or("")
}

fn list<'a>(value: &'a Value, key: &str) -> &'a [Value] {
    value[key].as_array().map_or(&[], Vec::as_slice)
}

fn from_metadata(metadata: &Value) -> BTreeMap<String, Crate> {
    let base = format!("{}/", text(metadata, "workspace_root"));
    let folder = |path: &str| path.strip_prefix(&base).unwrap_or(path).to_string();
    let mut crates = BTreeMap::new();
    for package in list(metadata, "packages") {
        let mut entry = Crate::default();
        for dependency in list(package, "dependencies") {
            if text(dependency, "kind") == "dev" {
                continue;
            }
            let name = text(dependency, "name").to_string();
            let Some(path) = dependency["path"].as_str() else {
                entry.others.insert(name);
                continue;
            };
            entry.ours.insert(folder(path));
            let asked = list(dependency, "features").iter().filter_map(Value::as_str);
            if asked.clone().any(|feature| TEST_FEATURES.contains(&feature)) {
                entry.for_tests.insert(name);
            }
        }
        let manifest = text(package, "manifest_path").trim_end_matches("/Cargo.toml");
        crates.insert(folder(manifest), entry);
    }
    crates
}

/// Every crate of ours that a crate reaches through normal dependencies.
pub(crate) fn reachable(from: &str, crates: &BTreeMap<String, Crate>) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    let mut open = vec![from.to_string()];
    while let Some(room) = open.pop() {
        for next in crates.get(&room).into_iter().flat_map(|entry| &entry.ours) {
            if found.insert(next.clone()) {
                open.push(next.clone());
            }
        }
    }
    found
}

/// Folders of simulators and instruments, which the shipped service must not contain.
const INSTRUMENTS: &[&str] = &["sim", "lab", "plot"];

/// The reachable crates that stand in such a folder, or are called like one.
pub(crate) fn instruments(reachable: &BTreeSet<String>) -> Vec<&String> {
    let inside = |room: &&String| room.split('/').any(|part| INSTRUMENTS.contains(&part));
    reachable.iter().filter(inside).collect()
}

/// Complaints: a crate without a row, a row without a crate, an import that its row does not allow.
pub(crate) fn violations(table: &Table, crates: &BTreeMap<String, Crate>) -> Vec<String> {
    let mut found = Vec::new();
    if table.rows.is_empty() {
        found.push("ARCHITECTURE.md: no import table".to_string());
    }
    for name in table.rows.iter().flat_map(|row| row.rooms.iter().chain(&row.ours)) {
        let own = core::slice::from_ref(name);
        if name != "*" && !crates.keys().any(|room| covers(own, room)) {
            found.push(format!("the table names `{name}`, which is no crate"));
        }
    }
    for (room, entry) in crates {
        let row = match table.row(room) {
            Ok(row) => row,
            Err(count) => {
                found.push(format!("`{room}` has {count} rows in the table, not one"));
                continue;
            }
        };
        for import in &entry.ours {
            if !covers(&row.ours, import) {
                found.push(format!("`{room}` may not import `{import}`"));
            }
        }
        for import in &entry.others {
            if !covers(&row.others, import) {
                found.push(format!("`{room}` may not import `{import}` from crates.io"));
            }
        }
        for import in &entry.for_tests {
            found.push(format!("`{room}` asks `{import}` for a feature that is for tests only"));
        }
    }
    found
}

#[cfg(test)]
const TABLE: &str = "\
| room | what |\n|---|---|\n| `x` | `y` |\n\n\
| room | may import | from crates.io |\n|---|---|---|\n| `hal` | nothing of ours | `rtrb` |\n\
| `tasks/*` | `hal` | nothing |\n| `tasks/odd` | `hal`, `tasks/*` | `*` |\n\nmore\n";

#[cfg(test)]
fn house(rooms: &[(&str, &[&str], &[&str])]) -> BTreeMap<String, Crate> {
    let set = |names: &[&str]| names.iter().map(ToString::to_string).collect();
    let entry = |ours: &[&str], others: &[&str]| Crate {
        ours: set(ours),
        others: set(others),
        for_tests: BTreeSet::new(),
    };
    rooms.iter().map(|(room, ours, others)| (room.to_string(), entry(ours, others))).collect()
}

#[test]
fn a_house_that_keeps_the_table_is_silent() {
    let good = house(&[
        ("hal", &[], &["rtrb"]),
        ("tasks/even", &["hal"], &[]),
        ("tasks/odd", &["tasks/even"], &["nix"]),
    ]);
    let found = violations(&Table::parse(TABLE), &good);
    assert!(found.is_empty(), "{found:?}");
}

#[test]
fn each_breach_is_seen() {
    let table = Table::parse(TABLE);
    let base: &[(&str, &[&str], &[&str])] = &[("hal", &[], &[]), ("tasks/odd", &[], &[])];
    for (breach, expected) in [
        (("tasks/even", &["tasks/odd"] as &[&str], &[] as &[&str]), "may not import `tasks/odd`"),
        (("tasks/even", &["hal"], &["nix"]), "may not import `nix` from crates.io"),
        (("attic", &[], &[]), "`attic` has 0 rows"),
    ] {
        let found = violations(&table, &house(&[base, &[breach]].concat()));
        assert_eq!(found.len(), 1, "{found:?}");
        assert!(found[0].contains(expected), "{found:?}");
    }
    let found = violations(&table, &house(&[("hal", &[], &[])]));
    assert!(found.iter().any(|line| line.contains("`tasks/odd`, which is no crate")), "{found:?}");
    assert!(!violations(&Table::parse("nothing"), &house(base)).is_empty());
}

#[test]
fn an_instrument_in_the_service_is_seen() {
    let rooms = ["hal", "simple", "sim", "lab/scene", "lab/plot", "tasks/lab_scan"];
    let reachable = rooms.iter().map(ToString::to_string).collect();
    assert_eq!(instruments(&reachable), ["lab/plot", "lab/scene", "sim"]);
}

#[test]
fn metadata_is_read() {
    let metadata: Value = serde_json::from_str(
        r#"{"workspace_root": "/w", "packages": [{"manifest_path": "/w/tasks/odd/Cargo.toml",
        "dependencies": [
            {"name": "taktil-hal", "path": "/w/hal", "kind": null, "features": ["conformance"]},
            {"name": "taktil-sim", "path": "/w/sim", "kind": "dev", "features": []},
            {"name": "nix", "kind": "build", "features": []}]}]}"#,
    )
    .expect("it is JSON");
    let crates = from_metadata(&metadata);
    let odd = &crates["tasks/odd"];
    assert_eq!(odd.ours, BTreeSet::from(["hal".to_string()]));
    assert_eq!(odd.others, BTreeSet::from(["nix".to_string()]));
    assert_eq!(odd.for_tests, BTreeSet::from(["taktil-hal".to_string()]));
    assert_eq!(reachable("tasks/odd", &crates), BTreeSet::from(["hal".to_string()]));
}
