//! Holds the two motions of the sensor that touch cannot see on a rolling pin: along its axis (y)
//! and about it (theta_y). Most laws command neither, but the arm gives way in both under load. The
//! encoders measure that drift, and a slow correction takes it back; it never moves the finger
//! otherwise.

use taktil_mechanics::spatial::Pose;
use taktil_rtcore::{Fold, StateHash};

/// Fastest correction along y (m/s).
const SPEED_MAX_M_S: f64 = 0.005;
/// Fastest correction about y (rad/s).
const TURN_MAX_RAD_S: f64 = 0.05;

/// Fastest giving way along y (m/s).
const YIELD_MAX_M_S: f64 = 0.03;

/// How one of the motions that touch cannot see is made.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum UnfeltMotion {
    /// The encoders hold it: drift is taken back.
    #[default]
    Held,
    /// The finger gives way to what pushes it, at this rate (1/s).
    Yielding(f64),
    /// The law commands this much (m or rad).
    Commanded(f64),
}

/// What a law leaves to the encoders.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EncoderMotions {
    /// Motion along x that stands for the law's own (m), when the law does not command x.
    pub x_m: Option<f64>,
    /// Along y.
    pub y: UnfeltMotion,
    /// About y; a law cannot let the finger give way about y, so `Yielding` holds it too.
    pub theta_y: UnfeltMotion,
}

/// How far the sensor has drifted since the law took over.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Drift {
    last: Option<Pose>,
    y_m: f64,
    theta_y_rad: f64,
}

impl Fold for Drift {
    fn fold(&self, hash: &mut StateHash) {
        hash.add(&self.y_m).add(&self.theta_y_rad).add(&self.last.is_some());
        if let Some(last) = &self.last {
            hash.add(&last.rotation.to_cols_array()).add(&last.translation.to_array());
        }
    }
}

impl Drift {
    /// Takes in the measured pose of the tool: the parts of its motion since the last call that lie
    /// along and about its own y axis add up.
    pub fn update(&mut self, tool: &Pose) {
        if !tool.is_finite() {
            return;
        }
        if let Some(last) = self.last.replace(*tool) {
            let moved = last.rotation.transpose() * (tool.translation - last.translation);
            let turned = last.rotation.transpose() * tool.rotation;
            self.y_m += moved.y;
            self.theta_y_rad += 0.5 * (turned.z_axis.x - turned.x_axis.z);
        }
    }

    /// The correction (dy in m, dtheta_y in rad) for a time `dt_s`, at `rate_per_s` of the drift.
    #[must_use]
    pub fn correction(&self, rate_per_s: f64, dt_s: f64) -> (f64, f64) {
        let share = (rate_per_s * dt_s).clamp(0.0, 1.0);
        let (speed, turn) = (SPEED_MAX_M_S * dt_s, TURN_MAX_RAD_S * dt_s);
        let y = (-share * self.y_m).clamp(-speed, speed);
        (y, (-share * self.theta_y_rad).clamp(-turn, turn))
    }
}

/// The step along y (m, in `dt_s`) that reduces, at `rate_per_s`, the distance of the desired pose
/// from the measured one. A pin that is pulled along its axis then takes the finger along; if the
/// finger resisted, the strain of both rubbers would grow until the contact slips.
#[must_use]
pub fn compliant_step_m(wanted: &Pose, tool: &Pose, rate_per_s: f64, dt_s: f64) -> f64 {
    let off = wanted.rotation.transpose() * (tool.translation - wanted.translation);
    let bound = YIELD_MAX_M_S * dt_s;
    let step = (rate_per_s * dt_s).clamp(0.0, 1.0) * off.y;
    if step.is_finite() { step.clamp(-bound, bound) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use taktil_mechanics::spatial::{rotation_x, rotation_y, rotation_z};

    /// A tool pose turned and moved in its own frame.
    fn moved(pose: &Pose, by: DVec3, turn: glam::DMat3) -> Pose {
        Pose::new(pose.rotation * turn, pose.apply(by))
    }

    #[test]
    fn commanded_motion_is_not_taken_for_drift() {
        let mut drift = Drift::default();
        let mut tool = Pose::new(rotation_x(2.0), DVec3::new(0.3, -0.1, -0.1));
        drift.update(&tool);
        for _ in 0..200 {
            let turn = rotation_x(1e-4) * rotation_z(-2e-4);
            tool = moved(&tool, DVec3::new(5e-5, 0.0, -1e-5), turn);
            drift.update(&tool);
        }
        assert!(drift.y_m.abs() < 1e-9 && drift.theta_y_rad.abs() < 5e-6, "{drift:?}");
    }

    #[test]
    fn giving_way_is_taken_back_at_the_rate_and_within_the_bounds() {
        let mut drift = Drift::default();
        let start = Pose::new(rotation_y(3.0), DVec3::ZERO);
        drift.update(&start);
        drift.update(&moved(&start, DVec3::new(0.0, 4e-4, 0.0), rotation_y(-2e-3)));
        let (y, theta) = drift.correction(4.0, 0.005);
        assert!((y + 8e-6).abs() < 1e-12 && (theta - 4e-5).abs() < 1e-9, "{y} {theta}");
        drift.update(&moved(&start, DVec3::new(0.0, 0.5, 0.0), rotation_y(0.5)));
        assert_eq!(drift.correction(4.0, 0.005), (-2.5e-5, -2.5e-4));
        assert_eq!(drift.correction(0.0, 0.005), (0.0, 0.0));
    }

    #[test]
    fn an_invalid_pose_changes_nothing() {
        let mut drift = Drift::default();
        drift.update(&Pose::IDENTITY);
        drift.update(&Pose::new(rotation_y(f64::NAN), DVec3::ZERO));
        assert_eq!(drift.correction(4.0, 0.005), (0.0, 0.0));
    }
}
