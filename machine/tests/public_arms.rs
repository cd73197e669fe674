//! Robot descriptions as they are found in public: half-written shapes, joints without limits,
//! grippers and second arms. Each line of them that says nothing about motion changes nothing.

use std::path::PathBuf;

use taktil_machine::source::Source;
use taktil_machine::urdf::{ArmDescription, Lacks, Selection, locate, read};
use taktil_mechanics::spatial::JointVector;

/// An arm of six joints with so much behind its first link, and before its end.
fn text(behind_link1: &str, before_end: &str) -> String {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../sim/arms/ur5e-like.urdf");
    let text = std::fs::read_to_string(path).unwrap();
    let link = "<link name=\"link1\">";
    assert!(text.contains(link));
    text.replacen(link, &format!("{link}\n{behind_link1}\n"), 1).replacen(
        "</robot>",
        &format!("{before_end}\n</robot>"),
        1,
    )
}

fn to_tool(text: &str) -> ArmDescription {
    read(text, &Selection::to(Some("tool"))).unwrap_or_else(|bad| panic!("{bad:?} in {text}"))
}

/// The same arm, whatever was remarked.
fn plain(described: ArmDescription) -> ArmDescription {
    ArmDescription { notes: Vec::new(), ..described }
}

#[test]
fn what_is_no_motion_refuses_no_file() {
    let whole = to_tool(&text("", ""));
    for line in [
        r#"<visual><geometry><mesh scale="1 1 1"/></geometry></visual>"#,
        r#"<visual><material name="a"/><material name="b"/></visual>"#,
        r#"<visual><geometry><box size="1"/></geometry></visual>"#,
        r#"<visual><material><color rgba="1 0 0"/></material></visual>"#,
        r#"<visual><geometry><mesh filename="a.stl" scale="0.001"/></geometry></visual>"#,
        r#"<visual><geometry><cylinder radius="1"/><box/></geometry></visual>"#,
        r"<visual><geometry></geometry></visual><visual><origin xyz='0 0'/></visual>",
        r"<collision><geometry><sphere radius='much'/></geometry></collision>",
        r"<inertial/>",
        r"<!-- two -- hyphens, and --- three ---><!--->-->",
        r"Pick & place ]]>",
        r"<![CDATA[<joint name='x'>]]>",
        r"<origin/><mass/><inertia/><parent/>",
    ] {
        assert_eq!(plain(to_tool(&text("", line))), whole, "{line}");
        // A second <inertial> is passed over, as other readers do; a first one would count.
        if !line.contains("<inertial/>") {
            assert_eq!(plain(to_tool(&text(line, ""))), whole, "{line}");
        }
    }
    for element in [
        "<gazebo reference='link1'><mu1>0.2</mu1><plugin filename='a.so'>a & b</plugin></gazebo>",
        "<transmission name='t'><joint name='joint1'/><actuator name='m'/></transmission>",
        "<material/><material name='a'/><material name='a'><texture/></material>",
        "<sensor:camera sensor:rate='30'><sensor:eye/></sensor:camera>",
        "<ros2_control name='x' type='system'><hardware/></ros2_control>",
        "<link_attached/><limit lower='nan'/><joints/>",
    ] {
        assert_eq!(plain(to_tool(&text("", element))), whole, "{element}");
    }
    let declared = format!("<?xml version='1.0'?><!DOCTYPE robot>\n{}", text("", ""));
    assert_eq!(to_tool(&declared.replace("<?xml version=\"1.0\"?>", "")), whole);
}

#[test]
fn defaults_are_those_of_the_format_and_repetitions_are_told() {
    let whole = to_tool(&text("", ""));
    let limit = r#"<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>"#;
    let twice = to_tool(&text("", "").replacen("</joint>", limit, 1));
    assert_eq!(plain(twice.clone()), whole);
    assert!(twice.notes[0].contains("a second <limit> is not read"), "{:?}", twice.notes);
    // Without an inertia it is a point mass; without a mass nothing.
    let point = to_tool(&text("<inertial><mass value='2'/><origin xyz='0 0 0.1'/></inertial>", ""));
    assert_eq!(point.joints[0].body.mass_kg, 2.0);
    assert!(point.notes.iter().any(|note| note.contains("a point mass")), "{:?}", point.notes);
    let none = to_tool(&text("<inertial><origin xyz='0 0 0.1'/></inertial>", ""));
    assert!(none.massless.contains(&"link1".to_owned()), "{:?}", none.massless);
    assert!(none.notes.iter().any(|note| note.contains("taken as 0 kg")), "{:?}", none.notes);
}

#[test]
fn a_speed_or_effort_of_zero_is_not_known() {
    for zero in ["0", "0.0", "-0"] {
        let unknown = text("", "").replacen("effort=\"150\"", &format!("effort=\"{zero}\""), 1);
        let lacks = Lacks { effort: true, ..Lacks::default() };
        assert_eq!(to_tool(&unknown).lacks[0], lacks, "{zero}");
    }
    let negative = text("", "").replacen("effort=\"150\"", "effort=\"-150\"", 1);
    let bad = read(&negative, &Selection::to(Some("tool"))).unwrap_err();
    assert!(bad.place == "joint1" && bad.what.contains("`effort` is -150"), "{bad:?}");
}

