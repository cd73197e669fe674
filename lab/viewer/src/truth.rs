//! Reads numbers of messages as they pass, without columns of the whole log in memory: joints,
//! torques, tactile images, and pin and table of the simulated bench.

use glam::{DMat3, DQuat, DVec3};
use taktil_mechanics::Pose;
use taktil_record::{Channel, FieldInfo};
use taktil_rtcore::payload::Primitive;

/// The numbers of one field of a message; empty for a field that the channel does not have.
pub(crate) fn numbers(channel: &Channel, field: &str, data: &[u8]) -> Vec<f64> {
    let found = channel.payload_fields().iter().find(|info| info.name == field);
    found.map_or_else(Vec::new, |info| (0..info.count).map(|at| number(info, at, data)).collect())
}

/// The first number of a field; `None` without it.
pub(crate) fn scalar(channel: &Channel, field: &str, data: &[u8]) -> Option<f64> {
    let info = channel.payload_fields().iter().find(|info| info.name == field)?;
    (info.count > 0).then(|| number(info, 0, data))
}

/// One element of a field; NaN behind the end of the message.
fn number(info: &FieldInfo, element: usize, data: &[u8]) -> f64 {
    let size = info.kind.size();
    let at = info.offset + element * size;
    let Some(bytes) = data.get(at..at + size) else { return f64::NAN };
    let mut word = [0; 8];
    word[..size].copy_from_slice(bytes);
    let bits = u64::from_le_bytes(word);
    match info.kind {
        Primitive::F64 => f64::from_bits(bits),
        Primitive::F32 => f64::from(f32::from_bits((bits & u64::from(u32::MAX)) as u32)),
        Primitive::I64 | Primitive::I32 | Primitive::I16 => {
            let unused = 64 - 8 * size;
            ((bits << unused).cast_signed() >> unused) as f64
        }
        _ => bits as f64,
    }
}

/// Pin and table of the simulated bench at one instant, base frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct BenchInstant {
    pub(crate) pin_m: DVec3,
    pub(crate) pin_axis: DVec3,
    pub(crate) pin_roll_rad: f64,
    /// The axes of the table, its normal last.
    pub(crate) table_axes: DMat3,
    /// Distance from the pin's centre to the tool along the table's normal while they touch (m).
    pub(crate) reach_m: Option<f64>,
}

impl BenchInstant {
    /// What the signal `world.truth` says of the bench; `None` for an arm without one.
    pub(crate) fn of(channel: &Channel, data: &[u8]) -> Option<BenchInstant> {
        let vector = |field: &str| match numbers(channel, field, data)[..] {
            [x, y, z] => Some(DVec3::new(x, y, z)),
            _ => None,
        };
        let number = |field: &str| scalar(channel, field, data);
        let (pin_m, pin_axis, tool_m) = (vector("pin_m")?, vector("pin_axis")?, vector("tool_m")?);
        let turn = DQuat::from_rotation_z(number("table_pan_rad")?)
            * DQuat::from_rotation_y(-number("table_tilt_y_rad")?)
            * DQuat::from_rotation_x(number("table_tilt_x_rad")?);
        let reach = (tool_m - pin_m).dot(turn * DVec3::Z);
        let touches = number("in_contact")? != 0.0 && reach > 0.0;
        Some(BenchInstant {
            pin_m,
            pin_axis,
            pin_roll_rad: number("pin_roll_rad")?,
            table_axes: DMat3::from_quat(turn),
            reach_m: touches.then_some(reach),
        })
    }

    /// The pin's frame: z along its axis, turned as it has rolled.
    pub(crate) fn pin(&self) -> Pose {
        let axis = self.pin_axis.normalize_or(DVec3::Y);
        let turn =
            DQuat::from_rotation_arc(DVec3::Z, axis) * DQuat::from_rotation_z(self.pin_roll_rad);
        Pose::new(DMat3::from_quat(turn), self.pin_m)
    }

    /// The table's frame: its normal is z, its origin lies `radius_m` below the pin's height, above
    /// or below the point `below` of the base frame.
    pub(crate) fn table(&self, radius_m: f64, below: DVec3) -> Pose {
        let normal = self.table_axes.z_axis;
        let touched = self.pin_m - radius_m * normal;
        // The height at which the plane passes the vertical through `below`; a table that stands
        // upright has none.
        let along = below - touched;
        let rise = if normal.z.abs() > 1e-6 {
            -(normal.x * along.x + normal.y * along.y) / normal.z
        } else {
            0.0
        };
        let origin = DVec3::new(below.x, below.y, touched.z + rise);
        Pose::new(self.table_axes, origin)
    }
}
