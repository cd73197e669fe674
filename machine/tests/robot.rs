//! `[arm]` of a machine file: valid and invalid combinations with a URDF file; errors name the
//! joint and the place.

use std::collections::BTreeMap;
use std::path::PathBuf;

use taktil_machine::robot::{AnyRobot, ArmConfig, ArmError, build, load};
use taktil_machine::source::Source;

fn arms() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../sim/arms")
}

fn ur5e() -> ArmConfig {
    ArmConfig {
        urdf: "ur5e-like.urdf".into(),
        tip: None,
        tips: Vec::new(),
        base_mm: None,
        base_yaw_deg: None,
        fingertip: None,
        hold: BTreeMap::new(),
        hold_others: false,
        limits_deg: None,
        speed_deg_s: None,
        effort_nm: None,
        home_deg: vec![0.0, -75.0, 90.0, -105.0, -90.0, 0.0],
        gear: vec![101.0; 6],
        counts_per_rev: vec![4096.0; 6],
        torque_constant_nm_a: vec![0.12; 6],
        current_max_a: vec![13.0; 6],
        dac_bits: 16,
        rotor_inertia_kg_m2: Some(vec![1e-4; 6]),
        coulomb_nm: None,
        viscous_nms_rad: Some(vec![1.0; 6]),
    }
}

/// The file with its third joint named `elbow`, and something changed.
fn elbow(from: &str, to: &str) -> Source {
    let text = std::fs::read_to_string(arms().join("ur5e-like.urdf")).unwrap();
    assert!(text.contains(from), "{from}");
    let text = text.replace("name=\"joint3\"", "name=\"elbow\"").replacen(from, to, 1);
    Source { path: "arm.urdf".into(), text }
}

fn complaint(config: &ArmConfig, urdf: &Source) -> String {
    match build(config, urdf).unwrap_err() {
        ArmError::Section(bad) => format!("{}: {}; {}", bad.place, bad.what, bad.remedy),
        ArmError::File(located) => located.to_string(),
    }
}

#[test]
fn a_file_and_its_motors_make_a_robot() {
    let (robot, urdf) = load(Some(&ur5e()), &arms()).unwrap();
    assert!(urdf.unwrap().text.contains("ur5e_like"));
    let AnyRobot::Six(six) = &robot else { panic!("{robot:?}") };
    assert_eq!((robot.joints(), robot.is_puma260()), (6, false));
    assert_eq!(robot.joint_label(2), "joint 3 (`joint3`)");
    // The motor delivers 0.12 * 13 * 101 = 157.6 N m; the file allows 150 and 28.
    assert_eq!((six.torque_max_nm[0], six.torque_max_nm[5]), (150.0, 28.0));
    assert!((six.arm.reflected_inertia()[0] - 1e-4 * 101.0 * 101.0).abs() < 1e-12);
    assert_eq!(six.friction.coulomb_nm.amax(), 0.0);
    let q = robot.home_rad();
    assert!(robot.tool_pose(&q).is_some() && robot.tool_pose(&q[..5]).is_none());
    assert_eq!(robot.gravity_nm(&q).unwrap().len(), 6);
    assert!(load(None, &arms()).unwrap().0.is_puma260());
}

#[test]
fn seven_joints_make_a_robot_of_seven() {
    let config = ArmConfig {
        urdf: "seven-joints.urdf".into(),
        home_deg: vec![0.0, -30.0, 0.0, -120.0, 0.0, 90.0, 45.0],
        gear: vec![100.0; 7],
        counts_per_rev: vec![4096.0; 7],
        torque_constant_nm_a: vec![0.1; 7],
        current_max_a: vec![9.0; 7],
        rotor_inertia_kg_m2: None,
        viscous_nms_rad: None,
        ..ur5e()
    };
    let (robot, _) = load(Some(&config), &arms()).unwrap();
    assert_eq!((robot.joints(), robot.joint_label(6).as_str()), (7, "joint 7 (`joint7`)"));
}

/// Selects one of the lists.
type List = fn(&mut ArmConfig) -> &mut Vec<f64>;

