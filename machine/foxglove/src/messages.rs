//! The well-known messages that a log for viewers holds, encoded.

use glam::{DQuat, DVec3};
use taktil_mechanics::Pose;

use crate::protobuf::Message;

/// Nanoseconds of a second.
const SECOND_NS: u64 = 1_000_000_000;

/// An instant of the wall clock, ns since 1970.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WallTime(pub u64);

impl WallTime {
    /// As `google.protobuf.Timestamp`.
    fn message(self) -> Message {
        Message::default().integer(1, self.0 / SECOND_NS).integer(2, self.0 % SECOND_NS)
    }
}

fn vector(value: DVec3) -> Message {
    Message::default().double(1, value.x).double(2, value.y).double(3, value.z)
}

fn quaternion(value: DQuat) -> Message {
    Message::default().double(1, value.x).double(2, value.y).double(3, value.z).double(4, value.w)
}

fn pose(value: &Pose) -> Message {
    Message::default()
        .message(1, vector(value.translation))
        .message(2, quaternion(DQuat::from_mat3(&value.rotation)))
}

/// A colour, red, green, blue and opacity from 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Colour(pub(crate) [f64; 4]);

impl Colour {
    fn message(self) -> Message {
        let channels = (1..).zip(self.0);
        channels.fold(Message::default(), |message, (field, value)| message.double(field, value))
    }
}

/// The place of a frame in another one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Transform<'a> {
    pub(crate) parent: &'a str,
    pub(crate) child: &'a str,
    pub(crate) pose: Pose,
}

/// `foxglove.FrameTransforms`.
pub(crate) fn transforms(at: WallTime, transforms: &[Transform<'_>]) -> Vec<u8> {
    let one = |transform: &Transform<'_>| {
        Message::default()
            .message(1, at.message())
            .bytes(2, transform.parent)
            .bytes(3, transform.child)
            .message(4, vector(transform.pose.translation))
            .message(5, quaternion(DQuat::from_mat3(&transform.pose.rotation)))
    };
    Message::default().repeated(1, transforms.iter().map(one)).into_bytes()
}

/// The state of one joint; what was not measured is left out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct JointReading<'a> {
    pub(crate) name: &'a str,
    pub(crate) position_rad: f64,
    pub(crate) speed_rad_s: Option<f64>,
    pub(crate) torque_nm: Option<f64>,
}

/// `foxglove.JointStates`.
pub(crate) fn joint_states(at: WallTime, joints: &[JointReading<'_>]) -> Vec<u8> {
    let one = |joint: &JointReading<'_>| {
        let state = Message::default().bytes(1, joint.name).double(2, joint.position_rad);
        let state = match joint.speed_rad_s {
            Some(speed) => state.double(3, speed),
            None => state,
        };
        match joint.torque_nm {
            Some(torque) => state.double(5, torque),
            None => state,
        }
    };
    let joints = joints.iter().map(one);
    Message::default().message(1, at.message()).repeated(2, joints).into_bytes()
}

/// A picture with a byte for each tactel, row by row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct GreyImage<'a> {
    pub(crate) frame: &'a str,
    pub(crate) cols: u32,
    pub(crate) rows: u32,
    pub(crate) pixels: &'a [u8],
}

impl GreyImage<'_> {
    /// `foxglove.RawImage`.
    pub(crate) fn message(&self, at: WallTime) -> Vec<u8> {
        Message::default()
            .message(1, at.message())
            .fixed32(2, self.cols)
            .fixed32(3, self.rows)
            .bytes(4, "mono8")
            .fixed32(5, self.cols)
            .bytes(6, self.pixels)
            .bytes(7, self.frame)
            .into_bytes()
    }
}

/// A body of a drawing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Body {
    /// A box with edges along the axes of its frame (m).
    Cuboid(DVec3),
    /// A cylinder along the z axis of its frame: radius and length (m).
    Cylinder { radius_m: f64, length_m: f64 },
}

/// A body that keeps its place in a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Entity<'a> {
    pub(crate) name: &'a str,
    pub(crate) frame: &'a str,
    pub(crate) place: Pose,
    pub(crate) body: Body,
    pub(crate) colour: Colour,
}

impl Entity<'_> {
    fn message(&self, at: WallTime) -> Message {
        let entity = Message::default()
            .message(1, at.message())
            .bytes(2, self.frame)
            .bytes(3, self.name)
            .integer(5, 1);
        let place = Message::default().message(1, pose(&self.place));
        match self.body {
            Body::Cuboid(size) => {
                let cube = place.message(2, vector(size)).message(3, self.colour.message());
                entity.message(8, cube)
            }
            Body::Cylinder { radius_m, length_m } => {
                let size = DVec3::new(2.0 * radius_m, 2.0 * radius_m, length_m);
                let cylinder = place
                    .message(2, vector(size))
                    .double(3, 1.0)
                    .double(4, 1.0)
                    .message(5, self.colour.message());
                entity.message(10, cylinder)
            }
        }
    }
}

/// `foxglove.SceneUpdate`.
pub(crate) fn scene(at: WallTime, entities: &[Entity<'_>]) -> Vec<u8> {
    let entities = entities.iter().map(|entity| entity.message(at));
    Message::default().repeated(2, entities).into_bytes()
}
