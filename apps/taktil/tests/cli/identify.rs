//! `taktil identify jacobian` over the scene of test motions, as the guide says it, against what
//! geometry says of a dome. Refuses to trust the guide's text: its lines are run.

use std::path::Path;

use serde_json::Value;

use crate::process::{Folder, scenes, taktil};

/// The guide's lines that begin with `taktil`, in the block that holds `about`.
fn lines(guide: &str, about: &str) -> Vec<Vec<String>> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/guides").join(guide);
    let text = std::fs::read_to_string(path).unwrap();
    let block = text.split("```sh\n").skip(1).map(|rest| rest.split("```").next().unwrap());
    let block = block.into_iter().find(|block| block.contains(about)).expect("a block of commands");
    let words = |line: &str| line.split_whitespace().skip(1).map(str::to_owned).collect();
    block.lines().map(words).collect()
}

/// An entry of the Jacobian with its uncertainty.
fn entry(found: &Value, feature: &str, motion: &str) -> (f64, f64) {
    let of = |list: &Value, key: &str, name: &str| {
        let list = list.as_array().unwrap();
        list.iter().find(|one| one[key] == name).unwrap_or_else(|| panic!("{name}")).clone()
    };
    let row = of(&found["features"], "feature", feature);
    let entry = of(&row["jacobian"], "motion", motion);
    (entry["value"].as_f64().unwrap(), entry["error"].as_f64().unwrap())
}

#[test]
fn the_guides_lines_find_the_jacobian_of_a_dome_and_say_what_is_not_seen() {
    let folder = Folder::new();
    std::os::unix::fs::symlink(scenes().parent().unwrap(), folder.join("sim")).unwrap();
    let lines = lines("tactile-task.md", "identify jacobian");
    assert!(lines.len() >= 3, "{lines:?}");
    let mut said = Vec::new();
    for line in &lines {
        let words: Vec<&str> = line.iter().map(String::as_str).collect();
        said.push(taktil(folder.path(), &words).ended(0).out);
    }
    println!("{}\n{}", said[1], said[2]);
    for word in ["condition number", "observability: singular values", "+-", "one image tells"] {
        assert!(said[1].contains(word), "{word}:\n{}", said[1]);
    }
    let task = "state = [\"z\", \"theta_x\", \"theta_y\"]";
    assert!(said[2].contains(task), "{}", said[2]);

    let log = ["identify", "jacobian", "jacobian.mcap", "--threshold", "110", "--json"];
    let found: Value = serde_json::from_str(&taktil(folder.path(), &log).ended(0).out).unwrap();
    // A dome of 80 mm: a fixed body moves by 1/pitch columns a mm, a turn of the finger by R/pitch
    // a rad, a little less as the rubber gives.
    let pitch_mm = 25.4 / 16.0;
    let due = [
        ("x_c", "x", -1.0 / pitch_mm, 0.06),
        ("y_c", "y", -1.0 / pitch_mm, 0.06),
        ("y_c", "theta_x", 0.08 / pitch_mm, 0.01),
        ("x_c", "theta_y", -0.08 / pitch_mm, 0.01),
    ];
    for (feature, motion, value, within) in due {
        let (got, error) = entry(&found, feature, motion);
        println!("{feature} by {motion}: {got} +- {error}, geometry {value}");
        assert!((got - value).abs() < within, "{feature} by {motion}: {got}, geometry {value}");
        assert!(error > 0.0 && error < within, "{feature} by {motion}: +- {error}");
    }
    // The force is that of the arm's servo, 14 counts a um, less what friction swallows.
    let (press, error) = entry(&found, "m0", "z");
    assert!((4_000.0..15_000.0).contains(&press) && error < 0.75 * press, "{press} +- {error}");
    // Two of five motions are combinations of the others, and the turn about z is not seen.
    let state = found["state"].as_array().unwrap();
    assert!(state.len() == 3 && !state.contains(&"theta_z".into()), "{state:?}");
    assert!(found["condition"].as_f64().unwrap() < 100.0);
}

#[test]
fn logs_and_names_that_tell_nothing_are_refused() {
    let folder = Folder::new();
    let scene = scenes().join("roll-pin.toml");
    let run = ["run", scene.to_str().unwrap(), "--fast", "--for", "0.5", "--log", "a.mcap"];
    taktil(folder.path(), &run).ended(0);
    let ask = |more: &[&str]| {
        let words = [&["identify", "jacobian", "a.mcap"], more].concat();
        taktil(folder.path(), &words).ended(2).err
    };
    assert!(ask(&[]).contains("0 rests in contact"), "{}", ask(&[]));
    let named = ask(&["--state", "w"]);
    assert!(named.contains("--state w: there are x, y, z, theta_x"), "{named}");
    for bad in ["NaN", "inf", "1e300"] {
        let said = ask(&["--settle", bad]);
        assert!(said.contains("--settle") && said.contains("give 0 to 60"), "{said}");
    }
}
