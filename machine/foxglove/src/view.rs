//! Makes the messages of one robot from its values: joints, frames, the bodies of the simulated
//! bench, the links of the arm, and tactile images.

use glam::{DMat3, DVec3};
use taktil_mechanics::Pose;

use crate::arm::{ArmDrawing, BASE, TOOL};
use crate::bench::BenchInstant;
use crate::messages::{
    Body, Colour, Entity, GreyImage, JointReading, Transform, WallTime, joint_states, scene,
    transforms,
};

/// The signal with the measured joints.
pub const JOINTS_SIGNAL: &str = "sense.joints";
/// The signal with the torques that were applied.
pub const TORQUE_SIGNAL: &str = "actuate.applied";
/// The signal with what the simulator knows.
pub const TRUTH_SIGNAL: &str = "world.truth";
/// The payload of tactile images.
pub const IMAGE_TYPE: &str = "TactileImage";
/// Topic of `foxglove.JointStates`.
pub const JOINTS_TOPIC: &str = "/viewer/joints";
/// Topic of `foxglove.FrameTransforms`.
pub const FRAMES_TOPIC: &str = "/viewer/frames";
/// Topic of `foxglove.SceneUpdate` with pin, table and array.
pub const BODIES_TOPIC: &str = "/viewer/scene";
/// Topic of `foxglove.SceneUpdate` with the links of the arm.
pub const LINKS_TOPIC: &str = "/viewer/arm";
/// Topic of the description in URDF.
pub const DESCRIPTION_TOPIC: &str = "/robot_description";
/// Schema of the description, as ROS 2 names and describes it.
pub const DESCRIPTION_SCHEMA: &str = "std_msgs/msg/String";
/// The fields of that schema.
pub const DESCRIPTION_FIELDS: &str = "string data\n";
/// Name of the description as an attachment, and its media type.
pub const DESCRIPTION_FILE: &str = "robot.urdf";
/// Media type of the attachment.
pub const DESCRIPTION_MEDIA_TYPE: &str = "application/xml";

/// The frames of pin and table.
const PIN_FRAME: &str = "pin";
const TABLE_FRAME: &str = "table";
/// How long the pin is drawn (m).
const PIN_LENGTH_M: f64 = 0.12;
/// How large the table is drawn (m).
const TABLE_SIZE_M: DVec3 = DVec3::new(0.4, 0.3, 0.01);
/// How large a tactile array is drawn at the tool (m).
const ARRAY_SIZE_M: DVec3 = DVec3::new(0.0254, 0.0254, 0.003);
/// A plain CDR body in little-endian order: the four bytes in front of it.
const CDR_LITTLE_ENDIAN: [u8; 4] = [0, 1, 0, 0];
/// The brightest grey (8 bit).
const GREY_LEVEL_MAX: f64 = 255.0;

/// The values of all joints at one instant; what was not measured is empty.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JointValues<'a> {
    /// Angles (rad).
    pub q_rad: &'a [f64],
    /// Speeds (rad/s).
    pub qd_rad_s: &'a [f64],
    /// Torques (Nm).
    pub tau_nm: &'a [f64],
}

/// A robot as viewers see it.
#[derive(Clone, Debug)]
pub struct RobotView {
    arm: ArmDrawing,
    joint_names: Vec<String>,
    frame_names: Vec<String>,
    /// Radius of the pin (m), once it is known.
    pin_radius_m: Option<f64>,
    /// Where the pin was at first, base frame (m): the table lies there.
    first_pin_m: Option<DVec3>,
}

impl RobotView {
    /// An arm; of a bench nothing is known yet.
    #[must_use]
    pub fn new(arm: ArmDrawing) -> RobotView {
        let (joint_names, frame_names) = (arm.joint_names(), arm.frame_names());
        RobotView { arm, joint_names, frame_names, pin_radius_m: None, first_pin_m: None }
    }

    /// The arm.
    #[must_use]
    pub fn arm(&self) -> &ArmDrawing {
        &self.arm
    }

    /// The radius of the pin (m), from whoever knows it.
    pub fn set_pin_radius_m(&mut self, radius_m: f64) {
        self.pin_radius_m = Some(radius_m);
    }

