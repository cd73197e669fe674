//! Checks that what the pages tell a reader to type or to open exists: relative paths, subcommands
//! and options of the command line, and cargo's packages and targets.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::Value;

use crate::records::resolve;
use crate::source::Text;

/// Programs whose first words are subcommands of the command line.
const PROGRAMS: &[&str] = &["taktil", "target/release/taktil"];

/// Paths in backticks that do not exist in the repository, and why they may be named.
const OTHER_PATHS: &[(&str, &str)] = &[
    ("src/main.rs", "a file of the reader's own crate"),
    ("target/release/taktil", "the program, once it is built"),
    ("intel_pstate/no_turbo", "a file of the kernel under /sys"),
    ("cpufreq/boost", "a file of the kernel under /sys"),
];

/// Languages of blocks that hold no commands.
const OTHER_LANGUAGES: &[&str] = &["toml", "rust", "json"];

/// A command with its options and subcommands.
#[derive(Clone, Debug, Default)]
pub(crate) struct Verb {
    options: BTreeSet<String>,
    subcommands: BTreeMap<String, Verb>,
}

/// Package -> names of its targets, each with its kind in front: `test tidy`.
pub(crate) type Targets = BTreeMap<String, BTreeSet<String>>;

/// What exists.
pub(crate) struct Known<'a> {
    /// The command line.
    pub(crate) program: Verb,
    /// Cargo's packages.
    pub(crate) targets: Targets,
    /// Whether a path from the root exists.
    pub(crate) exists: &'a dyn Fn(&str) -> bool,
}

/// The command line as the program defines it. This is the one place that names its crate.
pub(crate) fn command_line() -> Verb {
    Verb::new(&taktil_lab_command::cli::definition())
}

impl Verb {
    fn new(command: &clap::Command) -> Verb {
        let options = command.get_arguments().filter_map(clap::Arg::get_long);
        let subcommands = command.get_subcommands();
        Verb {
            options: options.chain(["help", "version"]).map(str::to_string).collect(),
            subcommands: subcommands.map(|sub| (sub.get_name().into(), Verb::new(sub))).collect(),
        }
    }
}

/// The packages and targets in what `cargo metadata` says.
pub(crate) fn targets(metadata: &Value) -> Targets {
    let list = |value: &Value| value.as_array().cloned().unwrap_or_default();
    let text = |value: &Value| value.as_str().unwrap_or("").to_string();
    let mut found = Targets::new();
    for package in list(&metadata["packages"]) {
        let mut names = BTreeSet::new();
        for target in list(&package["targets"]) {
            let kinds = list(&target["kind"]);
            let name = text(&target["name"]);
            names.extend(kinds.iter().map(|kind| format!("{} {name}", text(kind))));
        }
        found.insert(text(&package["name"]), names);
    }
    found
}

/// The pages that a reader follows by typing.
pub(crate) fn is_page(path: &str) -> bool {
    let guide = path.starts_with("docs/guides/") && path.ends_with(".md");
    guide || path == "README.md" || path == "ARCHITECTURE.md"
}

/// Complaints about the pages, and about allowed paths that no page names.
pub(crate) fn violations(files: &[Text], known: &Known) -> Vec<String> {
    let pages = || files.iter().filter(|file| is_page(&file.path));
    let mut found: Vec<String> = pages().flat_map(|page| in_page(page, known)).collect();
    for (path, reason) in OTHER_PATHS {
        if !pages().any(|page| page.raw.contains(&format!("`{path}`"))) {
            found.push(format!("`{path}` is on no page; drop its exception ({reason})"));
        }
    }
    found
}

fn in_page(page: &Text, known: &Known) -> Vec<String> {
    let folder = page.path.rsplit_once('/').map_or("", |(folder, _)| folder);
    let mut found = Vec::new();
    let mut fence = None;
    for (number, line) in page.raw.lines().enumerate() {
        let mut say = |text: String| found.push(format!("{}:{}: {text}", page.path, number + 1));
        if let Some(language) = line.trim_start().strip_prefix("```") {
            fence = if fence.is_some() { None } else { Some(language) };
            continue;
        }
        if fence.is_some_and(|language| OTHER_LANGUAGES.contains(&language)) {
            continue;
        }
        // Guides show commands indented by four blanks, too.
        if fence.is_some() || line.starts_with("    ") {
            for complaint in in_shell(line, known) {
                say(complaint);
            }
            continue;
        }
        for span in line.split('`').skip(1).step_by(2) {
            if let Some(path) = relative_path(span) {
                let near = (known.exists)(&resolve(folder, path));
                if !near && !(known.exists)(&resolve("", path)) {
                    say(format!("`{span}` does not exist"));
                }
            }
            for complaint in in_shell(span, known) {
                say(complaint);
            }
        }
    }
    found
}

/// The path that a span of code is, if it is one: names with slashes between, no blank, not
/// absolute; a `*` at the end stands for the folder's files.
fn relative_path(span: &str) -> Option<&str> {
    let named = |c: char| c.is_alphanumeric() || "_-./".contains(c);
    let path = span.strip_suffix("/*").unwrap_or(span);
    let slash = span.contains('/') && !span.starts_with('/');
    let shouted = |part: &str| part.contains(char::is_alphabetic) && part == part.to_uppercase();
    let placeholder = path.split('/').any(shouted);
    let other = OTHER_PATHS.iter().any(|(other, _)| *other == path);
    (slash && path.chars().all(named) && !placeholder && !other).then_some(path)
}

