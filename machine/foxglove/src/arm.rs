//! The arm as a viewer draws it: frames of its links at given joint angles, and a description in
//! URDF with a cylinder for each link.

use std::fmt::Write as _;

use glam::{DMat3, DVec3, EulerRot};
use taktil_mechanics::Pose;

use crate::messages::Body;

/// Radius of a link as a part of the arm's length, as it is drawn.
const LINK_RADIUS_PARTS: f64 = 0.03;
/// The shortest link that is drawn, as a part of the arm's length.
const SHORTEST_LINK_PARTS: f64 = 0.01;
/// Name of the frame in which the arm stands.
pub(crate) const BASE: &str = "base";
/// Name of the frame of the tool.
pub(crate) const TOOL: &str = "tool";

/// What a drawing of an arm needs: frames at joint values zero, as a machine file gives them.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmDrawing {
    /// Name of the arm.
    pub name: String,
    /// The frame of each joint in that of the joint before, or in the base frame.
    pub joint_origins: Vec<Pose>,
    /// The tool frame in the frame of the last joint.
    pub tool: Pose,
    /// Smallest and largest angle of each joint (rad).
    pub limits_rad: Vec<(f64, f64)>,
}

impl ArmDrawing {
    /// Names of the joints, `joint1` and on; those of their frames are `link1` and on.
    pub(crate) fn joint_names(&self) -> Vec<String> {
        (1..=self.joint_origins.len()).map(|n| format!("joint{n}")).collect()
    }

    /// Names of the frames of the links, the base first and the tool last.
    pub(crate) fn frame_names(&self) -> Vec<String> {
        let links = (1..=self.joint_origins.len()).map(|n| format!("link{n}"));
        std::iter::once(BASE.to_owned()).chain(links).chain([TOOL.to_owned()]).collect()
    }

    /// Each frame in the frame before it, at joint angles (rad), the tool last: one more than there
    /// are joints. An angle that is missing is 0.
    pub(crate) fn steps(&self, q_rad: &[f64]) -> Vec<Pose> {
        let turned = self.joint_origins.iter().enumerate().map(|(joint, origin)| {
            let turn = DMat3::from_rotation_z(q_rad.get(joint).copied().unwrap_or(0.0));
            Pose::new(origin.rotation * turn, origin.translation)
        });
        turned.chain([self.tool]).collect()
    }

    /// The shape of each link in its own frame, the base first and the tool last: a cylinder to the
    /// origin of the next frame, or nothing where that is too near.
    pub(crate) fn link_shapes(&self) -> Vec<Option<(Pose, Body)>> {
        let frames = || self.joint_origins.iter().chain([&self.tool]);
        let reach: f64 = frames().map(|frame| frame.translation.length()).sum();
        frames().map(|frame| link_shape(frame.translation, reach)).chain([None]).collect()
    }

    /// The arm in URDF. A link is a cylinder from its frame to the origin of the next one.
    #[must_use]
    pub fn urdf(&self) -> String {
        let frames: Vec<Pose> = self.joint_origins.iter().copied().chain([self.tool]).collect();
        let names = self.frame_names();
        let shapes = self.link_shapes();
        let mut text = format!("<?xml version=\"1.0\"?>\n<robot name=\"{}\">\n", xml(&self.name));
        for (index, name) in names.iter().enumerate() {
            text.push_str(&link(name, shapes.get(index).and_then(Option::as_ref)));
        }
        for (index, frame) in frames.iter().enumerate() {
            let kind = if index < self.joint_origins.len() { "revolute" } else { "fixed" };
            let name =
                if kind == "fixed" { TOOL.to_owned() } else { format!("joint{}", index + 1) };
            let (roll, pitch, yaw) = roll_pitch_yaw(&frame.rotation);
            let at = frame.translation;
            let (parent, child) = (&names[index], &names[index + 1]);
            // A string takes everything that is written to it.
            let _ = write!(
                text,
                "  <joint name=\"{name}\" type=\"{kind}\">\n    <parent link=\"{parent}\"/>\n    \
                 <child link=\"{child}\"/>\n    <origin xyz=\"{} {} {}\" rpy=\"{roll} {pitch} \
                 {yaw}\"/>\n",
                at.x, at.y, at.z
            );
            if let Some((low, high)) = self.limits_rad.get(index) {
                let _ = write!(
                    text,
                    "    <axis xyz=\"0 0 1\"/>\n    <limit lower=\"{low}\" upper=\"{high}\" \
                     effort=\"0\" velocity=\"0\"/>\n"
                );
            }
            text.push_str("  </joint>\n");
        }
        text.push_str("</robot>\n");
        text
    }
}

/// Angles about the fixed axes x, y and z, as `rpy` of URDF has them.
fn roll_pitch_yaw(rotation: &DMat3) -> (f64, f64, f64) {
    let (yaw, pitch, roll) = glam::DQuat::from_mat3(rotation).to_euler(EulerRot::ZYX);
    (roll, pitch, yaw)
}

/// A cylinder from the frame of a link to a point of it (m), unless that is too near.
fn link_shape(to: DVec3, reach: f64) -> Option<(Pose, Body)> {
    let length_m = to.length();
    if length_m < SHORTEST_LINK_PARTS * reach || length_m == 0.0 {
        return None;
    }
    let turn = DMat3::from_quat(glam::DQuat::from_rotation_arc(DVec3::Z, to / length_m));
    let body = Body::Cylinder { radius_m: LINK_RADIUS_PARTS * reach, length_m };
    Some((Pose::new(turn, to / 2.0), body))
}

/// A link in URDF, with its shape.
fn link(name: &str, shape: Option<&(Pose, Body)>) -> String {
    let Some((place, Body::Cylinder { radius_m: radius, length_m: length })) = shape else {
        return format!("  <link name=\"{name}\"/>\n");
    };
    let (middle, (roll, pitch, yaw)) = (place.translation, roll_pitch_yaw(&place.rotation));
    format!(
        "  <link name=\"{name}\">\n    <visual>\n      <origin xyz=\"{} {} {}\" rpy=\"{roll} \
         {pitch} {yaw}\"/>\n      <geometry><cylinder radius=\"{radius}\" \
         length=\"{length}\"/></geometry>\n      <material name=\"grey\"><color rgba=\"0.6 0.62 \
         0.66 1\"/></material>\n    </visual>\n  </link>\n",
        middle.x, middle.y, middle.z
    )
}

/// A text as an attribute of XML.
fn xml(text: &str) -> String {
    let escaped = |c: char| match c {
        '&' => "&amp;".to_owned(),
        '<' => "&lt;".to_owned(),
        '"' => "&quot;".to_owned(),
        c if c.is_control() => " ".to_owned(),
        c => c.to_string(),
    };
    text.chars().map(escaped).collect()
}
