//! Scenes, machine files, arms and tables of motion that the program holds within itself, under
//! their paths in the repository. An installed program finds them from any folder; a file on disk
//! of the same path wins.

use std::path::{Component, Path, PathBuf};

/// Path from the root of the repository, and text, sorted by path.
const FILES: &[(&str, &str)] = include!(concat!(env!("OUT_DIR"), "/shipped_files.rs"));

/// The folder of the scenes that are found by their names alone.
pub const SCENES_FOLDER: &str = "sim/scenes";

/// A file that the program holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ShippedFile {
    /// Its path from the root of the repository.
    pub path: &'static str,
    /// Its text.
    pub text: &'static str,
}

/// Every file that the program holds, sorted by path.
pub fn files() -> impl Iterator<Item = ShippedFile> {
    FILES.iter().map(|(path, text)| ShippedFile { path, text })
}

/// The file that a path names: by its path from the root of the repository, such as
/// `sim/scenes/roll-pin.toml`. A scene is found by its path below `sim/scenes` too, with or without
/// `.toml`: `roll-pin`, `held/light`. An absolute path names none.
#[must_use]
pub fn find(path: &Path, is_scene: bool) -> Option<ShippedFile> {
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
    at(&whole).or_else(|| is_scene.then(scene).flatten())
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

    fn path_of(name: &str, is_scene: bool) -> Option<&'static str> {
        find(Path::new(name), is_scene).map(|file| file.path)
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
            assert_eq!(path_of(name, true), scene, "{name}");
        }
        assert_eq!(path_of("held/light", true), Some("sim/scenes/held/light.toml"));
        let machine = "sim/scenes/held/../machine/puma260.toml";
        let found = Some("sim/scenes/machine/puma260.toml");
        assert_eq!(path_of(machine, false), found);
        let arm = "sim/scenes/machine/../../arms/puma260.urdf";
        assert_eq!(path_of(arm, false), Some("sim/arms/puma260.urdf"));
        for (name, is_scene) in [
            ("machine/puma260.toml", false),
            ("roll-pin", false),
            ("/sim/scenes/roll-pin.toml", true),
            ("../sim/scenes/roll-pin.toml", true),
            ("", true),
            ("roll", true),
        ] {
            assert_eq!(path_of(name, is_scene), None, "{name}");
        }
    }
}
