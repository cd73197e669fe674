//! Pin and table of the simulated bench at one instant, as frames that a viewer places bodies in.

use glam::{DMat3, DQuat, DVec3};
use taktil_mechanics::Pose;

/// The height of a table that stands upright above a point is unknown: below this part of the
/// normal along z the table counts as upright.
const NORMAL_UPRIGHT_MAX: f64 = 1e-6;

/// Pin and table of the simulated bench at one instant, base frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BenchInstant {
    /// Centre of the pin (m).
    pub pin_m: DVec3,
    /// Direction of the pin's axis.
    pub pin_axis: DVec3,
    /// How far the pin has rolled about its axis (rad).
    pub pin_roll_rad: f64,
    /// The axes of the table, its normal last.
    pub table_axes: DMat3,
    /// Distance from the pin's centre to the tool along the table's normal while they touch (m).
    pub reach_m: Option<f64>,
}

impl BenchInstant {
    /// What the fields of the signal `world.truth` say of the bench, each by its name with all its
    /// numbers; `None` where one is missing, as it is for an arm without a bench.
    pub fn from_fields(field: impl Fn(&str) -> Vec<f64>) -> Option<BenchInstant> {
        let vector = |name: &str| match field(name)[..] {
            [x, y, z] => Some(DVec3::new(x, y, z)),
            _ => None,
        };
        let number = |name: &str| field(name).first().copied();
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

    /// The pin's frame in the base frame: z along its axis, turned as it has rolled.
    #[must_use]
    pub fn pin(&self) -> Pose {
        let axis = self.pin_axis.normalize_or(DVec3::Y);
        let turn =
            DQuat::from_rotation_arc(DVec3::Z, axis) * DQuat::from_rotation_z(self.pin_roll_rad);
        Pose::new(DMat3::from_quat(turn), self.pin_m)
    }

    /// The table's frame in the base frame: its normal is z, its origin lies `radius_m` below the
    /// pin's height, above or below the point `below` of the base frame (m).
    #[must_use]
    pub fn table(&self, radius_m: f64, below: DVec3) -> Pose {
        let normal = self.table_axes.z_axis;
        let touched = self.pin_m - radius_m * normal;
        // The height at which the plane passes the vertical through `below`; a table that stands
        // upright has none.
        let along = below - touched;
        let rise = if normal.z.abs() > NORMAL_UPRIGHT_MAX {
            -(normal.x * along.x + normal.y * along.y) / normal.z
        } else {
            0.0
        };
        let origin = DVec3::new(below.x, below.y, touched.z + rise);
        Pose::new(self.table_axes, origin)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fields(name: &str) -> Vec<f64> {
        match name {
            "pin_m" => vec![0.3, 0.1, 0.012],
            "pin_axis" => vec![0.0, 1.0, 0.0],
            "tool_m" => vec![0.3, 0.1, 0.022],
            "in_contact" => vec![1.0],
            "table_pan_rad" | "table_tilt_y_rad" | "table_tilt_x_rad" | "pin_roll_rad" => vec![0.0],
            _ => Vec::new(),
        }
    }

    #[test]
    fn the_table_lies_a_radius_below_the_pin_and_an_arm_without_a_bench_has_none() {
        let bench = BenchInstant::from_fields(fields).expect("all fields are there");
        assert!((bench.reach_m.unwrap() - 0.01).abs() < 1e-12);
        let table = bench.table(0.01, DVec3::new(0.5, 0.0, 3.0));
        assert!((table.translation - DVec3::new(0.5, 0.0, 0.002)).length() < 1e-12);
        assert!((bench.pin().rotation.z_axis - DVec3::Y).length() < 1e-12);
        let lacking = |name: &str| if name == "tool_m" { Vec::new() } else { fields(name) };
        assert_eq!(BenchInstant::from_fields(lacking), None);
    }
}
