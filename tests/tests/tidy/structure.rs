//! The shape of the repository: how many folders stand at its root, how large a crate may become,
//! what may depend on an application, and which crates show an example on their first page.

use std::collections::{BTreeMap, BTreeSet};

use crate::circles::{Arrows, components};
use crate::imports::Crate;
use crate::ratchet::Complaint;
use crate::source::{Rust, Text};

/// Folders at the root of the repository; those whose names begin with a dot are not counted.
const TOP_FOLDERS_MAX: usize = 15;
/// Lines under `src` that a crate may have.
const CRATE_LINES_MAX: usize = 25_000;
/// Lines under `src` that an application may have.
const APPLICATION_LINES_MAX: usize = 5_000;
/// Crates whose first page shows a program that compiles.
const CRATES_WITH_EXAMPLE: &[&str] = &["hal", "rtcore", "signal", "mechanics", "contact", "record"];
/// Marks of blocks that are no program.
const NO_PROGRAM: &[&str] = &["text", "ignore", "toml", "sh", "console", "json"];

/// Complaints about folders at the root beyond the limit.
pub(crate) fn top_folders(paths: &[String]) -> Vec<String> {
    let folders: BTreeSet<&str> =
        paths.iter().filter_map(|path| path.split_once('/')).map(|(folder, _)| folder).collect();
    let counted: Vec<&str> = folders.into_iter().filter(|name| !name.starts_with('.')).collect();
    if counted.len() <= TOP_FOLDERS_MAX {
        return Vec::new();
    }
    vec![format!("{} folders at the root, at most {TOP_FOLDERS_MAX}: {counted:?}", counted.len())]
}

/// Complaints about crates and applications with too many lines.
pub(crate) fn large_crates(files: &[Rust]) -> Vec<Complaint> {
    let mut lines: BTreeMap<&str, usize> = BTreeMap::new();
    for file in files {
        if let Some((folder, _)) = file.path.split_once("/src/") {
            *lines.entry(folder).or_default() += file.lines.len();
        }
    }
    let mut found = Vec::new();
    for (folder, lines) in lines {
        let application = folder.starts_with("apps/");
        let limit = if application { APPLICATION_LINES_MAX } else { CRATE_LINES_MAX };
        if lines > limit {
            let text = format!("{lines} lines under src, at most {limit}");
            found.push(Complaint::of_room(folder, &text));
        }
    }
    found
}

/// Complaints about manifests that name an application as a dependency of any kind.
pub(crate) fn applications_as_libraries(files: &[Text]) -> Vec<Complaint> {
    let manifests = || files.iter().filter(|file| file.path.ends_with("Cargo.toml"));
    let table = |file: &Text| file.raw.parse::<toml::Table>().expect("a manifest is TOML");
    let names: BTreeSet<String> = manifests()
        .filter(|file| file.path.starts_with("apps/"))
        .filter_map(|file| Some(table(file).get("package")?.get("name")?.as_str()?.to_string()))
        .collect();
    let mut found = Vec::new();
    for file in manifests() {
        let table = table(file);
        let folder = file.path.rsplit_once('/').map_or("root", |(folder, _)| folder);
        for part in ["dependencies", "dev-dependencies", "build-dependencies"] {
            let entries = table.get(part).and_then(toml::Value::as_table);
            for name in entries.into_iter().flat_map(toml::Table::keys) {
                if names.contains(name) {
                    let text = format!("depends on the application `{name}`");
                    found.push(Complaint::of_room(folder, &text));
                }
            }
        }
    }
    found
}

/// Complaints about top-level folders whose crates depend on each other in a circle.
pub(crate) fn circles_of_folders(crates: &BTreeMap<String, Crate>) -> Vec<String> {
    let top = |room: &str| room.split('/').next().unwrap_or("").to_string();
    let mut arrows = Arrows::new();
    for (room, entry) in crates {
        let targets = arrows.entry(top(room)).or_default();
        targets.extend(entry.ours.iter().map(|name| top(name)));
    }
    let circles = components(&arrows);
    circles.iter().map(|circle| format!("{} depend on each other", circle.join(", "))).collect()
}

