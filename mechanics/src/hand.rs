//! A hand: fingers of three joints each on one palm, as one robot whose joints are those of the
//! fingers one after the other. A finger is a [`Chain`] from the palm's frame to the frame of its
//! fingertip. The fingers are independent of each other: mass matrix and Jacobian consist of one
//! block a finger, and the palm stands still.
//!
//! As an [`Arm`] a hand moves in its joints only: a tool pose is that of the first fingertip, and
//! no joints are found for one, because three joints do not reach a pose of six coordinates.

use glam::DVec3;
use nalgebra::Matrix3;

use crate::arm::{Arm, ArmDynamics, FollowError, FollowerStep, PathFollower};
use crate::chain::Chain;
use crate::spatial::{JointMatrix, JointVector, Pose, to_glam_vector};

/// Joints of a finger.
pub const FINGER_JOINTS: usize = 3;

/// A hand of `F` fingers with `N` joints, three a finger.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hand<const F: usize, const N: usize> {
    fingers: [Chain<FINGER_JOINTS>; F],
    q_min: JointVector<N>,
    q_max: JointVector<N>,
    speed_max: JointVector<N>,
    acceleration_max: JointVector<N>,
    effort_max: JointVector<N>,
}

/// A hand of three fingers of three joints.
pub type ThreeFingers = Hand<3, 9>;

/// The fingertip of a finger at some joints: its frame and how the joints move it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fingertip {
    /// The fingertip's frame in the palm's frame (m).
    pub pose: Pose,
    /// Velocity of the fingertip's origin per joint speed (m), palm frame.
    pub linear: Matrix3<f64>,
    /// Angular velocity of the fingertip per joint speed, palm frame.
    pub angular: Matrix3<f64>,
}

impl Fingertip {
    /// Velocity per joint speed (m) of a point that the fingertip carries, where `lever` is the
    /// place of the point from the fingertip's origin (m, palm frame).
    #[must_use]
    pub fn linear_at(&self, lever: DVec3) -> Matrix3<f64> {
        let mut out = self.linear;
        for column in 0..FINGER_JOINTS {
            let spin = to_glam_vector(&self.angular.column(column).into()).cross(lever);
            for (row, part) in spin.to_array().into_iter().enumerate() {
                out[(row, column)] += part;
            }
        }
        out
    }
}

impl<const F: usize, const N: usize> Hand<F, N> {
    /// A hand of these fingers, all described in the palm's frame. `None` where `N` is not three
    /// times `F`.
    #[must_use]
    pub fn new(fingers: [Chain<FINGER_JOINTS>; F]) -> Option<Hand<F, N>> {
        if N != FINGER_JOINTS * F {
            return None;
        }
        let all = |of: fn(&Chain<FINGER_JOINTS>) -> &JointVector<FINGER_JOINTS>| {
            JointVector::<N>::from_fn(|i, _| of(&fingers[i / FINGER_JOINTS])[i % FINGER_JOINTS])
        };
        Some(Hand {
            q_min: all(|finger| &finger.limits().q_min),
            q_max: all(|finger| &finger.limits().q_max),
            speed_max: all(|finger| &finger.limits().speed_max),
            acceleration_max: all(|finger| &finger.limits().acceleration_max),
            effort_max: all(|finger| &finger.limits().effort_max),
            fingers,
        })
    }

    /// The fingers, each a chain in the palm's frame.
    #[must_use]
    pub fn fingers(&self) -> &[Chain<FINGER_JOINTS>; F] {
        &self.fingers
    }

    /// Largest torques of the joints (N m).
    #[must_use]
    pub fn effort_max(&self) -> &JointVector<N> {
        &self.effort_max
    }

    /// The joints of a finger out of those of the hand (rad).
    #[must_use]
    pub fn finger_joints(q: &JointVector<N>, finger: usize) -> JointVector<FINGER_JOINTS> {
        JointVector::from_fn(|i, _| q[FINGER_JOINTS * finger + i])
    }

    /// The fingertip of a finger with the hand's joints at `q` (rad).
    #[must_use]
    pub fn fingertip(&self, q: &JointVector<N>, finger: usize) -> Fingertip {
        let chain = &self.fingers[finger];
        let own = Hand::<F, N>::finger_joints(q, finger);
        let jacobian = chain.jacobian_base(&own);
        Fingertip {
            pose: chain.tool_pose(&own),
            linear: jacobian.fixed_rows::<3>(0).into(),
            angular: jacobian.fixed_rows::<3>(3).into(),
        }
    }