    /// Takes in where pin and table are. True when bodies have come or changed by it, so that
    /// [`RobotView::bodies`] is to be sent anew.
    pub fn observe(&mut self, bench: &BenchInstant) -> bool {
        let had = (self.first_pin_m.is_some(), self.pin_radius_m.is_some());
        self.first_pin_m.get_or_insert(bench.pin_m);
        self.pin_radius_m = self.pin_radius_m.or(bench.reach_m);
        had != (true, self.pin_radius_m.is_some())
    }

    /// `foxglove.JointStates`.
    #[must_use]
    pub fn joints(&self, at: WallTime, values: JointValues<'_>) -> Vec<u8> {
        let readings: Vec<JointReading<'_>> = self
            .joint_names
            .iter()
            .zip(values.q_rad)
            .enumerate()
            .map(|(joint, (name, position_rad))| JointReading {
                name,
                position_rad: *position_rad,
                speed_rad_s: values.qd_rad_s.get(joint).copied(),
                torque_nm: values.tau_nm.get(joint).copied(),
            })
            .collect();
        joint_states(at, &readings)
    }

    /// `foxglove.FrameTransforms` of the links at joint angles (rad), and of pin and table where
    /// there is a bench.
    #[must_use]
    pub fn frames(&self, at: WallTime, q_rad: &[f64], bench: Option<&BenchInstant>) -> Vec<u8> {
        let mut places: Vec<Transform<'_>> = self
            .arm
            .steps(q_rad)
            .into_iter()
            .zip(self.frame_names.windows(2))
            .map(|(pose, pair)| Transform { parent: &pair[0], child: &pair[1], pose })
            .collect();
        if let (Some(bench), Some(below)) = (bench, self.first_pin_m) {
            let radius = self.pin_radius_m.unwrap_or(0.0);
            places.push(Transform { parent: BASE, child: PIN_FRAME, pose: bench.pin() });
            let table = bench.table(radius, below);
            places.push(Transform { parent: BASE, child: TABLE_FRAME, pose: table });
        }
        transforms(at, &places)
    }

    /// `foxglove.SceneUpdate` with pin, table and array, which keep their places in their frames;
    /// empty of entities where no bench was seen.
    #[must_use]
    pub fn bodies(&self, at: WallTime) -> Vec<u8> {
        let below = |size: DVec3| Pose::new(DMat3::IDENTITY, DVec3::new(0.0, 0.0, -size.z / 2.0));
        let mut bodies = Vec::new();
        if self.first_pin_m.is_some() {
            bodies.push(Entity {
                name: TABLE_FRAME,
                frame: TABLE_FRAME,
                place: below(TABLE_SIZE_M),
                body: Body::Cuboid(TABLE_SIZE_M),
                colour: Colour([0.55, 0.48, 0.38, 1.0]),
            });
            bodies.push(Entity {
                name: "array",
                frame: TOOL,
                place: below(ARRAY_SIZE_M),
                body: Body::Cuboid(ARRAY_SIZE_M),
                colour: Colour([0.13, 0.13, 0.15, 1.0]),
            });
        }
        if let (Some(radius_m), Some(_)) = (self.pin_radius_m, self.first_pin_m) {
            bodies.push(Entity {
                name: PIN_FRAME,
                frame: PIN_FRAME,
                place: Pose::IDENTITY,
                body: Body::Cylinder { radius_m, length_m: PIN_LENGTH_M },
                colour: Colour([0.88, 0.48, 0.1, 1.0]),
            });
        }
        scene(at, &bodies)
    }

    /// `foxglove.SceneUpdate` with a cylinder for each link, in the frame of the link: the same
    /// shapes as those of the description in URDF.
    #[must_use]
    pub fn links(&self, at: WallTime) -> Vec<u8> {
        let shapes = self.arm.link_shapes();
        let links = self.frame_names.iter().zip(shapes);
        let entities: Vec<Entity<'_>> = links
            .filter_map(|(name, shape)| {
                let (place, body) = shape?;
                let colour = Colour([0.6, 0.62, 0.66, 1.0]);
                Some(Entity { name, frame: name, place, body, colour })
            })
            .collect();
        scene(at, &entities)
    }
}

