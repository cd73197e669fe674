//! Lists the scenes, machine files, arms and tables of motion of the repository, so that an
//! installed program holds them too.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Folders whose files the program holds, from the root of the repository.
const FOLDERS: [&str; 2] = ["sim/scenes", "sim/arms"];

fn files(folder: &Path, found: &mut Vec<PathBuf>) -> std::io::Result<()> {
    println!("cargo::rerun-if-changed={}", folder.display());
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            files(&path, found)?;
        } else {
            found.push(path);
        }
    }
    Ok(())
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let root = Path::new(&std::env::var("CARGO_MANIFEST_DIR")?).join("..").canonicalize()?;
    let mut found = Vec::new();
    for folder in FOLDERS {
        files(&root.join(folder), &mut found)?;
    }
    let mut names = Vec::new();
    for path in &found {
        names.push(path.strip_prefix(&root)?.to_str().ok_or("a name that is not text")?);
    }
    // By the bytes of the whole name, as it is searched for.
    names.sort_unstable();
    let mut list = "&[\n".to_owned();
    for name in names {
        writeln!(list, "    ({name:?}, include_str!({:?})),", root.join(name))?;
    }
    list += "]\n";
    std::fs::write(Path::new(&std::env::var("OUT_DIR")?).join("shipped_files.rs"), list)?;
    Ok(())
}
