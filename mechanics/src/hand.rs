//! A hand: fingers of three joints each on one palm, as one robot. The palm stands still, or an arm
//! of six joints carries it; the joints of the hand are those of the arm, if there is one, and then
//! those of the fingers one after the other. A finger is a [`Chain`] from the palm's frame to the
//! frame of its fingertip. On a palm that stands the fingers are independent of each other: mass
//! matrix and Jacobian consist of one block a finger. On an arm they are coupled through it
//! ([`carrier`]).
//!
//! As an [`Arm`] a hand on an arm has the palm's frame as its tool: poses are reached and followed
//! by the arm's joints, and the fingers stay. A hand on a palm that stands moves in its joints
//! only: its tool pose is that of the first fingertip, and no joints are found for one, because
//! three joints do not reach a pose of six coordinates.

pub mod carrier;

use glam::DVec3;
use nalgebra::Matrix3;

use crate::arm::{Arm, ArmDynamics, FollowError, FollowerStep, PathFollower};
use crate::chain::{Chain, ChainError, Follower, JointSpec, Limits};
use crate::spatial::{JointMatrix, JointVector, Joints, Matrix6, Pose, to_glam_vector};
use carrier::Carrier;

/// Joints of a finger.
pub const FINGER_JOINTS: usize = 3;
/// Joints of an arm that carries a palm.
pub const CARRIER_JOINTS: usize = 6;

/// A hand of `F` fingers with `N` joints: three a finger, and six of an arm if one carries it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hand<const F: usize, const N: usize> {
    /// Each from the palm's frame.
    fingers: [Chain<FINGER_JOINTS>; F],
    carrier: Option<Carrier<F>>,
    q_min: JointVector<N>,
    q_max: JointVector<N>,
    speed_max: JointVector<N>,
    acceleration_max: JointVector<N>,
    effort_max: JointVector<N>,
}

/// A hand of three fingers of three joints.
pub type ThreeFingers = Hand<3, 9>;
/// The same on an arm of six joints.
pub type ThreeFingersOnArm = Hand<3, 15>;

/// The fingertip of a finger at some joints: its frame and how the finger's own joints move it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fingertip {
    /// The fingertip's frame (m), in the palm's frame or in the base frame.
    pub pose: Pose,
    /// Velocity of the fingertip's origin per joint speed (m), in the same frame.
    pub linear: Matrix3<f64>,
    /// Angular velocity of the fingertip per joint speed, in the same frame.
    pub angular: Matrix3<f64>,
}

/// The palm at some joints: its frame and how the arm's joints move it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Palm {
    /// The palm's frame in the base frame (m).
    pub pose: Pose,
    /// Twist of the palm's origin per speed of the arm's joints, base frame; zero for a palm that
    /// stands still.
    pub jacobian: Matrix6,
}

impl Palm {
    /// A palm that stands in the base frame.
    pub const STANDING: Palm = Palm { pose: Pose::IDENTITY, jacobian: ZERO_MATRIX };

    /// A fingertip in the base frame, of one in the palm's.
    #[must_use]
    pub fn carried(&self, tip: &Fingertip) -> Fingertip {
        let turn = crate::spatial::to_nalgebra_matrix(&self.pose.rotation);
        Fingertip {
            pose: self.pose.compose(&tip.pose),
            linear: turn * tip.linear,
            angular: turn * tip.angular,
        }
    }

    /// Twist per speed of the arm's joints (base frame) of the point at `place` (m, base frame)
    /// that the palm carries.
    #[must_use]
    pub fn jacobian_at(&self, place: DVec3) -> Matrix6 {
        let lever = place - self.pose.translation;
        let mut out = self.jacobian;
        for column in 0..CARRIER_JOINTS {
            let spin = DVec3::new(out[(3, column)], out[(4, column)], out[(5, column)]);
            for (row, part) in spin.cross(lever).to_array().into_iter().enumerate() {
                out[(row, column)] += part;
            }
        }
        out
    }
}

