//! Place and motion of the table's surface: fixed values plus motions of two tilts, pan, slide and
//! height about a pivot. The motion is prescribed: no force moves the table.
//!
//! The surface frame is `Rz(pan) Ry(-tilt_y) Rx(tilt_x)` with its origin at the pivot `(pivot_x +
//! slide, pivot_y, height)`: a positive `tilt_y` raises the side towards +x, a positive `tilt_x`
//! the side towards +y, a positive pan turns x towards y.

use glam::{DMat3, DVec3};
use taktil_mechanics::spatial::{rotation_x, rotation_y, rotation_z};

use crate::contact::Surface;
use crate::motion::MotionProfile;
use crate::scene::{Axis, Motion, TableConfig};

/// The five coordinates of the table or their rates.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TablePose {
    /// Turn about the table's x axis (rad).
    pub tilt_x_rad: f64,
    /// Rise towards the table's +x (rad).
    pub tilt_y_rad: f64,
    /// Turn about z0 (rad).
    pub pan_rad: f64,
    /// Displacement along x0 (m).
    pub slide_m: f64,
    /// Height of the pivot (m).
    pub height_m: f64,
}

impl TablePose {
    fn add(&mut self, axis: Axis, degrees_or_mm: f64) {
        let (angle, length) = (degrees_or_mm.to_radians(), 1e-3 * degrees_or_mm);
        match axis {
            Axis::TiltX => self.tilt_x_rad += angle,
            Axis::TiltY => self.tilt_y_rad += angle,
            Axis::Pan => self.pan_rad += angle,
            Axis::Slide => self.slide_m += length,
            Axis::Height => self.height_m += length,
        }
    }
}

/// The table with all its motions.
#[derive(Clone, Debug)]
pub(crate) struct Table {
    start: TablePose,
    pivot: DVec3,
    motions: Vec<(Axis, MotionProfile)>,
    /// The surface of a table that never moves, computed once.
    still: Option<(TablePose, DMat3, Surface)>,
}

impl Table {
    pub(crate) fn new(config: &TableConfig, height_mm: f64) -> Table {
        let start = TablePose {
            tilt_x_rad: config.tilt_x_deg.to_radians(),
            tilt_y_rad: config.tilt_y_deg.to_radians(),
            pan_rad: config.pan_deg.to_radians(),
            slide_m: 1e-3 * config.slide_mm,
            height_m: 1e-3 * height_mm,
        };
        let pivot = 1e-3 * DVec3::new(config.pivot_x_mm, config.pivot_y_mm, 0.0);
        let course = |motion: &Motion| (motion.axis, MotionProfile::new(motion));
        let motions = config.motion.iter().map(course).collect();
        let mut table = Table { start, pivot, motions, still: None };
        if config.motion.is_empty() {
            table.still = Some(table.moving(0.0));
        }
        table
    }

    /// Coordinates, axes (columns: the table's x, y, normal) and surface at an instant (s).
    pub(crate) fn at(&self, t_s: f64) -> (TablePose, DMat3, Surface) {
        match self.still {
            Some(still) => still,
            None => self.moving(t_s),
        }
    }

    fn moving(&self, t_s: f64) -> (TablePose, DMat3, Surface) {
        let (mut pose, mut rate) = (self.start, TablePose::default());
        for (axis, course) in &self.motions {
            let (value, speed) = course.at(t_s);
            pose.add(*axis, value);
            rate.add(*axis, speed);
        }
        let pan = rotation_z(pose.pan_rad);
        let pan_tilt = pan * rotation_y(-pose.tilt_y_rad);
        let axes = pan_tilt * rotation_x(pose.tilt_x_rad);
        let spin = DVec3::Z * rate.pan_rad - pan.y_axis * rate.tilt_y_rad
            + pan_tilt.x_axis * rate.tilt_x_rad;
        let surface = Surface {
            origin: self.pivot + DVec3::new(pose.slide_m, 0.0, pose.height_m),
            normal: axes.z_axis,
            velocity: DVec3::new(rate.slide_m, 0.0, rate.height_m),
            spin,
        };
        (pose, axes, surface)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn height_at(table: &Table, t_s: f64, x: f64, y: f64) -> f64 {
        let (_, _, s) = table.at(t_s);
        let (dx, dy) = (x - s.origin.x, y - s.origin.y);
        s.origin.z - (s.normal.x * dx + s.normal.y * dy) / s.normal.z
    }

    #[test]
    fn positive_tilts_raise_the_positive_sides() {
        let mut config = TableConfig { tilt_y_deg: 8.0, ..TableConfig::default() };
        let table = Table::new(&config, -195.0);
        let rise = height_at(&table, 0.0, 0.425, -0.127) - height_at(&table, 0.0, 0.325, -0.127);
        assert!((rise - 0.1 * libm::tan(8.0_f64.to_radians())).abs() < 1e-12);
        config = TableConfig { tilt_x_deg: 4.0, ..TableConfig::default() };
        let table = Table::new(&config, -195.0);
        let rise = height_at(&table, 0.0, 0.325, -0.027) - height_at(&table, 0.0, 0.325, -0.127);
        assert!((rise - 0.1 * libm::tan(4.0_f64.to_radians())).abs() < 1e-12);
    }

    #[test]
    fn pan_turns_x_towards_y() {
        let table = Table::new(&TableConfig { pan_deg: 22.0, ..TableConfig::default() }, -195.0);
        let (_, axes, _) = table.at(3.0);
        assert!((libm::atan2(axes.x_axis.y, axes.x_axis.x) - 22.0_f64.to_radians()).abs() < 1e-12);
        assert!((axes.z_axis - DVec3::Z).length() < 1e-15);
    }

    #[test]
    fn the_velocity_is_the_derivative_of_the_pose() {
        let ramp = |axis, rate: f64| Motion::ramp(axis, rate, 1.0, 2.0);
        let motion = vec![
            ramp(Axis::TiltX, 3.0),
            ramp(Axis::TiltY, -5.0),
            ramp(Axis::Pan, 7.0),
            ramp(Axis::Slide, 11.0),
            ramp(Axis::Height, -2.0),
        ];
        let config =
            TableConfig { tilt_x_deg: 4.0, tilt_y_deg: 6.0, motion, ..TableConfig::default() };
        let table = Table::new(&config, -195.0);
        let (h, local) = (1e-6, DVec3::new(0.05, -0.03, 0.0));
        let point = |t: f64| {
            let (_, axes, s) = table.at(t);
            s.origin + axes * local
        };
        let difference = (point(1.5 + h) - point(1.5 - h)) / (2.0 * h);
        let (_, axes, s) = table.at(1.5);
        let exact = s.velocity + s.spin.cross(axes * local);
        assert!((difference - exact).length() < 1e-9, "{difference} {exact}");
        for t in [0.5, 2.5] {
            let (_, _, s) = table.at(t);
            assert_eq!((s.velocity, s.spin), (DVec3::ZERO, DVec3::ZERO));
        }
        let (pose, _, _) = table.at(9.0);
        assert!((pose.pan_rad - 7.0_f64.to_radians()).abs() < 1e-15);
    }
}
