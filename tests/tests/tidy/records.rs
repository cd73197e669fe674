//! Checks that the project's records are complete: decisions listed, dependencies explained, links
//! alive, toolchain and lock file fixed. Whether a reason is good is left to reviewers.

use std::collections::BTreeSet;
use std::fs;

use crate::source::{Text, read, root};

/// The decision record that explains each dependency.
pub(crate) const DEPENDENCIES: &str = "docs/decisions/0003-dependencies.md";
/// Reasons of what crates outside the workspace take besides.
pub(crate) const OUTSIDE: &str = "docs/decisions/0014-crates-outside.md";

/// The index of decisions and the records that exist: name and text.
pub(crate) fn decisions() -> (String, Vec<(String, String)>) {
    let folder = root().join("docs/decisions");
    let mut files: Vec<(String, String)> = fs::read_dir(&folder)
        .expect("docs/decisions exists")
        .filter_map(Result::ok)
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .filter(|name| name != "README.md")
        .map(|name| (name.clone(), read(&format!("docs/decisions/{name}"))))
        .collect();
    files.sort();
    (read("docs/decisions/README.md"), files)
}

/// Complaints: a record that the index does not link, two with one number, one without a status.
pub(crate) fn unlisted_decisions(index: &str, files: &[(String, String)]) -> Vec<String> {
    let mut found = Vec::new();
    let mut numbers = BTreeSet::new();
    for (name, text) in files {
        if !index.contains(&format!("]({name})")) {
            found.push(format!("docs/decisions/README.md does not link {name}"));
        }
        let number = name.split('-').next().unwrap_or("");
        let numbered = number.len() == 4 && number.chars().all(|c| c.is_ascii_digit());
        if !numbered || !numbers.insert(number) {
            found.push(format!("{name}: needs a four-digit number of its own in front"));
        }
        for part in ["# ", "Status: ", "## Why", "## Costs"] {
            if !text.lines().any(|line| line.starts_with(part)) {
                found.push(format!("{name}: has no line that starts with `{part}`"));
            }
        }
    }
    found
}

/// Complaints: a dependency without a row in the record, a row without a dependency.
pub(crate) fn unexplained_dependencies(manifest: &str, record: &str) -> Vec<String> {
    let manifest: toml::Table = manifest.parse().expect("Cargo.toml is TOML");
    let used: BTreeSet<String> = manifest["workspace"]["dependencies"]
        .as_table()
        .expect("the root lists its dependencies")
        .iter()
        .filter(|(_, value)| value.get("path").is_none())
        .map(|(name, _)| name.clone())
        .collect();
    let explained: BTreeSet<String> = record
        .lines()
        .filter_map(|line| line.strip_prefix("| `"))
        .filter_map(|line| line.split('`').next())
        .map(str::to_string)
        .collect();
    let missing = used.difference(&explained).map(|name| format!("{name}: no row says why"));
    let stale = explained.difference(&used).map(|name| format!("{name}: a row, but not used"));
    missing.chain(stale).collect()
}

/// Complaints about dependencies of crates outside the workspace that no row of the record names,
/// and that the workspace does not have anyway.
pub(crate) fn unexplained_outside(files: &[Text], root: &str, record: &str) -> Vec<String> {
    let root: toml::Table = root.parse().expect("Cargo.toml is TOML");
    let mut found = Vec::new();
    for file in files.iter().filter(|file| file.path.ends_with("/Cargo.toml")) {
        let manifest: toml::Table = file.raw.parse().unwrap_or_default();
        for part in ["dependencies", "dev-dependencies", "build-dependencies"] {
            let entries = manifest.get(part).and_then(toml::Value::as_table);
            for (name, value) in entries.into_iter().flatten() {
                let known = root["workspace"]["dependencies"].get(name).is_some()
                    || value.get("path").is_some()
                    || record.contains(&format!("| `{name}` |"));
                if manifest.contains_key("workspace") && !known {
                    found.push(format!("{}: `{name}` has no row", file.path));
                }
            }
        }
    }
    found
}

