//! Every key that was renamed is refused under its old name, at its place and with its new name,
//! wherever the key stands in a machine file or a scene.

use std::path::PathBuf;

use taktil_lab_scene::scene::{self, Scene};
use taktil_machine::config::MachineConfig;
use taktil_machine::renamed::{RENAMED_KEYS, renamed_key};
use taktil_machine::source::{Located, Source};
use taktil_signal::renamed::RENAMED_PORTS;

fn source(text: String) -> Source {
    Source { path: PathBuf::from("a.toml"), text }
}

fn scene_error(text: String) -> Located {
    let read = |name: &str| Err(format!("there is no `{name}`"));
    Scene::of(source(text), None, &|name| read(name)).map(drop).unwrap_err()
}

/// A file that holds nothing but the key `old`, in the place of the key at `path`; the key stands
/// in the third line.
fn file_with(old: &str, path: &str) -> String {
    let section = path.rsplit_once('.').map_or("", |(section, _)| section).replace('*', "servo");
    let header = match section.strip_suffix("[]") {
        Some(list) => format!("[[{list}]]"),
        None if section.is_empty() => "# The outermost table.".to_owned(),
        None => format!("[{section}]"),
    };
    let value = "1";
    format!("{header}\n\n{old} = {value}\n")
}

/// Whether the complaint is the one line that names both, at the key.
fn names_both(found: &Located, old: &str, new: &str, line: usize) {
    let end = format!("unknown key `{old}`; it is called `{new}` now");
    assert!(found.what.ends_with(&end), "{found}");
    assert_eq!(found.remedy, format!("write `{new}`"));
    let mark = found.mark.as_ref().expect("a place");
    assert_eq!((mark.line, mark.column, mark.width), (line, 1, old.len()), "{found}");
}

#[test]
fn every_old_key_is_refused_with_its_new_name() {
    let keys = scene::keys();
    for key in RENAMED_KEYS {
        let mut places = 0;
        for place in keys.iter().map(|key| key.path.trim_end_matches("[]")) {
            let (section, last) = place.rsplit_once('.').unwrap_or(("", place));
            let before = format!("{section}.{}", key.old);
            if last != key.new || renamed_key(&before, key.old) != Some(key.new) {
                continue;
            }
            places += 1;
            let text = format!("title = \"a\"\n{}", file_with(key.old, place));
            names_both(&scene_error(text), key.old, key.new, 4);
            if let Some(place) = place.strip_prefix("robot.") {
                let found = source(file_with(key.old, place)).parse::<MachineConfig>();
                names_both(&found.map(drop).unwrap_err(), key.old, key.new, 3);
            }
        }
        assert!(places > 0, "{key:?}: no configuration has the new key");
    }
}

#[test]
fn no_key_has_an_old_name() {
    for key in scene::keys() {
        for part in key.path.split(['.', '[', ']']) {
            assert_eq!(renamed_key(&key.path, part), None, "{}", key.path);
        }
    }
}

#[test]
fn an_old_port_is_refused_with_its_new_name() {
    let file = std::path::Path::new("../../sim/scenes/roll-pin.toml");
    let machine = Source::read(
        &file.with_file_name("machine/puma260.toml"),
        taktil_machine::source::FileKind::Machine,
    )
    .unwrap();
    let bound =
        RENAMED_PORTS.iter().filter(|(_, new)| machine.text.contains(&format!("\"{new}\"")));
    let mut found = 0;
    for (old, new) in bound {
        found += 1;
        let text = machine.text.replacen(&format!("\"{new}\""), &format!("\"{old}\""), 1);
        let line = 1 + text.lines().position(|line| line.contains(&format!("\"{old}\""))).unwrap();
        let scene_text = std::fs::read_to_string(file).unwrap();
        let refused = Scene::of(source(scene_text), Some(source(text)), &|name| {
            Err(format!("there is no `{name}`"))
        })
        .and_then(|scene| taktil_lab_scene::assembly::Assembly::new(&scene).build().map(drop))
        .unwrap_err();
        assert!(
            refused.what.ends_with(&format!("unknown port `{old}`; it is called `{new}` now")),
            "{refused}"
        );
        assert_eq!(refused.mark.map(|mark| mark.line), Some(line));
    }
    assert!(found > 1, "{found} of the ports stand in the machine file");
}