const GRIPPER: &str = r#"<link name="finger"><inertial><mass value="0.5"/>
  <inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial></link>
  <joint name="slide" type="prismatic"><parent link="tool"/><child link="finger"/>
  <axis xyz="0 2 0"/><limit lower="0.01" upper="0.04" effort="20" velocity="0.2"/></joint>
  <link name="other"/><joint name="follower" type="prismatic"><parent link="tool"/>
  <child link="other"/><limit lower="-1" upper="1" effort="0" velocity="0"/>
  <mimic joint="slide" multiplier="-2" offset="0.1"/></joint>
  <link name="ball"/><joint name="free" type="floating"><parent link="base"/>
  <child link="ball"/></joint>"#;

#[test]
fn joints_beside_the_chain_are_held_and_their_bodies_welded() {
    let text = text("", GRIPPER);
    let refused = read(&text, &Selection::to(Some("tool"))).unwrap_err();
    assert!(refused.place == "slide" && refused.remedy.contains("hold"), "{refused:?}");
    let held = |hold: &[(&str, f64)], hold_others: bool| {
        let hold = hold.iter().map(|(name, at)| ((*name).to_owned(), *at)).collect();
        read(
            &text,
            &Selection { tip: Some("tool".into()), hold, hold_others, ..Selection::default() },
        )
    };
    let named = held(&[("slide", 0.02), ("follower", 0.0), ("free", 0.0)], false).unwrap();
    let others = held(&[("slide", 0.02)], true).unwrap();
    assert_eq!(named.joints, others.joints);
    // The follower stays where it follows the held joint to.
    for (joint, (name, at)) in
        others.held.iter().zip([("slide", 0.02), ("follower", 0.06), ("free", 0.0)])
    {
        assert!(joint.name == name && (joint.at - at).abs() < 1e-12, "{joint:?}");
    }
    let nearest = held(&[], true).unwrap();
    assert_eq!(nearest.held[0].at, 0.01, "the limit nearest to zero");
    // The finger's half kilogram stands 20 mm along y of the tool.
    let bare = to_tool(&self::text("", ""));
    let (with, without) = (&others.joints[5].body, &bare.joints[5].body);
    let added = with.mass_kg - without.mass_kg;
    let moment = with.com_m * with.mass_kg - without.com_m * without.mass_kg;
    let expected = bare.tool.apply(glam::DVec3::new(0.0, 0.02, 0.0)) * 0.5;
    assert!((added - 0.5).abs() < 1e-12 && moment.abs_diff_eq(expected, 1e-12), "{moment}");
    for (name, at, says) in [
        ("slide", 0.05, "outside its limits"),
        ("slide", f64::NAN, "is held at NaN"),
        ("free", 1.0, "several directions"),
        ("finger", 0.0, "no joint `finger`"),
    ] {
        let bad = held(&[(name, at)], true).unwrap_err();
        assert!(bad.what.contains(says), "{bad:?}");
    }
    let flat = text.replacen("<axis xyz=\"0 2 0\"/>", "<axis xyz=\"0 0 0\"/>", 1);
    let hold = [("slide".to_owned(), 0.02)].into();
    let selection =
        Selection { tip: Some("tool".into()), hold, hold_others: true, ..Selection::default() };
    let bad = read(&flat, &selection).unwrap_err();
    assert!(bad.place == "slide" && bad.what.contains("direction"), "{bad:?}");
}

#[test]
fn joints_of_the_way_are_held_where_they_are_named() {
    let whole = to_tool(&text("", "")).chain::<6>().unwrap();
    let hold = [("joint1".to_owned(), 0.3)].into();
    let held =
        Selection { tip: Some("tool".into()), hold, hold_others: false, ..Selection::default() };
    let five = read(&text("", ""), &held).unwrap().chain::<5>().unwrap();
    let q = JointVector::from([0.2, -0.4, 0.6, 0.1, -0.9]);
    let all = JointVector::from([0.3, 0.2, -0.4, 0.6, 0.1, -0.9]);
    let (one, other) = (whole.tool_pose(&all), five.tool_pose(&q));
    assert!(one.translation.abs_diff_eq(other.translation, 1e-14));
    assert!(one.rotation.abs_diff_eq(other.rotation, 1e-14));
    let (one, other) = (whole.gravity_torque(&all), five.gravity_torque(&q));
    assert!((0..5).all(|i| (one[i + 1] - other[i]).abs() < 1e-12), "{one} {other}");
}

#[test]
fn refusals_name_the_line_and_what_to_do() {
    for (from, to, says) in [
        ("<axis xyz=\"0 0 1\"/>", "<axis xyz=\"0, 0, 1\"/>", "give 3 numbers"),
        ("<axis xyz=\"0 0 1\"/>", "<axis xyz=\"0 1\"/>", "give 3 numbers"),
        ("type=\"revolute\"", "type=\"Revolute\"", "no type of joint `Revolute`"),
        ("effort=\"150\"", "effort=\"much\"", "`effort` is \"much\""),
        ("lower=\"-6.28318530718\"", "lower=\"7\"", "not below the upper"),
        ("<parent link=\"base\"/>", "", "has no <parent>"),
    ] {
        let text = text("", "");
        assert!(text.contains(from), "{from}");
        let said = refusal(&text.replacen(from, to, 1));
        assert!(said.contains("--> x.urdf:"), "{said}");
        assert!(said.contains(says) && said.contains("joint1"), "{said}");
    }
    // Whether or not its prefix is declared.
    let said = refusal(&text("", "<xacro:if value='1'/>"));
    assert!(said.contains("`xacro:if` is a macro of xacro"), "{said}");
}

fn refusal(text: &str) -> String {
    let source = Source { path: PathBuf::from("x.urdf"), text: text.to_owned() };
    let bad = read(&source.text, &Selection::to(Some("tool"))).unwrap_err();
    locate(&source, bad).to_string()
}
