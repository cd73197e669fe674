//! `taktil identify jacobian` over the scene of test motions, run with the command lines of the
//! guide, against the geometry of a dome.

use std::path::Path;

use serde_json::Value;
use taktil_contact::cylinder::LineContact;
use taktil_contact::layer::Layer;
use taktil_mechanics::Joints;
use taktil_mechanics::robot::Robot;
use taktil_tasks_joint_servo::Config;

use crate::process::{Folder, scenes, taktil};

/// The lines of the guide that begin with `taktil`, in the block that contains `about`.
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
fn the_commands_of_the_guide_find_the_jacobian_of_a_dome() {
    let folder = Folder::new();
    std::os::unix::fs::symlink(scenes().parent().unwrap(), folder.join("sim")).unwrap();
    let lines = lines("tactile-task.md", "identify jacobian");
    assert!(lines.len() >= 3, "{lines:?}");
    let mut said = Vec::new();
    for line in &lines {
        let words: Vec<&str> = line.iter().map(String::as_str).collect();
        said.push(taktil(folder.path(), &words).expect_code(0).out);
    }
    println!("{}\n{}", said[1], said[2]);
    for word in ["condition number", "observability: singular values", "+-", "one image tells"] {
        assert!(said[1].contains(word), "{word}:\n{}", said[1]);
    }
    let task = "state = [\"z\", \"theta_x\", \"theta_y\"]";
    assert!(said[2].contains(task), "{}", said[2]);

    let log = ["identify", "jacobian", "jacobian.mcap", "--threshold", "110", "--json"];
    let found: Value =
        serde_json::from_str(&taktil(folder.path(), &log).expect_code(0).out).unwrap();
    // A dome of 80 mm: a fixed body shifts the image by 1/pitch columns per mm, a rotation of the
    // finger by R/pitch per rad, and both by a little less because the rubber yields.
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
    // Stiffness of the servo at the finger.
    let (press, error) = entry(&found, "m0", "z");
    let due = counts_per_mm([0.0, 45.0, -162.0, -180.0, 63.0, 180.0], 0.0);
    assert!((press - due).abs() < 0.2 * due && error < 0.4 * press, "{press} +- {error}, {due}");
    // Two of the five motions are combinations of the others, and the rotation about z is not
    // visible.
    let state = found["state"].as_array().unwrap();
    assert!(state.len() == 3 && !state.contains(&"theta_z".into()), "{state:?}");
    assert!(found["condition"].as_f64().unwrap() < 100.0);
}

/// Change of the sum of counts for a millimetre of commanded motion along z: the stiffness of the
/// servo at the finger in this pose (deg), in series with the compliance of the contact (mm/N). The
/// finger is free to move sideways.
fn counts_per_mm(pose_deg: [f64; 6], contact_mm_n: f64) -> f64 {
    let robot = Robot::puma260();
    let spring = Config::default().tuning(&robot).unwrap().gains().kp_nm_rad;
    let geometry = robot.arm.jacobian_tool(&Joints::from(pose_deg.map(f64::to_radians)));
    let along = geometry.row(2);
    let arm_m_n: f64 = (0..6).map(|j| along[j] * along[j] / spring[j]).sum();
    4095.0 / 4.0 / (1e3 * arm_m_n + contact_mm_n)
}

/// The Jacobian's entry of the sum by z, from the scene with another body and this factor on the
/// friction of the joints.
fn press(folder: &Folder, body: &str, friction: f64) -> (f64, f64) {
    let scene = std::fs::read_to_string(scenes().join("identify-jacobian.toml")).unwrap();
    let from = scene.find("[world.pin]").unwrap();
    let to = scene.find("[[operator]]").unwrap();
    let machine = scenes().join("machine/puma260.toml");
    let text = format!("{}{body}\n{}", &scene[..from], &scene[to..])
        .replace("machine/puma260.toml", machine.to_str().unwrap())
        + &format!("\n[world.arm]\ncoulomb_scale = {friction:.1}\n");
    std::fs::write(folder.join("scene.toml"), text).unwrap();
    taktil(folder.path(), &["run", "scene.toml", "--fast", "--log", "b.mcap"]).expect_code(0);
    let words = ["identify", "jacobian", "b.mcap", "--threshold", "110", "--state", "z", "--json"];
    let found: Value =
        serde_json::from_str(&taktil(folder.path(), &words).expect_code(0).out).unwrap();
    entry(&found, "m0", "z")
}

#[test]
fn the_force_by_z_is_identified_despite_joint_friction() {
    let folder = Folder::new();
    let object = "[world.pin]\npresent = false\n\n[[world.object]]\n";
    let bar = format!("{object}kind = \"bar\"\nwidth_mm = 4.0\nlength_mm = 20.0\nfriction = 0.3\n");
    let edge =
        format!("{object}kind = \"edge\"\nradius_mm = 3.0\nlength_mm = 160.0\nfriction = 0.2\n");
    // The pin of E1 rolls, so nothing holds the finger sideways: arm and pad are in series.
    let layer = Layer::new(0.8, 2.0, 0.49).unwrap();
    let line = LineContact::new(&layer, 23.0, 0.16).unwrap();
    let deep = line.penetration_mm(20_000.0 * 4.0 / 4095.0 / 25.4);
    let pad_n_mm = 25.4 * (line.load_n_mm(deep + 1e-4) - line.load_n_mm(deep - 1e-4)) / 2e-4;
    let pin = counts_per_mm([0.0, 45.0, -162.0, -180.0, 63.0, 180.0], 1.0 / pad_n_mm);
    let bodies = [
        ("pin", "[world.pin]\nradius_mm = 23.0\nx_mm = 0.0\n".to_owned(), Some(pin)),
        ("bar", bar, None),
        ("edge", edge, None),
    ];
    for (name, body, due) in bodies {
        let (found, error) = press(&folder, &body, 1.0);
        // In other cases the result has to equal that of an arm without joint friction.
        let due = due.unwrap_or_else(|| press(&folder, &body, 0.0).0);
        println!("{name}: {found:.0} +- {error:.0} counts a mm, due {due:.0}");
        assert!((found - due).abs() < 0.15 * due, "{name}: {found}, due {due}");
        assert!((found - due).abs() < error && error < 0.4 * due, "{name}: {found} +- {error}");
    }
}

#[test]
fn logs_and_names_that_tell_nothing_are_refused() {
    let folder = Folder::new();
    let scene = scenes().join("roll-pin.toml");
    let run = ["run", scene.to_str().unwrap(), "--fast", "--for", "0.5", "--log", "a.mcap"];
    taktil(folder.path(), &run).expect_code(0);
    let ask = |more: &[&str]| {
        let words = [&["identify", "jacobian", "a.mcap"], more].concat();
        taktil(folder.path(), &words).expect_code(2).err
    };
    assert!(ask(&[]).contains("0 rests in contact"), "{}", ask(&[]));
    let named = ask(&["--state", "w"]);
    assert!(named.contains("--state w: there are x, y, z, theta_x"), "{named}");
    for bad in ["NaN", "inf", "1e300"] {
        let said = ask(&["--settle", bad]);
        assert!(said.contains("--settle") && said.contains("give 0 to 60"), "{said}");
    }
}
