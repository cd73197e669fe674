//! The true state of the bench, for reports and tests. The controller never sees it, because none
//! of it goes through a device.

use glam::DVec3;
use taktil_hal::Nanos;
use taktil_mechanics::{Joints, Pose};

use crate::contact::{Patch, Reaction};
use crate::geometry::ArrayGeometry;
use crate::object::Objects;
use crate::pin::Pin;
use crate::rolling::RollingPin;
use crate::surroundings::Surroundings;
use crate::table::TablePose;

/// The true state of the bench at one instant, in the base frame unless stated otherwise. Contact
/// values are those of the latest evaluation: of the instant itself where devices were sampled,
/// else of at most one step earlier.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// The instant.
    pub t: Nanos,
    /// Joint angles of the PUMA 260 (rad); zero with a carriage and with another arm, whose joints
    /// are in [`World::joints`](crate::World::joints).
    pub q: Joints,
    /// Joint speeds (rad/s).
    pub qd: Joints,
    /// Tool point: the centre of the sensor's face (m).
    pub tool: DVec3,
    /// The sensor's x axis.
    pub tool_x: DVec3,
    /// The sensor's z axis, out of its face.
    pub tool_z: DVec3,
    /// Velocity of the tool point (m/s).
    pub tool_velocity: DVec3,
    /// Pin's centre (m).
    pub pin: DVec3,
    /// Pin's axis (unit vector).
    pub pin_axis: DVec3,
    /// Angle the pin has turned about its axis since the start (rad).
    pub pin_roll_rad: f64,
    /// Velocity of the pin's centre (m/s).
    pub pin_velocity: DVec3,
    /// Normal force between the finger and what it touches, pin and objects (N).
    pub finger_normal_n: f64,
    /// Normal force between table and pin (N).
    pub table_normal_n: f64,
    /// Force of the finger on the pin along the rolling direction and along its axis (N).
    pub finger_tangential_n: (f64, f64),
    /// Force of the table on the pin along the rolling direction and along its axis (N).
    pub table_tangential_n: (f64, f64),
    /// Wrench on the tool about the tool point in tool axes (N, N m).
    pub tool_wrench: Joints,
    /// Load-weighted place of the contact line on the pad in tactel numbers (1 to the number
    /// of columns are their centres); none without contact.
    pub contact_x_tactels: Option<f64>,
    /// Direction of the pin's axis about the sensor's z, from its y towards -x (rad): 0 along y.
    pub pin_yaw_rad: f64,
    /// Turn of the finger against the pin about the sensor's x (rad): 0 with the axis in the face's
    /// plane, positive when rows of high number are pressed more.
    pub tilt_rad: f64,
    /// Fastest sliding motion between finger and pin (m/s), 0 when every slice sticks.
    pub finger_slip_m_s: f64,
    /// Fastest sliding motion between table and pin (m/s).
    pub table_slip_m_s: f64,
    /// Motion of the pin's surface over the finger's rubber at the pin's middle, across and along
    /// the axis (m/s): creep while it sticks, sliding when it does not.
    pub finger_creep_m_s: (f64, f64),
    /// Motion of the pin's surface over the table's rubber at the pin's middle, across and along
    /// the axis (m/s).
    pub table_creep_m_s: (f64, f64),
    /// Ratio of creep across the axis to the speed of rolling, for finger and table; none at rest.
    pub creepage: Option<(f64, f64)>,
    /// Whether the finger touches the pin or an object.
    pub in_contact: bool,
    /// The object that presses most, or the scene's first; none without objects.
    pub object: Option<ObjectContact>,
    /// The fingertip opposed to the finger; none without one.
    pub opposed: Option<OpposedFingertip>,
    /// Whether a slice is pressed deeper than the theory of small strain covers.
    pub beyond_small_strain: bool,
    /// The table's coordinates.
    pub table: TablePose,
    /// Whether the fixture still holds the pin.
    pub fixture_active: bool,
    /// Instant at which the fixture released the pin.
    pub released: Option<Nanos>,
    /// Whether the drives put current into the motors.
    pub enabled: bool,
    /// Whether the brakes are on.
    pub braked: bool,
}

