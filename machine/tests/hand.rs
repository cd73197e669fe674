//! A hand from a URDF file with several tips: its fingers, and what is refused with its place.

use std::path::PathBuf;

use taktil_machine::robot::{AnyRobot, ArmConfig, ArmError, FingertipConfig, build};
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
    refusal_of("three-fingers", edit)
}

fn refusal_of(name: &str, edit: impl FnOnce(&mut ArmConfig)) -> (String, String) {
    let mut config = machine(&format!("{name}.toml"));
    edit(&mut config);
    match build(&config, &urdf(&format!("{name}.urdf"))).unwrap_err() {
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

fn name(c: &mut ArmConfig, tips: &[&str]) {
    c.tips = tips.iter().map(|tip| (*tip).to_owned()).collect();
}

#[test]
fn tips_behind_six_joints_that_all_of_them_share_make_a_hand_on_an_arm() {
    let config = machine("arm-with-three-fingers.toml");
    let urdf_file = urdf("arm-with-three-fingers.urdf");
    let robot = build(&config, &urdf_file).unwrap();
    assert!(robot.is_hand() && robot.joints() == 15 && robot.frames().joint_origins.len() == 9);
    assert_eq!(robot.joint_label(5), "joint 6 (`joint6`)");
    assert_eq!(robot.joint_label(6), "joint 7 (`finger1_spread`)");
    let AnyRobot::ThreeFingersOnArm(robot) = robot else { panic!("{robot:?}") };
    let palm = robot.arm.palm(&robot.home_rad).pose;
    assert!(palm.rotation.abs_diff_eq(glam::DMat3::IDENTITY, 1e-4), "{palm:?}");
    assert!(palm.translation.abs_diff_eq(glam::DVec3::new(-0.45, -0.1333, 0.3), 1e-4));
    for finger in 0..3 {
        let pose = robot.arm.fingertip(&robot.home_rad, finger).pose;
        let out = pose.translation - palm.translation;
        let out = glam::DVec3::new(out.x, out.y, 0.0);
        assert!((pose.rotation.z_axis.dot(out.normalize()) + 1.0).abs() < 1e-6, "{finger}");
        assert!((out.length() - 0.0405).abs() < 1e-4, "{finger}: {}", out.length());
    }
    // Every link weighs once: the arm's 17.7 kg, the palm's 0.6 kg, three fingers of 0.12 kg.
    let energy_j = |rise_m: f64| {
        let raised = robot.arm.standing_at(glam::DVec3::new(0.0, 0.0, rise_m), 0.0);
        raised.carrier().unwrap().potential_energy_j(&robot.home_rad)
    };
    let mass_kg = (energy_j(1.0) - energy_j(0.0)) / 9.81;
    assert!((mass_kg - 18.66).abs() < 1e-9, "{mass_kg}");
    // The drives of the fingers are theirs, and the arm stands where the section puts it.
    let inertia = robot.arm.carrier().unwrap().chains()[2].reflected_inertia();
    assert!((inertia[8] - 4e-3).abs() < 1e-15 && inertia[0] == 0.0, "{inertia}");
    let moved = ArmConfig { base_mm: Some([100.0, 0.0, 50.0]), ..config };
    let AnyRobot::ThreeFingersOnArm(moved) = build(&moved, &urdf_file).unwrap() else { panic!() };
    let way = moved.arm.palm(&moved.home_rad).pose.translation - palm.translation;
    assert!(way.abs_diff_eq(glam::DVec3::new(0.1, 0.0, 0.05), 1e-12), "{way}");
    let pair = build(&machine("arm-with-two-fingers.toml"), &urdf("arm-with-two-fingers.urdf"));
    assert!(matches!(pair.unwrap(), AnyRobot::TwoFingersOnArm(_)));
}

#[test]
fn tips_that_make_no_hand_on_an_arm_are_refused_with_their_place() {
    let refusal = |edit: &dyn Fn(&mut ArmConfig)| refusal_of("arm-with-three-fingers", edit);
    let third =
        |tip: &'static str| move |c: &mut ArmConfig| name(c, &["finger1_tip", "finger2_tip", tip]);
    let (place, what) = refusal(&third("link3"));
    assert_eq!(place, "arm.tips[2]");
    assert!(what.contains("`finger1_tip` after 3 joints"), "{what}");
    let (place, what) = refusal(&third("finger1_inner"));
    assert!(place == "arm.tips[2]" && what.contains("after 8 joints"), "{place} {what}");
    let (place, what) = refusal(&third("tool"));
    assert!(place == "arm.tips[2]" && what.contains("0 joints between the arm"), "{place} {what}");
    let (place, what) = refusal(&third("finger3_inner"));
    assert!(place == "arm.tips[2]" && what.contains("2 joints between the arm"), "{place} {what}");
    let (place, what) = refusal(&|c| c.hold = [("joint6".to_owned(), 0.0)].into());
    assert!(place == "arm.tips" && what.contains("share 5 joints"), "{place} {what}");
    assert_eq!(refusal(&|c| c.gear.truncate(14)).0, "arm.gear");
    assert_eq!(refusal(&|c| c.base_mm = Some([f64::NAN; 3])).0, "arm.base_mm[0]");
    assert_eq!(refusal(&|c| c.current_max_a[1] = 0.1).0, "arm.current_max_a[1]");
}

#[test]
fn tips_that_make_no_hand_are_refused_with_their_place() {
    assert_eq!(refusal(|c| c.tip = Some("finger1_tip".into())).0, "arm.tip");
    assert_eq!(refusal(|c| name(c, &["finger1_tip"])).0, "arm.tips");
    let (place, what) = refusal(|c| name(c, &["finger1_outer", "finger1_tip"]));
    assert!(place == "arm.tips" && what.contains("finger1_spread"), "{place} {what}");
    assert_eq!(refusal(|c| name(c, &["finger1_inner", "finger2_tip"])).0, "arm.tips[0]");
    assert_eq!(refusal(|c| c.gear = vec![10.0; 8]).0, "arm.gear");
    let fingertip = Some(FingertipConfig::default());
    assert_eq!(refusal(|c| c.fingertip = fingertip.clone()).0, "arm.fingertip");
    assert_eq!(refusal(|c| c.base_mm = Some([0.0; 3])).0, "arm.base_mm");
    assert_eq!(refusal(|c| c.base_yaw_deg = Some(90.0)).0, "arm.base_yaw_deg");
    assert!(refusal(|c| name(c, &["finger1_tip", "thumb"])).1.contains("thumb"));
}
