//! To which side a contact of the fingertip pushes the motors: rubber and what it is pressed
//! against push the finger back along its normal, and give back what pressing has stored in them.

use taktil_mechanics::arm::Arm;
use taktil_mechanics::spatial::JointVector;
use taktil_mechanics::transmission::Transmission;

use crate::hidden_motion::ToolPose;
use crate::stuck_encoder::LEVER_MAX_M;

/// Turn of a joint by which the motion of the tool is found (rad), in the direction of these counts
/// of a motor.
const PROBE_RAD: f64 = 1e-3;
const PROBE_COUNTS: i32 = 1000;
/// Share of the finger's motion that has to be along its normal.
const NORMAL_SHARE_MIN: f64 = 0.3;

/// The fingertip as its contact moves it.
#[derive(Debug)]
pub(crate) struct ContactPush<const N: usize> {
    tool_pose: ToolPose<N>,
    gears: Transmission<N>,
}

impl<const N: usize> ContactPush<N> {
    /// The fingertip of an arm with these gears.
    pub(crate) fn new<A: Arm<N>>(arm: &A, gears: &Transmission<N>) -> ContactPush<N> {
        ContactPush { tool_pose: ToolPose::new(arm), gears: *gears }
    }

    /// The sign of the counts to which a force against the fingertip's normal pushes motor `i` at
    /// joint angles `q_rad` (rad); 0 where the motor moves the finger hardly, or along its face.
    pub(crate) fn side(&self, q_rad: &[f64; N], i: usize) -> f64 {
        let q = JointVector::from(*q_rad);
        let tool = (self.tool_pose.0)(&q);
        let mut counts = [0; N];
        counts[i] = PROBE_COUNTS;
        let joints = self.gears.joints(&counts);
        let turn = joints * (PROBE_RAD / joints.amax().max(f64::MIN_POSITIVE));
        let step = (self.tool_pose.0)(&(q + turn)).translation - tool.translation;
        let away_m = -step.dot(tool.rotation.z_axis);
        let is_moved = step.length() >= LEVER_MAX_M * PROBE_RAD;
        if is_moved && away_m.abs() >= NORMAL_SHARE_MIN * step.length() {
            away_m.signum()
        } else {
            0.0
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_mechanics::robot::Robot;

    #[test]
    fn a_force_on_the_face_pushes_those_motors_that_lift_the_finger() {
        let robot = Robot::puma260();
        let push = ContactPush::new(&robot.arm, &robot.gears);
        let q = robot.nominal_rad;
        let normal = robot.arm.tool_pose(&q).rotation.z_axis;
        for i in 0..6 {
            let side = push.side(&q.into(), i);
            // A tenth of a degree to that side takes the finger off, and to the other presses it.
            let mut counts = robot.gears.counts(&q);
            let turned = |by: f64, counts: &mut [i32; 6]| {
                #[expect(clippy::cast_possible_truncation, reason = "some tens of counts")]
                let step = (40.0 * by) as i32;
                counts[i] += step;
                let there = robot.arm.tool_pose(&robot.gears.joints(counts));
                counts[i] -= step;
                there.translation.dot(normal)
            };
            let (to, back) = (turned(side, &mut counts), turned(-side, &mut counts));
            assert!(side == 0.0 || to < back, "motor {i}: {side}, {to} m, {back} m");
            assert!(!(1..=2).contains(&i) || side != 0.0, "motor {i} lifts the finger");
        }
        assert_eq!(push.side(&q.into(), 5), 0.0, "it turns the finger about its axis");
    }
}
