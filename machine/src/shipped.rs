//! Scenes, machine files, arms and tables of motion that the program holds within itself, under
//! their paths in the repository. An installed program finds them from any folder; a file on disk
//! of the same path wins.

use std::path::{Component, Path, PathBuf};

use crate::source::{FileKind, Located, Source};

/// Path from the root of the repository, and text, sorted by path.
const FILES: &[(&str, &str)] = include!(concat!(env!("OUT_DIR"), "/shipped_files.rs"));

/// The folder of the scenes that are found by their names alone.
const SCENES_FOLDER: &str = "sim/scenes";

/// A file that the program holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ShippedFile {
    /// Its path from the root of the repository.
    pub path: &'static str,
    /// Its text.
    pub text: &'static str,
}

impl ShippedFile {
    /// The file as if it had been read.
    #[must_use]
    pub fn source(self) -> Source {
        Source { path: PathBuf::from(self.path), text: self.text.to_owned() }
    }
}

/// What a scene in the folder `folder` names: the file on disk, or else the one that a scene of the
/// program's own would name so. `machine/puma260.toml` is thus found by a scene anywhere.
///
/// # Errors
/// As [`Source::read`], about the file on disk.
pub fn read_beside(folder: &Path, name: &str, kind: FileKind) -> Result<Source, Located> {
    let path = folder.join(name);
    let own = || find(&Path::new(SCENES_FOLDER).join(name), kind);
    match (path.exists(), own()) {
        (false, Some(file)) => Ok(file.source()),
        _ => Source::read(&path, kind),
    }
}

/// Every file that the program holds, sorted by path.
pub fn files() -> impl Iterator<Item = ShippedFile> {
    FILES.iter().map(|(path, text)| ShippedFile { path, text })
}

/// The file that a path names: by its path from the root of the repository, such as
/// `sim/scenes/roll-pin.toml`. A scene is found by its path below `sim/scenes` too, with or without
/// `.toml`: `roll-pin`, `held/light`. An absolute path names none.
#[must_use]
pub fn find(path: &Path, kind: FileKind) -> Option<ShippedFile> {
    let whole = without_dots(path)?;
    let at = |name: &Path| {
        let name = name.to_str()?;
        let index = FILES.binary_search_by(|(path, _)| path.cmp(&name)).ok()?;
        FILES.get(index).map(|(path, text)| ShippedFile { path, text })
    };
    let scene = || {
        let below = Path::new(SCENES_FOLDER).join(&whole);
        let mut named = below.clone().into_os_string();
        named.push(".toml");
        at(&below).or_else(|| at(Path::new(&named)))
    };
    at(&whole).or_else(|| (kind == FileKind::Scene).then(scene).flatten())
}

/// A relative path without `.` and `..`; `None` when it is absolute or leads out of its root.
fn without_dots(path: &Path) -> Option<PathBuf> {
    let mut plain = PathBuf::new();
    for component in path.components() {
        match component {
            Component::CurDir => {}
            Component::Normal(name) => plain.push(name),
            Component::ParentDir => plain.pop().then_some(())?,
            Component::RootDir | Component::Prefix(_) => return None,
        }
    }
    Some(plain)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path_of(name: &str, kind: FileKind) -> Option<&'static str> {
        find(Path::new(name), kind).map(|file| file.path)
    }

    #[test]
    fn every_file_of_the_folders_is_held_and_is_what_lies_on_disk() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        assert!(files().count() > 60);
        for file in files() {
            assert_eq!(std::fs::read_to_string(root.join(file.path)).unwrap(), file.text);
        }
        for (before, after) in files().zip(files().skip(1)) {
            assert!(before.path < after.path, "{} {}", before.path, after.path);
        }
    }

    #[test]
    fn a_scene_is_found_by_path_and_by_name_and_a_machine_by_path_only() {
        let scene = Some("sim/scenes/roll-pin.toml");
        for name in ["roll-pin", "roll-pin.toml", "sim/scenes/roll-pin.toml", "./roll-pin"] {
            assert_eq!(path_of(name, FileKind::Scene), scene, "{name}");
        }
        assert_eq!(path_of("held/light", FileKind::Scene), Some("sim/scenes/held/light.toml"));
        let machine = "sim/scenes/held/../machine/puma260.toml";
        let found = Some("sim/scenes/machine/puma260.toml");
        assert_eq!(path_of(machine, FileKind::Machine), found);
        let arm = "sim/scenes/machine/../../arms/puma260.urdf";
        assert_eq!(path_of(arm, FileKind::Arm), Some("sim/arms/puma260.urdf"));
        for (name, kind) in [
            ("machine/puma260.toml", FileKind::Machine),
            ("roll-pin", FileKind::Machine),
            ("/sim/scenes/roll-pin.toml", FileKind::Scene),
            ("../sim/scenes/roll-pin.toml", FileKind::Scene),
            ("", FileKind::Scene),
            ("roll", FileKind::Scene),
        ] {
            assert_eq!(path_of(name, kind), None, "{name}");
        }
    }
}