/// Complaints about a line for a shell.
fn in_shell(line: &str, known: &Known) -> Vec<String> {
    let line = line.split(" #").next().unwrap_or("");
    let mut found = Vec::new();
    for command in line.split(['|', ';', '&', '<', '>']) {
        // What stands behind a wide gap is prose.
        let command = command.trim().split("   ").next().unwrap_or("");
        let words: Vec<&str> = command.split_whitespace().collect();
        match words[..] {
            [program, ref rest @ ..] if PROGRAMS.contains(&program) => {
                found.extend(in_command(rest, &known.program));
            }
            ["cargo", ref rest @ ..] => found.extend(in_cargo(rest, known)),
            _ => continue,
        }
        let paths = words.iter().filter(|word| word.contains('/') && !word.starts_with("target/"));
        for path in paths.filter_map(|word| relative_path(word)) {
            // A file that the command makes stands in no folder of the repository.
            let room = path.split('/').next().unwrap_or("");
            if (known.exists)(room) && !(known.exists)(path) {
                found.push(format!("`{path}` does not exist"));
            }
        }
    }
    found
}

/// Complaints about the words behind the program's name.
fn in_command(words: &[&str], program: &Verb) -> Option<String> {
    let mut verb = program;
    for word in words {
        let word = word.trim_matches(['[', ']', ',']);
        if let Some(option) = word.strip_prefix("--").filter(|option| !option.is_empty()) {
            let option = option.split('=').next().unwrap_or("");
            if !verb.options.contains(option) {
                return Some(format!("`taktil {}` has no option --{option}", words[0]));
            }
        } else if let Some(next) = verb.subcommands.get(word) {
            verb = next;
        } else if !verb.subcommands.is_empty() && word.starts_with(char::is_alphanumeric) {
            // `taktil scene FILE` and the like: a value may stand where a subcommand may.
            let placeholder = word == word.to_uppercase();
            if !placeholder {
                return Some(format!("the command line has no `{word}` there"));
            }
        }
    }
    None
}

/// Complaints about the words behind `cargo`.
fn in_cargo(words: &[&str], known: &Known) -> Vec<String> {
    let end = words.iter().position(|word| *word == "--").unwrap_or(words.len());
    let value = |names: &[&str]| {
        let at = words[..end].iter().position(|word| names.contains(word))?;
        words.get(at + 1).copied()
    };
    let mut found = Vec::new();
    let package = value(&["-p", "--package"]);
    if let Some(package) = package.filter(|package| !known.targets.contains_key(*package)) {
        return vec![format!("there is no package `{package}`")];
    }
    for kind in ["test", "example", "bin", "bench"] {
        let Some(name) = value(&[&format!("--{kind}")]) else { continue };
        let target = format!("{kind} {name}");
        let exists = match package {
            Some(package) => known.targets[package].contains(&target),
            None => known.targets.values().any(|targets| targets.contains(&target)),
        };
        if !exists {
            found.push(format!("`{}` has no {target}", package.unwrap_or("the workspace")));
        }
    }
    let own = value(&["--example", "--bin"]).is_some();
    let ours = !own && package.is_none_or(|name| name == "taktil");
    let runs = ours && words.first() == Some(&"run");
    if runs && end < words.len() {
        found.extend(in_command(&words[end + 1..], &known.program));
    }
    found
}

#[cfg(test)]
fn complaints(line: &str) -> Vec<String> {
    let sub = |name: &'static str| clap::Command::new(name);
    let run = sub("run").arg(clap::Arg::new("fast").long("fast"));
    let bench = sub("bench").subcommand(sub("servo"));
    let program = Verb::new(&sub("taktil").subcommand(run).subcommand(bench));
    let metadata = serde_json::json!({"packages": [{"name": "taktil-sim", "targets": [
        {"kind": ["test"], "name": "arm"}, {"kind": ["example"], "name": "fall"}]}]});
    let exists = |path: &str| ["docs/guides/a.md", "sim/b.rs", "sim"].contains(&path);
    let known = Known { program, targets: targets(&metadata), exists: &exists };
    in_page(&Text { path: "docs/guides/a.md".to_string(), raw: line.to_string() }, &known)
}

#[test]
fn what_a_page_names_and_is_not_there_is_seen() {
    for bad in [
        "see `sim/c.rs`",
        "`../guides/b.md`",
        "`taktil walk`",
        "`taktil bench walk --help`",
        "`taktil run SCENE --slow`",
        "```sh\ntaktil run sim/c.toml --fast   # words\n```",
        "    echo 1 | taktil walk",
        "`cargo test -p taktil-arm`",
        "`cargo test -p taktil-sim --test leg`",
        "`cargo run -p taktil-sim --example arm -- run`",
        "`cargo run --release -- walk`",
        "`cargo test --manifest-path sim/Cargo.toml`",
    ] {
        assert_eq!(complaints(bad).len(), 1, "{bad}: {:?}", complaints(bad));
    }
}

#[test]
fn what_is_there_is_accepted() {
    for good in [
        "`sim/b.rs`, `a.md`, `sim/*`, `/proc/cpuinfo`, `E / t^2`, `N/A`, `my/DIR`",
        "`taktil run SCENE --fast`, `taktil bench servo`, `taktil`",
        "```sh\ntaktil run roll.mcap --fast    walk this --way\n```",
        "`cargo test -p taktil-sim --test arm pinned -- --nocapture`",
        "`cargo run -p taktil-sim --example fall -- 60 load`",
        "`cargo run --release -- run x --fast`, `taktil run < in > out`",
        "```toml\ntaktil = { path = 1 }\n```",
        "taktil walks",
    ] {
        assert!(complaints(good).is_empty(), "{good}: {:?}", complaints(good));
    }
}

#[test]
fn an_allowed_path_that_no_page_names_is_seen() {
    let known = Known { program: Verb::default(), targets: Targets::new(), exists: &|_| true };
    assert_eq!(violations(&[], &known).len(), OTHER_PATHS.len());
}