/// Six by six zeros.
const ZERO_MATRIX: Matrix6 = Matrix6::from_array_storage(nalgebra::ArrayStorage([[0.0; 6]; 6]));

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
    /// Joints before those of the fingers: six of an arm, or none.
    pub const CARRIER_JOINTS: usize = N.saturating_sub(FINGER_JOINTS * F);

    /// A hand of these fingers on a palm that stands still, all described in the palm's frame.
    /// `None` where `N` is not three times `F`.
    #[must_use]
    pub fn new(fingers: [Chain<FINGER_JOINTS>; F]) -> Option<Hand<F, N>> {
        (N == FINGER_JOINTS * F).then(|| Hand::from_parts(fingers, None))
    }

    /// A hand of these fingers, described in the palm's frame, whose palm stands at `palm` in the
    /// frame of the last joint of this arm (m) and belongs to the body that this joint moves.
    /// `tips` are the frames of the fingertips in those of the fingers' last joints.
    ///
    /// # Errors
    /// [`ChainError`], with the number of the joint on the way from the base to a fingertip, or for
    /// the whole where `N` is not six more than three times `F`.
    pub fn on_arm(
        arm: &[JointSpec; CARRIER_JOINTS],
        palm: &Pose,
        fingers: &[[JointSpec; FINGER_JOINTS]; F],
        tips: &[Pose; F],
    ) -> Result<Hand<F, N>, ChainError> {
        if N != CARRIER_JOINTS + FINGER_JOINTS * F || F == 0 {
            return Err(ChainError { joint: N, what: "a hand on an arm has 6 + 3 F joints" });
        }
        let carrier = Carrier::new(arm, palm, fingers, tips)?;
        let mut chains = [Chain::new(&fingers[0], &tips[0])?; F];
        for ((chain, joints), tip) in chains.iter_mut().zip(fingers).zip(tips) {
            *chain = Chain::new(joints, tip)?;
        }
        Ok(Hand::from_parts(chains, Some(carrier)))
    }

    fn from_parts(fingers: [Chain<FINGER_JOINTS>; F], carrier: Option<Carrier<F>>) -> Hand<F, N> {
        let arm = carrier.as_ref().map(|carrier| *carrier.arm().limits());
        let all =
            |of_arm: fn(&Limits<CARRIER_JOINTS>) -> &Joints,
             of: fn(&Limits<FINGER_JOINTS>) -> &JointVector<FINGER_JOINTS>| {
                JointVector::<N>::from_fn(|i, _| {
                    match (i.checked_sub(Self::CARRIER_JOINTS), &arm) {
                        (Some(i), _) => of(fingers[i / FINGER_JOINTS].limits())[i % FINGER_JOINTS],
                        (None, Some(arm)) => of_arm(arm)[i],
                        (None, None) => 0.0,
                    }
                })
            };
        Hand {
            q_min: all(|arm| &arm.q_min, |finger| &finger.q_min),
            q_max: all(|arm| &arm.q_max, |finger| &finger.q_max),
            speed_max: all(|arm| &arm.speed_max, |finger| &finger.speed_max),
            acceleration_max: all(|arm| &arm.acceleration_max, |finger| &finger.acceleration_max),
            effort_max: all(|arm| &arm.effort_max, |finger| &finger.effort_max),
            fingers,
            carrier,
        }
    }

    /// The same hand on an arm whose base was moved to `base_m` (m) and turned by `yaw_rad` about
    /// the vertical, as [`Chain::standing_at`]. A hand without an arm stays.
    #[must_use]
    pub fn standing_at(mut self, base_m: DVec3, yaw_rad: f64) -> Hand<F, N> {
        self.carrier = self.carrier.map(|carrier| carrier.standing_at(base_m, yaw_rad));
        self
    }

    /// The fingers, each a chain in the palm's frame.
    #[must_use]
    pub fn fingers(&self) -> &[Chain<FINGER_JOINTS>; F] {
        &self.fingers
    }

    /// The arm that carries the palm, if there is one.
    #[must_use]
    pub fn carrier(&self) -> Option<&Carrier<F>> {
        self.carrier.as_ref()
    }

    /// Largest torques of the joints (N m).
    #[must_use]
    pub fn effort_max(&self) -> &JointVector<N> {
        &self.effort_max
    }

    /// The place of a finger's first joint among those of the hand.
    #[must_use]
    pub fn first_joint(finger: usize) -> usize {
        Self::CARRIER_JOINTS + FINGER_JOINTS * finger
    }

    /// The joints of a finger out of those of the hand (rad).
    #[must_use]
    pub fn finger_joints(q: &JointVector<N>, finger: usize) -> JointVector<FINGER_JOINTS> {
        JointVector::from_fn(|i, _| q[Self::first_joint(finger) + i])
    }

    /// The joints of the arm out of those of the hand (rad); zeros for a hand without one.
    #[must_use]
    pub fn arm_joints(q: &JointVector<N>) -> Joints {
        Joints::from_fn(|i, _| if i < Self::CARRIER_JOINTS { q[i] } else { 0.0 })
    }

    /// The palm with the hand's joints at `q` (rad).
    #[must_use]
    pub fn palm(&self, q: &JointVector<N>) -> Palm {
        match &self.carrier {
            None => Palm::STANDING,
            Some(carrier) => {
                let (pose, jacobian) = carrier.arm().tool_and_jacobian(&Self::arm_joints(q));
                Palm { pose, jacobian }
            }
        }
    }

    /// The fingertip of a finger in the palm's frame, with the hand's joints at `q` (rad).
    #[must_use]
    pub fn fingertip_in_palm(&self, q: &JointVector<N>, finger: usize) -> Fingertip {
        let chain = &self.fingers[finger];
        let own = Hand::<F, N>::finger_joints(q, finger);
        let jacobian = chain.jacobian_base(&own);
        Fingertip {
            pose: chain.tool_pose(&own),
            linear: jacobian.fixed_rows::<3>(0).into(),
            angular: jacobian.fixed_rows::<3>(3).into(),
        }
    }

    /// The fingertip of a finger in the base frame, with the hand's joints at `q` (rad).
    #[must_use]
    pub fn fingertip(&self, q: &JointVector<N>, finger: usize) -> Fingertip {
        let tip = self.fingertip_in_palm(q, finger);
        if self.carrier.is_some() { self.palm(q).carried(&tip) } else { tip }
    }

    /// The same joints with other ones of the arm (rad).
    fn with_arm_joints(q: &JointVector<N>, arm: &Joints) -> JointVector<N> {
        JointVector::from_fn(|i, _| if i < Self::CARRIER_JOINTS { arm[i] } else { q[i] })
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
                out[Self::first_joint(f) + i] = own[i];
            }
        }
        out
    }
}

