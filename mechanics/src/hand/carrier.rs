//! An arm of six joints that carries a palm with fingers, and the dynamics of that tree.
//!
//! Kinetic and potential energy add up over bodies. The tree is therefore described by one chain a
//! finger, from the arm's base to the fingertip, in which every body and every drive occurs once:
//! those of the arm and the palm in the first chain, where they are massless in all others. Mass
//! matrix, Coriolis and gravity torques of the tree are then the sums of those of the chains, with
//! the arm's joints shared. Nothing is neglected.

use glam::DVec3;

use super::{CARRIER_JOINTS, FINGER_JOINTS};
use crate::chain::{Chain, ChainError, JointSpec};
use crate::rigid_body::Body;
use crate::spatial::{JointMatrix, JointVector, Pose};

/// Joints from the arm's base to a fingertip.
pub const CHAIN_JOINTS: usize = CARRIER_JOINTS + FINGER_JOINTS;

/// The arm of a hand and the chains of its tree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Carrier<const F: usize> {
    arm: Chain<CARRIER_JOINTS>,
    chains: [Chain<CHAIN_JOINTS>; F],
}

/// The joint of a hand that is joint `i` of the chain of a finger.
fn joint_of_hand(finger: usize, i: usize) -> usize {
    if i < CARRIER_JOINTS { i } else { i + FINGER_JOINTS * finger }
}

/// The joint without the mass and the drive that another chain has.
fn massless(joint: &JointSpec) -> JointSpec {
    let Body { com_m, .. } = joint.body;
    let body = Body { mass_kg: 0.0, com_m, inertia_kg_m2: glam::DMat3::ZERO };
    JointSpec { body, reflected_inertia: 0.0, ..*joint }
}

impl<const F: usize> Carrier<F> {
    /// The tree of an arm with fingers; arguments as those of
    /// [`Hand::on_arm`](super::Hand::on_arm).
    pub(super) fn new(
        arm: &[JointSpec; CARRIER_JOINTS],
        palm: &Pose,
        fingers: &[[JointSpec; FINGER_JOINTS]; F],
        tips: &[Pose; F],
    ) -> Result<Carrier<F>, ChainError> {
        let chain = |f: usize| {
            let joints: [JointSpec; CHAIN_JOINTS] =
                core::array::from_fn(|i| match i.checked_sub(CARRIER_JOINTS) {
                    None if f == 0 => arm[i],
                    None => massless(&arm[i]),
                    Some(0) => {
                        JointSpec { origin: palm.compose(&fingers[f][0].origin), ..fingers[f][0] }
                    }
                    Some(own) => fingers[f][own],
                });
            Chain::new(&joints, &tips[f])
        };
        let mut chains = [chain(0)?; F];
        for (f, slot) in chains.iter_mut().enumerate() {
            *slot = chain(f)?;
        }
        Ok(Carrier { arm: Chain::new(arm, palm)?, chains })
    }

    /// The arm, whose tool is the palm's frame. Its masses are those of arm and palm, without the
    /// fingers.
    #[must_use]
    pub fn arm(&self) -> &Chain<CARRIER_JOINTS> {
        &self.arm
    }

    /// The chains from the arm's base to each fingertip; bodies of arm and palm are in the first.
    #[must_use]
    pub fn chains(&self) -> &[Chain<CHAIN_JOINTS>; F] {
        &self.chains
    }

    pub(super) fn standing_at(self, base_m: DVec3, yaw_rad: f64) -> Carrier<F> {
        Carrier {
            arm: self.arm.standing_at(base_m, yaw_rad),
            chains: self.chains.map(|chain| chain.standing_at(base_m, yaw_rad)),
        }
    }

    /// The joints of the chain of a finger out of those of the hand.
    fn chain_joints<const N: usize>(
        q: &JointVector<N>,
        finger: usize,
    ) -> JointVector<CHAIN_JOINTS> {
        JointVector::from_fn(|i, _| q[joint_of_hand(finger, i)])
    }

    /// The sum of a vector of each chain.
    fn sum<const N: usize>(
        &self,
        of: impl Fn(&Chain<CHAIN_JOINTS>, usize) -> JointVector<CHAIN_JOINTS>,
    ) -> JointVector<N> {
        let mut out = JointVector::zeros();
        for (f, chain) in self.chains.iter().enumerate() {
            let own = of(chain, f);
            for i in 0..CHAIN_JOINTS {
                out[joint_of_hand(f, i)] += own[i];
            }
        }
        out
    }

    pub(super) fn mass_matrix<const N: usize>(&self, q: &JointVector<N>) -> JointMatrix<N> {
        let mut out = JointMatrix::zeros();
        for (f, chain) in self.chains.iter().enumerate() {
            let own = chain.mass_matrix(&Self::chain_joints(q, f));
            for i in 0..CHAIN_JOINTS {
                for j in 0..CHAIN_JOINTS {
                    out[(joint_of_hand(f, i), joint_of_hand(f, j))] += own[(i, j)];
                }
            }
        }
        out
    }

    pub(super) fn bias_torque<const N: usize>(
        &self,
        q: &JointVector<N>,
        qd: &JointVector<N>,
    ) -> JointVector<N> {
        self.sum(|chain, f| {
            chain.bias_torque(&Self::chain_joints(q, f), &Self::chain_joints(qd, f))
        })
    }

    pub(super) fn gravity_torque<const N: usize>(&self, q: &JointVector<N>) -> JointVector<N> {
        self.sum(|chain, f| chain.gravity_torque(&Self::chain_joints(q, f)))
    }

    /// Potential energy with the hand's joints at `q` (rad) (J); zero where every mass is at the
    /// origin of the base.
    #[must_use]
    pub fn potential_energy_j<const N: usize>(&self, q: &JointVector<N>) -> f64 {
        let chains = self.chains.iter().enumerate();
        chains.map(|(f, chain)| chain.potential_energy_j(&Self::chain_joints(q, f))).sum()
    }
}
