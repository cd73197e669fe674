//! A trajectory that the joints follow exactly, for an arm without masses. An angle beyond the
//! range of its joint is an error; between two points of the trajectory no angle leaves the range
//! of those points.

use taktil_mechanics::Joints;
use taktil_mechanics::puma260::Puma260;

use super::JOINT_COUNT;
use crate::motion::MotionProfile;
use crate::scene::{ArmConfig, Invalid, invalid};

/// The prescribed angles of all joints over time, and the instant at which the arm is.
#[derive(Clone, Debug)]
pub(super) struct PrescribedMotion {
    joints: [MotionProfile; JOINT_COUNT],
    pub(super) t_s: f64,
}

impl PrescribedMotion {
    /// From `start` (rad) through the points of a checked configuration.
    pub(super) fn new(
        config: &ArmConfig,
        puma: &Puma260,
        start: &Joints,
    ) -> Result<PrescribedMotion, Invalid> {
        for (k, point) in config.trajectory_deg.iter().enumerate() {
            for i in 0..JOINT_COUNT {
                let (low, high) = (puma.q_min_rad[i], puma.q_max_rad[i]);
                if !(low..=high).contains(&point[i + 1].to_radians()) {
                    let what = format!("is {}, outside the joint's range", point[i + 1]);
                    let (low, high) = (low.to_degrees(), high.to_degrees());
                    let remedy = format!("give {low:.1} to {high:.1} deg");
                    return Err(invalid(
                        &format!("arm.trajectory_deg[{k}][{}]", i + 1),
                        what,
                        &remedy,
                    ));
                }
            }
        }
        let joints = core::array::from_fn(|i| {
            let point = |point: &[f64; 7]| [point[0], point[i + 1].to_radians()];
            let points: Vec<[f64; 2]> = core::iter::once([0.0, start[i]])
                .chain(config.trajectory_deg.iter().map(point))
                .collect();
            MotionProfile::through(&points)
        });
        Ok(PrescribedMotion { joints, t_s: 0.0 })
    }

    /// Angles (rad) and speeds (rad/s) at an instant.
    pub(super) fn at(&self, t_s: f64) -> (Joints, Joints) {
        let all = self.joints.each_ref().map(|profile| profile.at(t_s));
        (Joints::from_fn(|i, _| all[i].0), Joints::from_fn(|i, _| all[i].1))
    }
}