impl<const F: usize, const N: usize> ArmDynamics<N> for Hand<F, N> {
    fn mass_matrix(&self, q: &JointVector<N>) -> JointMatrix<N> {
        if let Some(carrier) = &self.carrier {
            return carrier.mass_matrix(q);
        }
        let mut out = JointMatrix::<N>::zeros();
        for (f, finger) in self.fingers.iter().enumerate() {
            let block = finger.mass_matrix(&Hand::<F, N>::finger_joints(q, f));
            out.fixed_view_mut::<3, 3>(FINGER_JOINTS * f, FINGER_JOINTS * f).copy_from(&block);
        }
        out
    }

    fn bias_torque(&self, q: &JointVector<N>, qd: &JointVector<N>) -> JointVector<N> {
        if let Some(carrier) = &self.carrier {
            return carrier.bias_torque(q, qd);
        }
        self.joined(|finger, f| {
            let own = |v: &JointVector<N>| Hand::<F, N>::finger_joints(v, f);
            finger.bias_torque(&own(q), &own(qd))
        })
    }

    fn gravity_torque(&self, q: &JointVector<N>) -> JointVector<N> {
        if let Some(carrier) = &self.carrier {
            return carrier.gravity_torque(q);
        }
        self.joined(|finger, f| finger.gravity_torque(&Hand::<F, N>::finger_joints(q, f)))
    }
}

impl<const F: usize, const N: usize> Arm<N> for Hand<F, N> {
    type Follower = PalmFollower<N>;
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

    /// The palm's frame on an arm; else the frame of the first fingertip.
    fn tool_pose(&self, q: &JointVector<N>) -> Pose {
        if let Some(carrier) = &self.carrier {
            return carrier.arm().tool_pose(&Self::arm_joints(q));
        }
        let own = Hand::<F, N>::finger_joints(q, 0);
        self.fingers.first().map_or(Pose::IDENTITY, |finger| finger.tool_pose(&own))
    }