    /// A vector of the hand's joints from one of each finger.
    fn joined(
        &self,
        of: impl Fn(&Chain<FINGER_JOINTS>, usize) -> JointVector<FINGER_JOINTS>,
    ) -> JointVector<N> {
        let mut out = JointVector::<N>::zeros();
        for (f, finger) in self.fingers.iter().enumerate() {
            let own = of(finger, f);
            for i in 0..FINGER_JOINTS {
                out[FINGER_JOINTS * f + i] = own[i];
            }
        }
        out
    }
}

impl<const F: usize, const N: usize> ArmDynamics<N> for Hand<F, N> {
    fn mass_matrix(&self, q: &JointVector<N>) -> JointMatrix<N> {
        let mut out = JointMatrix::<N>::zeros();
        for (f, finger) in self.fingers.iter().enumerate() {
            let block = finger.mass_matrix(&Hand::<F, N>::finger_joints(q, f));
            out.fixed_view_mut::<3, 3>(FINGER_JOINTS * f, FINGER_JOINTS * f).copy_from(&block);
        }
        out
    }

    fn bias_torque(&self, q: &JointVector<N>, qd: &JointVector<N>) -> JointVector<N> {
        self.joined(|finger, f| {
            let own = |v: &JointVector<N>| Hand::<F, N>::finger_joints(v, f);
            finger.bias_torque(&own(q), &own(qd))
        })
    }

    fn gravity_torque(&self, q: &JointVector<N>) -> JointVector<N> {
        self.joined(|finger, f| finger.gravity_torque(&Hand::<F, N>::finger_joints(q, f)))
    }
}

impl<const F: usize, const N: usize> Arm<N> for Hand<F, N> {
    type Follower = NoFollower<N>;
    type Dynamics = Hand<F, N>;

    fn q_min(&self) -> &JointVector<N> {
        &self.q_min
    }

    fn q_max(&self) -> &JointVector<N> {
        &self.q_max
    }

    fn speed_max(&self) -> &JointVector<N> {
        &self.speed_max
    }

    fn acceleration_max(&self) -> &JointVector<N> {
        &self.acceleration_max
    }

    fn with_speed_max(&self, speed_max: &JointVector<N>) -> Hand<F, N> {
        Hand { speed_max: *speed_max, ..*self }
    }

    /// The frame of the first fingertip.
    fn tool_pose(&self, q: &JointVector<N>) -> Pose {
        let own = Hand::<F, N>::finger_joints(q, 0);
        self.fingers.first().map_or(Pose::IDENTITY, |finger| finger.tool_pose(&own))
    }

    /// A hand reaches no pose of six coordinates with the three joints of a finger.
    fn inverse_kinematics_near(&self, _: &Pose, _: &JointVector<N>) -> Option<JointVector<N>> {
        None
    }

    fn is_within_reach_bound(&self, _: &Pose) -> bool {
        false
    }

    fn is_reachable(&self, _: &Pose) -> bool {
        false
    }

    /// Three times the smallest distance of a finger from where its fingertip cannot move in every
    /// direction: the volume that its joints' unit motions span, relative to that of motions at
    /// right angles.
    fn singularity_distances(&self, q: &JointVector<N>) -> [f64; 3] {
        let mut least = 1.0_f64;
        for f in 0..F {
            let linear = self.fingertip(q, f).linear;
            let lengths: f64 = linear.column_iter().map(|column| column.norm()).product();
            let share = if lengths > 0.0 { (linear.determinant() / lengths).abs() } else { 0.0 };
            least = least.min(share);
        }
        [least; 3]
    }

    fn follower(&self, q: &JointVector<N>) -> NoFollower<N> {
        NoFollower { q: *q }
    }

    /// The lever of the fingertip whose finger the joint belongs to.
    fn touch_lever_m(&self, joint: usize, q: &JointVector<N>) -> f64 {
        let tip = self.fingertip(q, joint / FINGER_JOINTS);
        tip.linear.column(joint % FINGER_JOINTS).norm()
    }
}

/// The follower of an arm that follows no path of poses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoFollower<const N: usize> {
    q: JointVector<N>,
}

impl<const N: usize> PathFollower<N> for NoFollower<N> {
    fn joints(&self) -> &JointVector<N> {
        &self.q
    }