#[test]
fn lists_are_refused_with_their_place_and_the_joint() {
    let urdf = elbow("<robot", "<robot");
    let lists: [(&str, List); 7] = [
        ("gear", |c| &mut c.gear),
        ("counts_per_rev", |c| &mut c.counts_per_rev),
        ("torque_constant_nm_a", |c| &mut c.torque_constant_nm_a),
        ("current_max_a", |c| &mut c.current_max_a),
        ("rotor_inertia_kg_m2", |c| c.rotor_inertia_kg_m2.get_or_insert_default()),
        ("viscous_nms_rad", |c| c.viscous_nms_rad.get_or_insert_default()),
        ("home_deg", |c| &mut c.home_deg),
    ];
    for (place, of) in lists {
        for bad in [f64::NAN, f64::INFINITY, 1e9] {
            let mut config = ur5e();
            of(&mut config)[2] = bad;
            let text = complaint(&config, &urdf);
            assert!(text.starts_with(&format!("arm.{place}[2]: ")), "{text}");
            assert!(text.contains("joint 3 (`elbow`)"), "{text}");
        }
        for length in [0, 5, 7] {
            let mut config = ur5e();
            *of(&mut config) = vec![1.0; length];
            let text = complaint(&config, &urdf);
            assert!(text.starts_with(&format!("arm.{place}: has {length} numbers")), "{text}");
        }
        let mut config = ur5e();
        of(&mut config)[1] = -1e8;
        assert!(complaint(&config, &urdf).starts_with(&format!("arm.{place}[1]: ")));
    }
    for zero in ["gear", "counts_per_rev", "current_max_a"] {
        let (_, of) = lists.iter().find(|(place, _)| *place == zero).unwrap();
        let mut config = ur5e();
        of(&mut config)[0] = 0.0;
        assert!(complaint(&config, &urdf).starts_with(&format!("arm.{zero}[0]: 0 for joint 1")));
    }
    let text = complaint(&ArmConfig { dac_bits: 40, ..ur5e() }, &urdf);
    assert!(text.starts_with("arm.dac_bits: 40 bits"), "{text}");
    let fine = ArmConfig { counts_per_rev: vec![9e5; 6], gear: vec![200.0; 6], ..ur5e() };
    assert!(complaint(&fine, &urdf).contains("32 bits"));
    let weak = ArmConfig { current_max_a: vec![0.5; 6], ..ur5e() };
    let text = complaint(&weak, &urdf);
    assert!(text.contains("joint 2 (`joint2`) cannot hold itself at home"), "{text}");
}

#[test]
fn files_are_refused_at_their_line() {
    let config = ur5e();
    let text = complaint(&config, &elbow("type=\"revolute\"", "type=\"prismatic\""));
    assert!(text.contains("`joint1`: slides") && text.contains("arm.urdf:"), "{text}");
    let text = complaint(&config, &elbow("type=\"revolute\"", "type=\"fixed\""));
    assert!(text.contains("5 moving joints") && text.contains("6 and of 7"), "{text}");
    let text = complaint(&config, &elbow("velocity=\"3.14159265359\"", "velocity=\"0\""));
    assert!(text.starts_with("arm.speed_deg_s: the URDF file says none for joint 1"), "{text}");
    let text =
        complaint(&ArmConfig { tip: Some("hand".into()), ..ur5e() }, &elbow("<robot", "<robot"));
    assert!(text.contains("no link `hand`"), "{text}");
    let missing = ArmConfig { urdf: "none.urdf".into(), ..ur5e() };
    let Err(ArmError::Section(bad)) = load(Some(&missing), &arms()) else { panic!() };
    assert_eq!(bad.place, "arm.urdf");
}

