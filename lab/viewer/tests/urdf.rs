//! The description of a robot that a log carries describes that robot: it is read back and its
//! frames are compared.

use taktil_lab_viewer::ArmDrawing;
use taktil_machine::robot::AnyRobot;
use taktil_machine::urdf::{self, Selection};

fn drawing(robot: &AnyRobot, name: &str) -> ArmDrawing {
    let frames = robot.frames();
    ArmDrawing {
        name: name.to_owned(),
        joint_origins: frames.joint_origins,
        tool: frames.tool,
        limits_rad: robot.limits_rad(),
    }
}

/// Angles about fixed axes lose half of the digits where they are singular: 1e-7 rad.
const PLACE_TOLERANCE: f64 = 1e-7;

#[test]
fn a_description_that_is_written_is_read_as_the_same_arm() {
    let robot = AnyRobot::puma260();
    let drawing = drawing(&robot, "a \"puma\" & <more>");
    let read = urdf::read(&drawing.urdf(), &Selection::to(Some("tool"))).expect("it is read");
    assert_eq!(read.joints.len(), 6);
    for (joint, origin) in read.joints.iter().zip(&drawing.joint_origins) {
        assert!((joint.origin.translation - origin.translation).length() < PLACE_TOLERANCE);
        let turn = joint.origin.rotation * origin.rotation.transpose();
        assert!((turn - glam::DMat3::IDENTITY).abs_diff_eq(glam::DMat3::ZERO, PLACE_TOLERANCE));
    }
    assert!((read.tool.translation - drawing.tool.translation).length() < PLACE_TOLERANCE);
}

#[test]
fn a_drawing_without_extent_is_still_a_description() {
    let empty = ArmDrawing {
        name: String::new(),
        joint_origins: Vec::new(),
        tool: taktil_mechanics::Pose::IDENTITY,
        limits_rad: Vec::new(),
    };
    let text = empty.urdf();
    assert!(
        text.contains("<link name=\"base\"/>") && text.contains("<link name=\"tool\"/>"),
        "{text}"
    );
    assert!(!text.contains("NaN"), "{text}");
}