/// Complaints about members that fix a version of their own. Crates outside the workspace have one
/// of their own, and nothing to take versions from.
pub(crate) fn own_versions(files: &[Text]) -> Vec<String> {
    let mut found = Vec::new();
    for file in files {
        if !file.path.ends_with("/Cargo.toml") {
            continue;
        }
        let manifest: toml::Table = match file.raw.parse() {
            Ok(table) => table,
            Err(error) => {
                found.push(format!("{}: {error}", file.path));
                continue;
            }
        };
        if manifest.contains_key("workspace") {
            continue;
        }
        for part in ["dependencies", "dev-dependencies", "build-dependencies"] {
            let entries = manifest.get(part).and_then(toml::Value::as_table);
            for (name, value) in entries.into_iter().flatten() {
                if value.get("workspace").and_then(toml::Value::as_bool) != Some(true) {
                    found.push(format!("{}: `{name}` is not taken from the root", file.path));
                }
            }
        }
    }
    found
}

/// Complaints about relative links of Markdown files that lead nowhere.
pub(crate) fn dead_links(files: &[Text], exists: impl Fn(&str) -> bool) -> Vec<String> {
    let mut found = Vec::new();
    for file in files.iter().filter(|file| file.path.ends_with(".md")) {
        let folder = file.path.rsplit_once('/').map_or("", |(folder, _)| folder);
        let mut fenced = false;
        for (number, line) in file.raw.lines().enumerate() {
            fenced ^= line.trim_start().starts_with("```");
            if fenced {
                continue;
            }
            for target in targets(line) {
                if !exists(&resolve(folder, target)) {
                    found.push(format!("{}:{}: `{target}` leads nowhere", file.path, number + 1));
                }
            }
        }
    }
    found
}

/// Relative targets of the links on a line, without their fragments.
fn targets(line: &str) -> impl Iterator<Item = &str> {
    line.split("](")
        .skip(1)
        .filter_map(|rest| rest.split([')', ' ']).next())
        .filter(|target| !target.contains("://") && !target.starts_with("mailto:"))
        .map(|target| target.split('#').next().unwrap_or(""))
        .filter(|target| !target.is_empty())
}

/// A path from the root, `.` and `..` taken out.
pub(crate) fn resolve(folder: &str, target: &str) -> String {
    let mut parts: Vec<&str> = Vec::new();
    for part in folder.split('/').chain(target.split('/')) {
        match part {
            "" | "." => {}
            ".." => {
                parts.pop();
            }
            name => parts.push(name),
        }
    }
    parts.join("/")
}

/// Complaints about a toolchain that is not one exact version, the one that the manifest promises.
pub(crate) fn unpinned_toolchain(toolchain: &str, manifest: &str) -> Vec<String> {
    let toolchain: toml::Table = toolchain.parse().expect("rust-toolchain.toml is TOML");
    let manifest: toml::Table = manifest.parse().expect("Cargo.toml is TOML");
    let channel = toolchain["toolchain"]["channel"].as_str().unwrap_or("");
    let minimum = manifest["workspace"]["package"]["rust-version"].as_str().unwrap_or("none");
    let numbers = channel.split('.').filter(|part| part.parse::<u32>().is_ok()).count();
    let mut found = Vec::new();
    if numbers != 3 || channel.split('.').count() != 3 {
        found.push(format!("rust-toolchain.toml: `{channel}` is not one exact version"));
    }
    if !channel.starts_with(minimum) {
        found.push(format!("rust-version {minimum} is not what {channel} tests"));
    }
    found
}

/// Complaints about build output that version control would take in: crates outside the workspace
/// have folders of their own.
pub(crate) fn tracked_output(ignore: &str) -> Vec<String> {
    let anywhere = |name: &str| ignore.lines().any(|line| line.trim() == name);
    let folders = ["target/", "target-*/"];
    let open = folders.into_iter().filter(|name| !anywhere(name));
    open.map(|name| format!(".gitignore does not keep {name} out everywhere")).collect()
}

/// Complaints about a lock file that is ignored or names anything but the public index.
pub(crate) fn lock_file(lock: &str, ignore: &str) -> Vec<String> {
    let mut found = Vec::new();
    if ignore.lines().any(|line| line.contains("Cargo.lock") || line.trim() == "*.lock") {
        found.push(".gitignore hides Cargo.lock".to_string());
    }
    let table: toml::Table = lock.parse().expect("Cargo.lock is TOML");
    let packages = table.get("package").and_then(toml::Value::as_array);
    for package in packages.into_iter().flatten() {
        let name = package.get("name").and_then(toml::Value::as_str).unwrap_or("?");
        let source = package.get("source").and_then(toml::Value::as_str).unwrap_or(PUBLIC);
        if source != PUBLIC {
            found.push(format!("Cargo.lock: {name} comes from {source}"));
        }
    }
    if packages.is_none_or(Vec::is_empty) {
        found.push("Cargo.lock is empty".to_string());
    }
    found
}

