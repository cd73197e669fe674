//! Any serial chain of revolute and prismatic joints: forward kinematics, Jacobians, rigid-body
//! dynamics, and the inverse kinematics by damped least-squares steps. Arms of six joints with a
//! spherical wrist are recognised and solved in closed form ([`spherical_wrist`]). Trees and loops
//! are not covered. The number of joints is a compile-time constant, so that nothing allocates.
//!
//! A chain is described by its joints ([`JointSpec`]), from Denavit-Hartenberg rows
//! ([`Chain::from_dh`]) or from any frames and axes. Internally every joint moves about or along
//! the z axis of its own frame; the caller sees joint values, the base frame and the tool frame.
//! Finite joints and poses, and motions up to 1e60 in size, give finite results.

mod arm;
mod build;
mod dynamics;
mod inverse;
mod kinematics;
pub mod spherical_wrist;
mod tool_step;

pub use arm::Follower;
pub use build::{ChainError, DhRow, JointSpec};
pub use inverse::{IkFailure, IkSolution, SearchBudget};

use crate::limits;
use crate::rigid_body::Body;
use crate::spatial::{JointVector, Pose};
use glam::DVec3;
use spherical_wrist::SphericalWrist;

/// Largest number of joints of a chain: six of an arm and three of a finger behind it.
pub const MAX_JOINTS: usize = 9;

/// The kind of a joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointKind {
    /// The joint rotates about its axis; its value is an angle (rad).
    Revolute,
    /// The joint moves along its axis; its value is a length (m).
    Prismatic,
}

/// A link and its joint, which moves about or along the z axis of a frame fixed to the link before.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Link {
    origin: Pose,
    kind: JointKind,
    body: Body,
}

impl Link {
    /// Largest distance of a prismatic joint from its zero along its axis (m); 0 for a revolute
    /// joint.
    fn travel_bound_m<const N: usize>(&self, limits: &Limits<N>, joint: usize) -> f64 {
        match self.kind {
            JointKind::Revolute => 0.0,
            JointKind::Prismatic => limits.q_min[joint].abs().max(limits.q_max[joint].abs()),
        }
    }
}

/// Limits of the joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits<const N: usize> {
    /// Lower limits (rad or m).
    pub q_min: JointVector<N>,
    /// Upper limits (rad or m).
    pub q_max: JointVector<N>,
    /// Largest speeds (rad/s or m/s).
    pub speed_max: JointVector<N>,
    /// Largest accelerations for planning (rad/s^2 or m/s^2).
    pub acceleration_max: JointVector<N>,
    /// Largest torques (N m) or forces (N).
    pub effort_max: JointVector<N>,
}

/// A serial chain of `N` joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Chain<const N: usize> {
    links: [Link; N],
    tool: Pose,
    /// Acceleration of the base that has the effect of gravity (m/s^2, base frame): 9.81 upwards.
    base_acceleration: DVec3,
    /// Where the arm stands in the base frame (m): zero but for an arm that was moved there.
    base_m: DVec3,
    limits: Limits<N>,
    /// Reflected inertia of the drives (kg m^2 or kg).
    reflected_inertia: JointVector<N>,
    /// Mean length of a link (m), by which positions are divided to compare them with angles.
    mean_link_m: f64,
    wrist: Option<SphericalWrist>,
}

impl<const N: usize> Chain<N> {
    /// Limits of the joints.
    #[must_use]
    pub fn limits(&self) -> &Limits<N> {
        &self.limits
    }

    /// Reflected inertia of the drives at the joints (kg m^2; kg for prismatic joints).
    #[must_use]
    pub fn reflected_inertia(&self) -> &JointVector<N> {
        &self.reflected_inertia
    }

    /// The pose of the tool in the frame of the last joint, whose z axis is the axis of the joint.
    #[must_use]
    pub fn tool(&self) -> &Pose {
        &self.tool
    }

    /// The pose of each joint's frame at value zero, whose z axis is the axis of the joint, in the
    /// frame of the joint before it, or in the base frame for the first joint. With the turns by
    /// the joints' values and the tool they make the forward kinematics.
    #[must_use]
    pub fn joint_origins(&self) -> [Pose; N] {
        core::array::from_fn(|i| self.links[i].origin)
    }

    /// The closed-form inverse kinematics, where the arm allows it: six revolute joints, the axes
    /// of the last three meet at one point with right angles between neighbours, axes 2 and 3 are
    /// parallel, and axis 1 is perpendicular to them.
    #[must_use]
    pub fn spherical_wrist(&self) -> Option<&SphericalWrist> {
        self.wrist.as_ref()
    }

    /// Whether every joint of `q` (rad or m), without any shift by whole turns, lies inside its
    /// limits. NaN does not.
    #[must_use]
    pub fn within_limits(&self, q: &JointVector<N>) -> bool {
        (0..N).all(|i| self.limits.q_min[i] <= q[i] && q[i] <= self.limits.q_max[i])
    }

    /// `q` with its revolute joints shifted by whole turns to be inside the limits and nearest to
    /// `previous` (rad or m), and its largest distance from `previous` over all joints. `None`
    /// where a joint has no equivalent inside its limits or a number is not finite.
    #[must_use]
    pub fn nearest_equivalent(
        &self,
        q: &JointVector<N>,
        previous: &JointVector<N>,
    ) -> Option<(JointVector<N>, f64)> {
        let is_outside = (0..N).any(|i| {
            let outside = q[i] < self.limits.q_min[i] || q[i] > self.limits.q_max[i];
            self.links[i].kind == JointKind::Prismatic && outside
        });
        if is_outside || !q.iter().all(|x| x.is_finite()) {
            return None;
        }
        let mut wanted = *previous;
        for i in 0..N {
            // A prismatic joint has no equivalents, so that its value is its own nearest one.
            if self.links[i].kind == JointKind::Prismatic && wanted[i].is_finite() {
                wanted[i] = q[i];
            }
        }
        let (out, _) =
            limits::nearest_equivalent(q, &wanted, &self.limits.q_min, &self.limits.q_max)?;
        Some((out, (out - previous).amax()))
    }
}