/// The topic of the `foxglove.RawImage` of a signal with tactile images, by the signal's own topic.
#[must_use]
pub fn image_topic(topic: &str) -> String {
    format!("/viewer{topic}")
}

/// The description of a robot as a message of `std_msgs/msg/String` in CDR; `None` for a text of
/// more than 4 GiB.
#[must_use]
pub fn description_message(urdf: &str) -> Option<Vec<u8>> {
    // A text in CDR: its length with the zero that ends it, and its bytes.
    let length = u32::try_from(urdf.len() + 1).ok()?;
    Some([&CDR_LITTLE_ENDIAN[..], &length.to_le_bytes(), urdf.as_bytes(), &[0]].concat())
}

/// `foxglove.RawImage` of a tactile array at the tool, row by row; black is no load, white the load
/// `white` (counts). `None` for an image without tactels, or with fewer counts than tactels.
#[must_use]
pub fn tactile_image(
    at: WallTime,
    rows: usize,
    cols: usize,
    counts: &[f64],
    white: f64,
) -> Option<Vec<u8>> {
    let tactels = rows.checked_mul(cols)?;
    // Only a damaged message says that it has more tactels than counts.
    if tactels == 0 || tactels > counts.len() {
        return None;
    }
    let grey = |count: &f64| (GREY_LEVEL_MAX * count / white).clamp(0.0, GREY_LEVEL_MAX) as u8;
    let pixels: Vec<u8> = counts.iter().take(tactels).map(grey).collect();
    let (cols, rows) = (u32::try_from(cols).ok()?, u32::try_from(rows).ok()?);
    Some(GreyImage { frame: TOOL, cols, rows, pixels: &pixels }.message(at))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arm() -> ArmDrawing {
        let up = Pose::new(DMat3::IDENTITY, DVec3::new(0.0, 0.0, 0.3));
        ArmDrawing {
            name: "two joints".into(),
            joint_origins: vec![up, up],
            tool: up,
            limits_rad: vec![(-1.0, 1.0); 2],
        }
    }

    #[test]
    fn bodies_are_due_when_the_bench_is_seen_and_again_when_the_pin_is_touched() {
        let mut view = RobotView::new(arm());
        let at = WallTime(5);
        let bare = view.bodies(at).len();
        assert_eq!(bare, 0, "nothing is known of a bench");
        let mut bench = BenchInstant {
            pin_m: DVec3::X,
            pin_axis: DVec3::Y,
            pin_roll_rad: 0.0,
            table_axes: DMat3::IDENTITY,
            reach_m: None,
        };
        assert!(view.observe(&bench) && !view.observe(&bench));
        let table = view.bodies(at).len();
        bench.reach_m = Some(0.01);
        assert!(view.observe(&bench) && !view.observe(&bench));
        assert!(view.bodies(at).len() > table && table > 0);
        assert!(view.frames(at, &[0.0; 2], Some(&bench)).len() > view.frames(at, &[], None).len());
    }

    #[test]
    fn images_are_scaled_to_white_and_damaged_ones_are_refused() {
        let image = tactile_image(WallTime(0), 1, 3, &[0.0, 50.0, 400.0], 100.0).unwrap();
        let has = |bytes: &[u8]| image.windows(bytes.len()).any(|at| at == bytes);
        assert!(has(&[0, 127, 255]), "{image:?}");
        for (rows, cols) in [(0, 3), (3, 0), (2, 2), (usize::MAX, 2)] {
            assert_eq!(tactile_image(WallTime(0), rows, cols, &[1.0; 3], 1.0), None);
        }
        // A count that is no number is black.
        assert!(tactile_image(WallTime(0), 1, 1, &[f64::NAN], 1.0).is_some());
    }

    #[test]
    fn a_description_ends_with_a_zero_behind_its_length() {
        assert_eq!(description_message("ab").unwrap(), [0, 1, 0, 0, 3, 0, 0, 0, b'a', b'b', 0]);
    }
}