/// The contact of the finger with an object, in the sensor's axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ObjectContact {
    /// Normal force (N).
    pub normal_n: f64,
    /// Middle of the load from the middle of the pad, along x and y (m); 0 without contact.
    pub place_m: (f64, f64),
    /// Distance of an edge's line from the middle of the pad, positive towards the sensor's x (m);
    /// for a bar the x of its middle.
    pub off_m: f64,
    /// Direction of an edge or a bar about the sensor's z, from its y towards -x (rad).
    pub yaw_rad: f64,
    /// Length along an edge's curve, from its origin to the place nearest to the middle of the pad
    /// (m); for a bar the y of its middle.
    pub along_m: f64,
    /// Turn of the finger against a bar's face or an edge's line about the sensor's x and y (rad).
    /// It is positive about x when rows of high number are pressed more, and about y when columns
    /// of low number are. An edge has no turn about y, a sphere has none at all.
    pub tilt_rad: (f64, f64),
    /// Speed of sliding (m/s), 0 when it sticks.
    pub slip_m_s: f64,
}

impl ObjectContact {
    /// The contact with the object that the finger presses most; none without objects.
    pub(crate) fn of(objects: &Objects, surroundings: &Surroundings) -> Option<ObjectContact> {
        let (object, placement) = objects.most_loaded(surroundings)?;
        let middle = object.sums.middle().unwrap_or_default();
        Some(ObjectContact {
            normal_n: object.sums.load_n,
            place_m: middle.into(),
            off_m: placement.off_m,
            yaw_rad: placement.yaw_rad,
            along_m: placement.along_m,
            tilt_rad: placement.tilt_rad.into(),
            slip_m_s: object.slip_m_s,
        })
    }
}

/// The fingertip opposed to the finger, and the pin as its sensor sees it. Its normal and
/// tangential forces, slip and creep are reported as those of the table, in whose place it stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OpposedFingertip {
    /// Middle of its face (m, base frame).
    pub face: DVec3,
    /// Its x axis.
    pub face_x: DVec3,
    /// Its z axis, out of its face.
    pub face_z: DVec3,
    /// The same quantity as [`Truth::contact_x_tactels`], for this sensor.
    pub contact_x_tactels: Option<f64>,
    /// The same quantity as [`Truth::pin_yaw_rad`], for this sensor.
    pub pin_yaw_rad: f64,
    /// The same quantity as [`Truth::tilt_rad`], for this sensor.
    pub tilt_rad: f64,
}

impl OpposedFingertip {
    pub(crate) fn of(
        rolling: &RollingPin,
        surroundings: &Surroundings,
    ) -> Option<OpposedFingertip> {
        let opposed = rolling.opposed.as_ref()?;
        let pose = opposed.pose(&surroundings.table_axes, &surroundings.table);
        let (pin_yaw_rad, tilt_rad) = yaw_and_tilt(&rolling.pin, &pose);
        Some(OpposedFingertip {
            face: pose.translation,
            face_x: pose.rotation.x_axis,
            face_z: pose.rotation.z_axis,
            contact_x_tactels: contact_x_tactels(&rolling.support, &opposed.array),
            pin_yaw_rad,
            tilt_rad,
        })
    }
}

/// Load-weighted place along the sensor's x in tactel numbers.
pub(crate) fn contact_x_tactels(pad: &Patch, array: &ArrayGeometry) -> Option<f64> {
    let (mut load, mut moment) = (0.0, 0.0);
    for slice in pad.slices.iter() {
        load += slice.load_n;
        moment += slice.load_n * slice.x_m;
    }
    (load > 0.0).then(|| array.column_number(moment / load))
}

/// Speed of rolling below which creepage is not reported (m/s).
const ROLLING_M_S: f64 = 1e-4;

/// Ratio of creep across the axis to the speed of rolling, where both contacts roll.
pub(crate) fn creepage(finger: &Reaction, table: &Reaction) -> Option<(f64, f64)> {
    let rolls = |r: &Reaction| r.normal_n > 0.0 && r.travel_m_s.abs() > ROLLING_M_S;
    let of = |r: &Reaction| r.creep_m_s.0 / r.travel_m_s.abs();
    (rolls(finger) && rolls(table)).then(|| (of(finger), of(table)))
}

/// Yaw and tilt of a pin seen from the sensor, see [`Truth`].
pub(crate) fn yaw_and_tilt(pin: &Pin, pad: &Pose) -> (f64, f64) {
    let axis = pin.axis();
    let [x, y, z] = [pad.rotation.x_axis, pad.rotation.y_axis, pad.rotation.z_axis];
    let (x, y, z) = (axis.dot(x), axis.dot(y), axis.dot(z));
    let sign = if y < 0.0 { -1.0 } else { 1.0 };
    (libm::atan2(-sign * x, sign * y), libm::atan2(-sign * z, sign * y))
}