/// Complaints about first pages without a program that compiles.
pub(crate) fn pages_without_example(files: &[Rust]) -> Vec<Complaint> {
    let mut found = Vec::new();
    for room in CRATES_WITH_EXAMPLE {
        let page = files.iter().find(|file| file.path == format!("{room}/src/lib.rs"));
        if !page.is_some_and(has_example) {
            let text = "the first page in src/lib.rs shows no program that compiles";
            found.push(Complaint::of_room(room, text));
        }
    }
    found
}

/// Whether the module documentation holds a block of Rust.
fn has_example(file: &Rust) -> bool {
    let lines = file.raw.lines().filter_map(|line| line.strip_prefix("//!"));
    let fences = lines.filter_map(|line| line.trim().strip_prefix("```"));
    fences.step_by(2).any(|marks| !marks.split(',').any(|mark| NO_PROGRAM.contains(&mark.trim())))
}

#[test]
fn too_many_folders_are_seen() {
    let paths = |count: usize| -> Vec<String> { (0..count).map(|n| format!("f{n}/a")).collect() };
    let hidden = [paths(TOP_FOLDERS_MAX), vec![".ci/run".to_string(), "README.md".to_string()]];
    assert!(top_folders(&hidden.concat()).is_empty());
    assert_eq!(top_folders(&paths(TOP_FOLDERS_MAX + 1)).len(), 1);
}

#[test]
fn a_large_crate_is_seen() {
    let file = |path: &str, lines: usize| Rust::new(path, &"\n".repeat(lines - 1));
    let crates = [file("hal/src/a.rs", CRATE_LINES_MAX), file("hal/tests/a.rs", 9)];
    assert!(large_crates(&crates).is_empty());
    let large = [file("hal/src/a.rs", CRATE_LINES_MAX), file("hal/src/b.rs", 1)];
    assert_eq!(large_crates(&large)[0].room, "hal");
    assert_eq!(large_crates(&[file("apps/x/src/a.rs", APPLICATION_LINES_MAX + 1)]).len(), 1);
}

#[test]
fn a_dependency_on_an_application_is_seen() {
    let file = |path: &str, raw: &str| Text { path: path.to_string(), raw: raw.to_string() };
    let app = file("apps/x/Cargo.toml", "[package]\nname = \"x\"");
    let kinds = ["dependencies", "dev-dependencies", "build-dependencies"];
    for kind in kinds {
        let other = file("hal/Cargo.toml", &format!("[{kind}]\nx.workspace = true\ny = \"1\""));
        assert_eq!(applications_as_libraries(&[app.clone(), other])[0].room, "hal");
    }
    assert!(applications_as_libraries(&[app]).is_empty());
}

#[test]
fn folders_that_depend_on_each_other_are_seen() {
    let entry = |ours: &[&str]| Crate {
        ours: ours.iter().map(ToString::to_string).collect(),
        ..Crate::default()
    };
    let rooms = |rooms: &[(&str, &[&str])]| {
        rooms.iter().map(|(room, ours)| (room.to_string(), entry(ours))).collect()
    };
    let circle = rooms(&[("tasks/a", &["lab/b"]), ("lab/c", &["tasks/d"])]);
    assert_eq!(circles_of_folders(&circle), ["lab, tasks depend on each other"]);
    let line = rooms(&[("tasks/a", &["tasks/b", "hal"]), ("lab/c", &["tasks/d"])]);
    assert!(circles_of_folders(&line).is_empty());
}

#[test]
fn a_first_page_without_a_program_is_seen() {
    let page = |raw: &str| Rust::new("hal/src/lib.rs", raw);
    for bad in ["//! A.\n", "//! ```text\n//! a\n//! ```\n", "//! A.\n/// ```\n/// a\n/// ```\n"] {
        assert_eq!(pages_without_example(&[page(bad)]).len(), CRATES_WITH_EXAMPLE.len());
    }
    for good in ["//! ```\n//! a();\n//! ```\n", "//! ```no_run\n//! a();\n//! ```\n"] {
        assert_eq!(pages_without_example(&[page(good)]).len(), CRATES_WITH_EXAMPLE.len() - 1);
    }
}