#[test]
fn what_a_file_lacks_the_machine_file_gives() {
    let limit = "lower=\"-6.28318530718\" upper=\"6.28318530718\" effort=\"150\" \
                 velocity=\"3.14159265359\"";
    let bare = elbow(limit, "");
    let text = complaint(&ur5e(), &bare);
    assert!(text.starts_with("arm.limits_deg: the URDF file says none for joint 1"), "{text}");
    let given = ArmConfig {
        limits_deg: Some(vec![[-180.0, 180.0]; 6]),
        speed_deg_s: Some(vec![90.0; 6]),
        ..ur5e()
    };
    let AnyRobot::Six(six) = build(&given, &bare).unwrap() else { panic!() };
    assert!((six.torque_max_nm[0] - 0.12 * 13.0 * 101.0).abs() < 1e-9, "the motor's alone");
    let close = |x: f64, degrees: f64| (x - degrees.to_radians()).abs() < 1e-12;
    let limits = six.arm.limits();
    assert!(close(limits.q_max[5], 180.0) && close(limits.speed_max[5], 90.0));
    let weaker = ArmConfig { effort_nm: Some(vec![40.0; 6]), ..given.clone() };
    let AnyRobot::Six(six) = build(&weaker, &bare).unwrap() else { panic!() };
    assert_eq!(six.torque_max_nm[0], 40.0);
    for (wrong, place) in [
        (ArmConfig { limits_deg: Some(vec![[1.0, -1.0]; 6]), ..given.clone() }, "limits_deg[0]"),
        (ArmConfig { limits_deg: Some(vec![[-9e9, 1.0]; 6]), ..given.clone() }, "limits_deg[0]"),
        (ArmConfig { limits_deg: Some(vec![[-1.0, 1.0]; 5]), ..given.clone() }, "limits_deg: 5"),
        (ArmConfig { speed_deg_s: Some(vec![0.0; 6]), ..given.clone() }, "speed_deg_s[0]"),
        (ArmConfig { effort_nm: Some(vec![f64::NAN; 6]), ..given.clone() }, "effort_nm[0]"),
        (ArmConfig { effort_nm: Some(vec![1.0; 7]), ..given }, "effort_nm: has 7"),
    ] {
        let text = complaint(&wrong, &bare);
        assert!(text.starts_with(&format!("arm.{place}")), "{text}");
    }
}

#[test]
fn a_torque_that_depends_on_masses_needs_them() {
    let mut urdf = elbow("<robot", "<robot");
    while let Some(at) = urdf.text.find("<inertial>") {
        let end = urdf.text.find("</inertial>").unwrap() + "</inertial>".len();
        urdf.text.replace_range(at..end, "");
    }
    let light = ArmConfig { rotor_inertia_kg_m2: None, ..ur5e() };
    let text = complaint(&light, &urdf);
    assert!(text.starts_with("arm.urdf: joint 1 (`joint1`) moves nothing"), "{text}");
    assert!(build(&ur5e(), &urdf).is_ok(), "the rotors are what is moved");
}

#[test]
fn joints_are_held_by_the_machine_file() {
    let gripper = "<link name=\"finger\"/><joint name=\"slide\" type=\"prismatic\">\
                   <parent link=\"tool\"/><child link=\"finger\"/>\
                   <limit lower=\"0\" upper=\"0.04\" effort=\"20\" velocity=\"0.2\"/>\
                   </joint></robot>";
    let urdf = elbow("</robot>", gripper);
    let tool = ArmConfig { tip: Some("tool".into()), ..ur5e() };
    let text = complaint(&tool, &urdf);
    assert!(text.contains("`slide`: moves beside") && text.contains("[arm.hold]"), "{text}");
    let hold = |name: &str, at: f64| BTreeMap::from([(name.to_owned(), at)]);
    assert!(build(&ArmConfig { hold: hold("slide", 0.02), ..tool.clone() }, &urdf).is_ok());
    assert!(build(&ArmConfig { hold_others: true, ..tool.clone() }, &urdf).is_ok());
    let text = complaint(&ArmConfig { hold: hold("slyde", 0.02), ..tool.clone() }, &urdf);
    assert!(text.starts_with("arm.hold.slyde: `ur5e-like.urdf` has no joint"), "{text}");
    let text = complaint(&ArmConfig { hold: hold("slide", 2.0), ..tool }, &urdf);
    assert!(text.contains("outside its limits") && text.contains("0 to 0.04"), "{text}");
}