    /// Joints of the arm that bring the palm there; none without an arm.
    fn inverse_kinematics_near(
        &self,
        tool: &Pose,
        before: &JointVector<N>,
    ) -> Option<JointVector<N>> {
        let arm = self.carrier.as_ref()?.arm();
        let found = Arm::inverse_kinematics_near(arm, tool, &Self::arm_joints(before))?;
        Some(Self::with_arm_joints(before, &found))
    }

    fn is_within_reach_bound(&self, tool: &Pose) -> bool {
        self.carrier.as_ref().is_some_and(|carrier| carrier.arm().is_within_reach_bound(tool))
    }

    fn is_reachable(&self, tool: &Pose) -> bool {
        self.carrier.as_ref().is_some_and(|carrier| carrier.arm().is_reachable(tool))
    }

    /// The arm's step; nothing without an arm, because three joints make no motion of six
    /// coordinates.
    fn tool_step(
        &self,
        q: &JointVector<N>,
        motion: &Joints,
        wish: &JointVector<N>,
        distance_min: f64,
    ) -> Option<JointVector<N>> {
        let arm = self.carrier.as_ref()?.arm();
        let (q, wish) = (Self::arm_joints(q), Self::arm_joints(wish));
        let step = arm.tool_step(&q, motion, &wish, distance_min)?;
        Some(Self::with_arm_joints(&JointVector::zeros(), &step))
    }

    /// Those of the arm, where one carries the palm. Else three times the smallest distance of a
    /// finger from where its fingertip cannot move in every direction: the volume that its joints'
    /// unit motions span, relative to that of motions at right angles.
    fn singularity_distances(&self, q: &JointVector<N>) -> [f64; 3] {
        if let Some(carrier) = &self.carrier {
            return Arm::singularity_distances(carrier.arm(), &Self::arm_joints(q));
        }
        let mut least = 1.0_f64;
        for f in 0..F {
            let linear = self.fingertip(q, f).linear;
            let lengths: f64 = linear.column_iter().map(|column| column.norm()).product();
            let share = if lengths > 0.0 { (linear.determinant() / lengths).abs() } else { 0.0 };
            least = least.min(share);
        }
        [least; 3]
    }

    fn follower(&self, q: &JointVector<N>) -> PalmFollower<N> {
        let follower = |carrier: &Carrier<F>| carrier.arm().follower(&Self::arm_joints(q));
        PalmFollower { q: *q, arm: self.carrier.as_ref().map(follower) }
    }

    /// The lever of the fingertip whose finger the joint belongs to; for a joint of the arm the
    /// longest one of a fingertip.
    fn touch_lever_m(&self, joint: usize, q: &JointVector<N>) -> f64 {
        let Some(own) = joint.checked_sub(Self::CARRIER_JOINTS) else {
            let palm = self.palm(q);
            let lever_m = |f: usize| {
                let place = palm.pose.apply(self.fingertip_in_palm(q, f).pose.translation);
                palm.jacobian_at(place).fixed_view::<3, 1>(0, joint).norm()
            };
            return (0..F).map(lever_m).fold(0.0, f64::max);
        };
        let tip = self.fingertip_in_palm(q, own / FINGER_JOINTS);
        tip.linear.column(own % FINGER_JOINTS).norm()
    }
}

/// Follows a path of poses of a palm with the arm that carries it, while the fingers stay; refuses
/// every pose where none does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PalmFollower<const N: usize> {
    q: JointVector<N>,
    arm: Option<Follower<CARRIER_JOINTS>>,
}

impl<const N: usize> PathFollower<N> for PalmFollower<N> {
    fn joints(&self) -> &JointVector<N> {
        &self.q
    }

    fn step(&mut self, palm: &Pose, dt_s: f64) -> Result<FollowerStep<N>, FollowError> {
        let arm = self.arm.as_mut().ok_or(FollowError::OutOfReach)?;
        let step = arm.step(palm, dt_s)?;
        self.q =
            JointVector::from_fn(|i, _| if i < CARRIER_JOINTS { step.q[i] } else { self.q[i] });
        Ok(FollowerStep {
            q: self.q,
            position_error_m: step.position_error_m,
            orientation_error_rad: step.orientation_error_rad,
        })
    }
}

#[cfg(test)]
mod tests;
