//! `taktil new-task` and `taktil new-driver`: crates of one's own to begin with, made from the
//! examples of the repository that its tests build and run. They depend on the checkout by path and
//! take its lock file, so that they build without a network.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use taktil_machine::own::TASK_NAMES;
use taktil_machine_console::option::BadOption;
use taktil_machine_console::out;

/// The checkout that this program was built from.
const BUILT_FROM: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");

/// What a new crate is called, and what it builds on.
#[derive(Clone, Debug, clap::Args)]
pub struct NewCrateArgs {
    /// Name of the task or driver and of the folder: lower-case letters, digits, `_`
    name: String,
    /// Checkout of Taktil that the crate depends on [default: the one this program was built from]
    #[arg(long, value_name = "CHECKOUT")]
    path: Option<PathBuf>,
}

/// An example crate: its own words, and its files.
struct Example {
    package: &'static str,
    /// Its own name, and where in a text that stands for it.
    name: &'static str,
    places: &'static [&'static str],
    /// The type that is called by it.
    type_name: Option<&'static str>,
    files: &'static [(&'static str, &'static str)],
}

macro_rules! example_files {
    ($folder:literal: $($file:literal),*) => {
        &[$(($file, include_str!(concat!("../../../", $folder, "/", $file)))),*]
    };
}

const TASK: Example = Example {
    package: "own-task",
    name: "sway",
    places: &["`sway", "\"sway", "own.sway", "insert.sway"],
    type_name: Some("Sway"),
    files: example_files!("tests/own-task":
        "Cargo.toml", "Cargo.lock", "scene.toml", "src/main.rs", "src/law.rs", "src/task.rs"),
};

const DRIVER: Example = Example {
    package: "own-driver",
    name: "iio",
    places: &["`iio`", "\"iio\"", "\"iio.", "\\\"iio\\\""],
    type_name: None,
    files: example_files!("drivers/template":
        "Cargo.toml", "Cargo.lock", "src/main.rs", "src/lib.rs", "tests/driver.rs"),
};

/// Makes a crate with a task: law, ports, tests and a scene.
///
/// # Errors
/// A name that cannot be one, a checkout that is none, a folder that exists.
pub fn new_task(arguments: &NewCrateArgs) -> anyhow::Result<ExitCode> {
    let folder = write_crate(&TASK, arguments)?;
    let folder = folder.display();
    out::line(format_args!(
        "{folder}: law.rs is the law, task.rs its ports and keys, scene.toml a scene that runs it\n\
         next: cd {folder} && cargo run --release -- run scene.toml\n\
         and:  cargo run --release -- check-task, which drives the task alone with made-up inputs"
    ))?;
    Ok(ExitCode::SUCCESS)
}

/// Makes a crate with a driver and its tests, over the kernel's industrial I/O subsystem.
///
/// # Errors
/// As [`new_task`].
pub fn new_driver(arguments: &NewCrateArgs) -> anyhow::Result<ExitCode> {
    let folder = write_crate(&DRIVER, arguments)?;
    let folder = folder.display();
    out::line(format_args!(
        "{folder}: lib.rs is a driver for A/D converters in sysfs, tests/driver.rs its promises\n\
         next: cd {folder} && cargo test"
    ))?;
    Ok(ExitCode::SUCCESS)
}

