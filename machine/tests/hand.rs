//! A hand from a URDF file with several tips: its fingers, and what is refused with its place.

use std::path::PathBuf;

use taktil_machine::robot::{AnyRobot, ArmConfig, ArmError, build};
use taktil_machine::source::{FileKind, Source};

fn machine(name: &str) -> ArmConfig {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../sim/scenes/machine").join(name);
    let text = std::fs::read_to_string(path).unwrap();
    let table: toml::Table = text.parse().unwrap();
    table["arm"].clone().try_into().unwrap()
}

fn urdf(name: &str) -> Source {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../sim/arms").join(name);
    Source::read(&path, FileKind::Arm).unwrap()
}

fn refusal(edit: impl FnOnce(&mut ArmConfig)) -> (String, String) {
    let mut config = machine("three-fingers.toml");
    edit(&mut config);
    match build(&config, &urdf("three-fingers.urdf")).unwrap_err() {
        ArmError::Section(bad) => (bad.place, bad.what),
        ArmError::File(located) => (String::new(), located.what.clone()),
    }
}

#[test]
fn three_tips_make_a_hand_of_nine_joints_whose_faces_look_inwards() {
    let robot = build(&machine("three-fingers.toml"), &urdf("three-fingers.urdf")).unwrap();
    assert!(robot.is_hand() && !robot.is_puma260());
    assert_eq!((robot.joints(), robot.joint_label(3).as_str()), (9, "joint 4 (`finger2_spread`)"));
    let AnyRobot::ThreeFingers(robot) = robot else { panic!("{robot:?}") };
    for finger in 0..3 {
        let pose = robot.arm.fingertip(&robot.home_rad, finger).pose;
        let out = glam::DVec3::new(pose.translation.x, pose.translation.y, 0.0);
        assert!((pose.rotation.z_axis.dot(out.normalize()) + 1.0).abs() < 1e-9, "{finger}");
        assert!((out.length() - 0.0405).abs() < 1e-4, "{finger}: {}", out.length());
    }
}

#[test]
fn two_tips_make_a_hand_of_six_joints() {
    let robot = build(&machine("two-fingers.toml"), &urdf("two-fingers.urdf")).unwrap();
    assert!(matches!(robot, AnyRobot::TwoFingers(_)) && robot.joints() == 6);
}

#[test]
fn tips_that_make_no_hand_are_refused_with_their_place() {
    let name = |c: &mut ArmConfig, tips: &[&str]| {
        c.tips = tips.iter().map(|tip| (*tip).to_owned()).collect();
    };
    assert_eq!(refusal(|c| c.tip = Some("finger1_tip".into())).0, "arm.tip");
    assert_eq!(refusal(|c| name(c, &["finger1_tip"])).0, "arm.tips");
    let (place, what) = refusal(|c| name(c, &["finger1_outer", "finger1_tip"]));
    assert!(place == "arm.tips" && what.contains("finger1_spread"), "{place} {what}");
    assert_eq!(refusal(|c| name(c, &["finger1_inner", "finger2_tip"])).0, "arm.tips[0]");
    assert_eq!(refusal(|c| c.gear = vec![10.0; 8]).0, "arm.gear");
    assert!(refusal(|c| name(c, &["finger1_tip", "thumb"])).1.contains("thumb"));
}