/// The one source that every clone can reach.
const PUBLIC: &str = "registry+https://github.com/rust-lang/crates.io-index";

#[test]
fn an_unlisted_or_shapeless_decision_is_seen() {
    let whole = "# A\n\nStatus: in force\n\n## Why\n\n## Costs\n".to_string();
    let record = |name: &str, text: &str| (name.to_string(), text.to_string());
    let index = "| [A](0001-a.md) | [B](0001-b.md) |";
    assert!(unlisted_decisions(index, &[record("0001-a.md", &whole)]).is_empty());
    assert_eq!(unlisted_decisions("", &[record("0001-a.md", &whole)]).len(), 1);
    assert_eq!(unlisted_decisions(index, &[record("0001-a.md", "# A\n")]).len(), 3);
    let twice = [record("0001-a.md", &whole), record("0001-b.md", &whole)];
    assert_eq!(unlisted_decisions(index, &twice).len(), 1);
}

#[test]
fn an_unexplained_dependency_is_seen() {
    let manifest = "[workspace.dependencies]\nours = { path = \"hal\" }\nnix = \"1\"\nlibc = \"1\"";
    let found = unexplained_dependencies(manifest, "| `nix` | why |\n| `gone` | why |");
    assert_eq!(found, ["libc: no row says why", "gone: a row, but not used"]);
}

#[test]
fn a_version_of_ones_own_is_seen() {
    let file = |raw: &str| [Text { path: "hal/Cargo.toml".to_string(), raw: raw.to_string() }];
    assert_eq!(own_versions(&file("[dependencies]\nnix = \"1\"")).len(), 1);
    assert_eq!(own_versions(&file("[dev-dependencies]\nnix = { version = \"1\" }")).len(), 1);
    assert!(own_versions(&file("[dependencies]\nnix.workspace = true")).is_empty());
}

#[test]
fn an_unexplained_dependency_outside_the_workspace_is_seen() {
    let file = |raw: &str| [Text { path: "tests/x/Cargo.toml".to_string(), raw: raw.to_string() }];
    let (root, record) = ("[workspace.dependencies]\nnix = \"1\"", "| `loom` | why |");
    let seen = |raw: &str| unexplained_outside(&file(raw), root, record).len();
    assert_eq!(seen("[workspace]\n[dependencies]\nodd = \"1\""), 1);
    assert_eq!(seen("[workspace]\n[dev-dependencies]\nodd = { version = \"1\" }"), 1);
    let good = "[workspace]\n[dependencies]\nloom = \"1\"\nnix = \"1\"\nown = { path = \"..\" }";
    assert_eq!(seen(good), 0);
}

#[test]
fn a_dead_link_is_seen() {
    let raw = "[a](b.md#c) [d](https://x.y) [e](#f) [g](../README.md)\n```\n[h](i.md)\n```\n";
    let file = [Text { path: "docs/x.md".to_string(), raw: raw.to_string() }];
    let found = dead_links(&file, |path| path == "README.md");
    assert_eq!(found, ["docs/x.md:1: `b.md` leads nowhere"]);
}

#[test]
fn a_loose_toolchain_is_seen() {
    let toolchain = |channel: &str| format!("[toolchain]\nchannel = \"{channel}\"");
    let manifest = "[workspace.package]\nrust-version = \"1.95\"";
    assert!(unpinned_toolchain(&toolchain("1.95.0"), manifest).is_empty());
    assert_eq!(unpinned_toolchain(&toolchain("1.95"), manifest).len(), 1);
    assert_eq!(unpinned_toolchain(&toolchain("stable"), manifest).len(), 2);
    assert_eq!(unpinned_toolchain(&toolchain("1.96.0"), manifest).len(), 1);
}

#[test]
fn a_private_source_is_seen() {
    let lock = |source: &str| format!("[[package]]\nname = \"a\"\nsource = \"{source}\"");
    assert_eq!(tracked_output("/target\n/target-*").len(), 2);
    assert!(tracked_output("target/\ntarget-*/\n/out").is_empty());
    assert!(lock_file(&lock(PUBLIC), "/target").is_empty());
    assert_eq!(lock_file(&lock("git+https://a.b/c"), "Cargo.lock").len(), 2);
    assert_eq!(lock_file("version = 4", "").len(), 1);
}