fn write_crate(example: &Example, arguments: &NewCrateArgs) -> anyhow::Result<PathBuf> {
    let NewCrateArgs { name, path } = arguments;
    check_name(name)?;
    let checkout = path.clone().unwrap_or_else(|| PathBuf::from(BUILT_FROM));
    let checkout = checkout
        .canonicalize()
        .ok()
        .filter(|folder| folder.join("machine/Cargo.toml").is_file())
        .ok_or_else(|| {
            let what = format!("no checkout of Taktil at {}", checkout.display());
            BadOption(format!("{what}; name one: --path CHECKOUT"))
        })?;
    let folder = PathBuf::from(name);
    if folder.exists() {
        return Err(BadOption(format!("{name} exists; take another name or folder")).into());
    }
    let renamed = |text: &str| {
        let text = text.replace(example.package, &name.replace('_', "-"));
        // The library of a crate is called by its name with `_`.
        let mut text = text.replace(&example.package.replace('-', "_"), name);
        for place in example.places {
            text = text.replace(place, &place.replace(example.name, name));
        }
        match example.type_name {
            Some(type_name) => text.replace(type_name, &camel_case(name)),
            None => text,
        }
    };
    for (file, text) in example.files {
        let text = match *file {
            "Cargo.toml" => manifest(&renamed(text), &checkout),
            "Cargo.lock" => text.replace(
                &format!("name = \"{}\"", example.package),
                &format!("name = \"{}\"", name.replace('_', "-")),
            ),
            "scene.toml" => renamed(&text.replace("../../sim/scenes/machine/", "machine/")),
            _ => renamed(text),
        };
        write(&folder.join(file), &text)?;
    }
    let toolchain = checkout.join("rust-toolchain.toml");
    if let Ok(text) = std::fs::read_to_string(toolchain) {
        write(&folder.join("rust-toolchain.toml"), &text)?;
    }
    Ok(folder)
}

fn write(path: &Path, text: &str) -> anyhow::Result<()> {
    if let Some(parent) = path.parent() {
        std::fs::create_dir_all(parent).with_context(|| parent.display().to_string())?;
    }
    std::fs::write(path, text).with_context(|| path.display().to_string())
}

fn check_name(name: &str) -> Result<(), BadOption> {
    let is_word = name.bytes().next().is_some_and(|first| first.is_ascii_lowercase())
        && name.bytes().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == b'_');
    if !is_word || name.len() > 40 {
        let what = format!("`{}` is no name here", name.escape_debug());
        let remedy = "begin with a lower-case letter; go on with such, digits and `_`";
        return Err(BadOption(format!("{what}; {remedy}")));
    }
    if TASK_NAMES.contains(&name) || RESERVED.contains(&name) {
        return Err(BadOption(format!("`{name}` is taken; choose another name")));
    }
    Ok(())
}

/// Names that cargo or Rust gives another meaning.
const RESERVED: [&str; 14] = [
    "core", "std", "test", "self", "super", "crate", "task", "law", "fn", "impl", "type", "world",
    "serde", "taktil",
];

/// `lift_off` as `LiftOff`.
fn camel_case(name: &str) -> String {
    let capital = |word: &str| {
        let mut letters = word.chars();
        let first = letters.next().map(|c| c.to_ascii_uppercase());
        first.into_iter().chain(letters).collect::<String>()
    };
    name.split('_').map(capital).collect()
}

/// The manifest with the paths of the checkout, and without what it says about the example.
fn manifest(text: &str, checkout: &Path) -> String {
    let text = text.replace("path = \"../../", &format!("path = \"{}/", checkout.display()));
    let lines = text.lines().filter(|line| {
        !line.starts_with("# A ")
            && !line.starts_with("license")
            && !line.starts_with("description")
    });
    lines.map(|line| format!("{line}\n")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_become_words_of_every_kind() {
        assert_eq!(camel_case("lift_off2"), "LiftOff2");
        for good in ["demo", "lift_off", "a1"] {
            assert!(check_name(good).is_ok(), "{good}");
        }
        for bad in ["", "Demo", "1a", "de-mo", "../x", "sense", "std", "a\u{1b}[0m"] {
            let refused = check_name(bad).unwrap_err().0;
            assert!(!refused.contains('\u{1b}'), "{refused:?}");
        }
    }

    #[test]
    fn the_examples_are_whole() {
        for (example, folder) in [(TASK, "tests/own-task"), (DRIVER, "drivers/template")] {
            let root = Path::new(BUILT_FROM).join(folder);
            let sources = std::fs::read_dir(root.join("src")).unwrap();
            let held = |name: &str| example.files.iter().any(|(file, _)| *file == name);
            for source in sources {
                let name = source.unwrap().file_name();
                assert!(held(&format!("src/{}", name.to_str().unwrap())), "{name:?}");
            }
        }
    }
}
