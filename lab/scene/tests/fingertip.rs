//! Arms from URDF files that carry a fingertip: the scenes of the thesis are placed by the finger
//! on either of them, roll a pin, repeat to the last bit, and wrong mounts are refused at their key
//! with a remedy.

use std::path::{Path, PathBuf};

use taktil_lab_scene::assembly::Assembly;
use taktil_lab_scene::scene::Scene;
use taktil_lab_scene::score::{Figures, Score};
use taktil_lab_scene::{run_virtual, targets};
use taktil_machine::source::{FileKind, Located, Source};
use taktil_rtcore::Nanos;
use taktil_tasks_tactile_servo::config::law_name::LawName;

const ARMS: [&str; 2] = ["ur5e-like-touch", "seven-joints-touch"];
const SCENES: [&str; 9] = [
    "roll-pin",
    "tilted-y",
    "tilted-x",
    "panned",
    "rotated",
    "turning-y",
    "turning-x",
    "panning",
    "slid",
];

fn scenes() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../sim/scenes")
}

fn machine_file(arm: &str) -> PathBuf {
    scenes().join(format!("machine/{arm}.toml"))
}

fn loaded(scene: &str, arm: &str) -> Result<Scene, Located> {
    Scene::load_with_machine(&scenes().join(format!("{scene}.toml")), &machine_file(arm))
}

/// The rolling scene on the arm like the UR5e, with one piece of the machine file changed.
fn changed(from: &str, to: &str) -> Result<Scene, Located> {
    let mut machine = Source::read(&machine_file("ur5e-like-touch"), FileKind::Machine)?;
    assert!(machine.text.contains(from), "{from}");
    machine.text = machine.text.replace(from, to);
    let scene = Source::read(&scenes().join("roll-pin.toml"), FileKind::Scene)?;
    let read = |name: &str| {
        Source::read_beside(&scenes(), name, FileKind::Motion).map_err(|error| error.what)
    };
    Scene::of(scene, Some(machine), &read)
}

#[test]
fn the_finger_stands_where_every_scene_puts_it() {
    for arm in ARMS {
        for name in SCENES {
            let (puma, scene) =
                (Scene::load(&scenes().join(format!("{name}.toml"))), loaded(name, arm));
            let (puma, scene) = (puma.unwrap(), scene.unwrap_or_else(|bad| panic!("{arm}: {bad}")));
            let pose = |scene: &Scene| {
                let q: Vec<f64> = scene.start_deg.iter().map(|q| q.to_radians()).collect();
                scene.robot.tool_pose(&q).unwrap()
            };
            let (there, here) = (pose(&puma), pose(&scene));
            assert!((there.translation - here.translation).length() < 1e-8, "{arm} {name}");
            assert!(there.rotation.abs_diff_eq(here.rotation, 1e-8), "{arm} {name}");
            Assembly::new(&scene).build().unwrap_or_else(|bad| panic!("{arm} {name}: {bad}"));
        }
    }
}

/// A run of the first seconds of a scene: its figures, and the bits of the mean force error.
fn run(scene: &Scene, seconds: i64) -> (Figures, u64) {
    let mut machine = Assembly::new(scene).build().unwrap();
    let mut score = Score::new(&machine.catalog().clone(), targets(scene), scene.robot.clone());
    run_virtual(&mut machine, Nanos::from_secs(seconds), &mut score).unwrap();
    score.finish();
    let bits = score.figures.force_error_n.mean().unwrap_or(0.0).to_bits();
    (score.figures, bits)
}

#[test]
fn either_arm_rolls_the_pin_and_repeats_it_to_the_bit() {
    for arm in ARMS {
        let mut scene = loaded("roll-pin", arm).unwrap();
        scene.machine.tactile_servo.get_or_insert_default().law = LawName::Model;
        let (figures, bits) = run(&scene, 6);
        assert!(figures.rolled && figures.faults.is_empty(), "{arm}: {figures:?}");
        assert_eq!(figures.contact_lost, 0, "{arm}");
        let force_n = figures.force_n.mean().unwrap();
        assert!((force_n - 14.65).abs() < 0.75, "{arm}: {force_n} N");
        assert_eq!(run(&scene, 6).1, bits, "{arm}");
    }
}

#[test]
fn wrong_mounts_and_places_are_refused_with_their_remedy() {
    for (from, to, what, remedy) in [
        ("link = \"tool\"", "link = \"hand\"", "has no link `hand`", "name a link"),
        ("link = \"tool\"", "link = \"link4\"", "beside or behind", "name another tip"),
        ("z_axis = [0.0, 0.0, 1.0]", "z_axis = [0.0, 0.0, 2.0]", "has the length 2", "length 1"),
        ("z_axis = [0.0, 0.0, 1.0]", "z_axis = [1.0, 0.0, 0.0]", "x_axis", "right angle"),
        ("at_mm = [0.0, 0.0, 30.0]", "at_mm = [0.0, 0.0, 3000.0]", "is 3000", "at most 1000"),
        ("base_mm = [-273.0", "base_mm = [-2730.0", "cannot put its fingertip", "arm.base_mm"),
        ("base_mm = [-273.0", "base_mm = [nan", "is NaN", "either way"),
        ("base_yaw_deg = 180.0", "base_yaw_deg = 361.0", "is 361", "either way"),
        ("[joint_servo]", "[tactile_servo.array]\nrows = 65\n[joint_servo]", "is 65", "1 to 64"),
    ] {
        let refused = changed(from, to).and_then(|scene| Assembly::new(&scene).build().map(drop));
        let refused = refused.unwrap_err();
        assert!(refused.what.contains(what), "{to}: {refused}");
        assert!(refused.remedy.contains(remedy), "{to}: {refused}");
    }
}

#[test]
fn an_arm_without_a_fingertip_does_not_move_by_touch() {
    let (from, to) = ("[arm.fingertip]\nlink = \"tool\"", "[own.none]\nlink = \"tool\"");
    let refused = changed(from, to).unwrap_err();
    assert!(refused.what.contains("carries no fingertip"), "{refused}");
}