    fn step(&mut self, _: &Pose, _: f64) -> Result<FollowerStep<N>, FollowError> {
        Err(FollowError::OutOfReach)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chain::JointSpec;

    /// A finger whose base stands at `x_m`, with links of 50 mm along its own -z.
    fn finger(x_m: f64) -> Chain<3> {
        let down = Pose::new(glam::DMat3::IDENTITY, DVec3::new(0.0, 0.0, -0.05));
        let base = Pose::new(glam::DMat3::IDENTITY, DVec3::new(x_m, 0.0, 0.0));
        let joint = |origin, axis| JointSpec { origin, axis, ..JointSpec::default() };
        let joints = [joint(base, DVec3::X), joint(down, DVec3::Y), joint(down, DVec3::Y)];
        Chain::new(&joints, &down).unwrap()
    }

    fn pair() -> Hand<2, 6> {
        Hand::new([finger(0.0), finger(0.1)]).unwrap()
    }

    #[test]
    fn a_hand_has_three_joints_a_finger() {
        assert!(Hand::<2, 5>::new([finger(0.0), finger(0.1)]).is_none());
        assert_eq!(pair().q_min().len(), 6);
    }

    #[test]
    fn the_jacobian_of_a_fingertip_is_its_derivative_and_the_other_finger_does_not_move_it() {
        let (hand, q) = (pair(), JointVector::from([0.2, -0.3, 0.9, -0.1, 0.4, 0.5]));
        let (tip, lever) = (hand.fingertip(&q, 1), DVec3::new(0.004, -0.003, 0.001));
        let place = |q: &JointVector<6>| hand.fingertip(q, 1).pose.apply(lever);
        let linear = tip.linear_at(tip.pose.rotation * lever);
        for joint in 0..6 {
            let mut step = JointVector::<6>::zeros();
            step[joint] = 1e-6;
            let moved = (place(&(q + step)) - place(&(q - step))) / 2e-6;
            let stated = match joint.checked_sub(3) {
                Some(own) => to_glam_vector(&linear.column(own).into()),
                None => DVec3::ZERO,
            };
            assert!((moved - stated).length() < 1e-9, "{joint}: {moved} {stated}");
        }
    }

    #[test]
    fn every_joint_has_the_lever_of_its_own_fingertip() {
        let (hand, q) = (pair(), JointVector::from([0.0, -0.3, 0.9, 0.0, -0.3, 0.9]));
        let levers_m: [f64; 6] = core::array::from_fn(|joint| hand.touch_lever_m(joint, &q));
        let other = levers_m[3..].iter();
        assert!(levers_m.iter().zip(other).all(|(a, b)| (a - b).abs() < 1e-12), "{levers_m:?}");
        let chain = hand.fingers()[0];
        let own = Hand::<2, 6>::finger_joints(&q, 0);
        for (joint, lever_m) in levers_m.iter().take(3).enumerate() {
            let by_difference = chain.touch_lever_m(joint, &own);
            assert!((lever_m - by_difference).abs() < 1e-4, "{joint}: {by_difference}");
        }
        assert!((levers_m[2] - 0.05).abs() < 1e-12, "{levers_m:?}");
    }

    #[test]
    fn dynamics_are_those_of_the_fingers_alone() {
        let hand = pair();
        let q = JointVector::from([0.2, -0.3, 0.9, -0.1, 0.4, 0.5]);
        let qd = JointVector::from([1.0, 2.0, -1.0, 0.5, 0.0, 3.0]);
        let own = |v: &JointVector<6>, f| Hand::<2, 6>::finger_joints(v, f);
        let (mass, bias) = (hand.mass_matrix(&q), hand.bias_torque(&q, &qd));
        for f in 0..2 {
            let finger = &hand.fingers()[f];
            let block = mass.fixed_view::<3, 3>(3 * f, 3 * f);
            assert_eq!(block, finger.mass_matrix(&own(&q, f)));
            assert_eq!(own(&bias, f), finger.bias_torque(&own(&q, f), &own(&qd, f)));
        }
        assert_eq!(mass[(0, 3)], 0.0);
    }

    #[test]
    fn a_stretched_finger_is_singular_and_no_pose_is_followed() {
        let hand = pair();
        assert_eq!(hand.singularity_distances(&JointVector::zeros()), [0.0; 3]);
        let bent = JointVector::from([0.0, -0.5, 1.0, 0.0, -0.5, 1.0]);
        assert!(hand.singularity_distances(&bent)[0] > 0.1);
        let pose = hand.tool_pose(&bent);
        assert_eq!(hand.inverse_kinematics_near(&pose, &bent), None);
        assert_eq!(hand.follower(&bent).step(&pose, 0.01), Err(FollowError::OutOfReach));
    }
}
