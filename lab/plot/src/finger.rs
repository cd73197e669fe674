//! Computes the trajectory of the finger from the joint angles in a log, since the figures of the
//! thesis show it and no sensor measures it. Angles from before calibration are relative to
//! power-up and yield NaN.

use taktil_mechanics::Joints;
use taktil_mechanics::puma260::Puma260;

use taktil_record::series::Series;

/// Tool point and the two angles of the sensor frame over time; NaN while uncalibrated.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FingerTrajectory {
    /// Times (s).
    pub t_s: Vec<f64>,
    /// Tool point along x0, y0, z0 (mm).
    pub p_mm: [Vec<f64>; 3],
    /// Angle of the sensor's x axis about z0 (deg) in [0, 360).
    pub theta_xx_deg: Vec<f64>,
    /// Angle of the sensor's z axis about x0 (deg) in [0, 360).
    pub theta_zz_deg: Vec<f64>,
}

/// The finger of a `JointState` series, with the reference arm.
#[must_use]
pub fn finger_trajectory(joints: &Series) -> FingerTrajectory {
    let arm = Puma260::reference();
    let mut out = FingerTrajectory { t_s: joints.t_s.clone(), ..FingerTrajectory::default() };
    let calibrated = joints.values("calibrated", 0);
    for row in 0..joints.len() {
        let q = joints.column("q_rad").map(|column| column.row(row)).unwrap_or_default();
        let known = calibrated.get(row).is_none_or(|flag| *flag != 0.0) && q.len() == 6;
        let q = if known { Joints::from_column_slice(q) } else { Joints::repeat(f64::NAN) };
        let pose = arm.tool_pose(&q);
        let (p, x_s, z_s) = (pose.translation, pose.rotation.x_axis, pose.rotation.z_axis);
        for (axis, metres) in out.p_mm.iter_mut().zip(p.to_array()) {
            axis.push(metres * 1e3);
        }
        out.theta_xx_deg.push(direction_deg(x_s.x, x_s.y));
        out.theta_zz_deg.push(direction_deg(z_s.z, z_s.y));
    }
    out
}

/// The angle of a direction in [0, 360) deg. In the rolling pose it is near 180, far from the wrap.
fn direction_deg(along: f64, across: f64) -> f64 {
    let angle = libm::atan2(across, along).to_degrees();
    if angle < 0.0 { angle + 360.0 } else { angle }
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_record::series::Column;

    fn series(q: [f64; 6], calibrated: f64) -> Series {
        let column = |name: &str, values: Vec<f64>| Column {
            name: name.into(),
            width: values.len(),
            array: values.len() > 1,
            values,
        };
        Series {
            t_s: vec![0.0],
            tick: vec![0],
            columns: vec![column("q_rad", q.to_vec()), column("calibrated", vec![calibrated])],
        }
    }

    #[test]
    fn the_rolling_pose_reads_180_degrees_twice() {
        use taktil_mechanics::Pose;
        let arm = Puma260::reference();
        let tool = Pose::from_rows(
            &[-1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0],
            &[0.325, 0.0, -0.149],
        );
        let branches = arm.inverse_kinematics(&arm.tool_to_wrist(&tool), None);
        let q = branches.as_slice()[0].q;
        let finger = finger_trajectory(&series(q.into(), 1.0));
        assert!((finger.p_mm[0][0] - 325.0).abs() < 1e-9);
        assert!((finger.p_mm[2][0] + 149.0).abs() < 1e-9);
        assert!((finger.theta_xx_deg[0] - 180.0).abs() < 1e-9);
        assert!((finger.theta_zz_deg[0] - 180.0).abs() < 1e-9);
    }

    #[test]
    fn nothing_is_shown_before_calibration() {
        let finger = finger_trajectory(&series([0.0; 6], 0.0));
        assert!(finger.p_mm[0][0].is_nan() && finger.theta_zz_deg[0].is_nan());
        assert_eq!(finger.t_s, [0.0]);
        assert!(super::finger_trajectory(&Series::default()).t_s.is_empty());
    }

    #[test]
    fn angles_stay_in_one_turn() {
        assert!(direction_deg(-1.0, -1e-9) > 179.0);
        assert!(direction_deg(-1.0, -1e-9) < 181.0);
        assert_eq!(direction_deg(0.0, -1.0), 270.0);
    }
}
