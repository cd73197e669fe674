//! Any serial chain of turning and sliding joints: forward kinematics, Jacobians, rigid-body
//! dynamics, and the inverse by damped steps; arms of six joints with a spherical wrist are
//! recognised and solved in closed form ([`spherical_wrist`]). Refuses trees, loops, and sizes that
//! are not known when the code is compiled: the number of joints is a constant, so nothing here
//! allocates.
//!
//! A chain is described by its joints ([`JointSpec`]), from Denavit-Hartenberg rows
//! ([`Chain::from_dh`]) or from any frames and axes. Inside, every joint moves about or along the z
//! axis of its own frame; what the caller sees are joint values, the base frame and the tool
//! frame. Numbers that are finite, of joints, poses, and motions up to 1e60 in size, give numbers
//! that are finite.

mod arm;
mod build;
mod dynamics;
mod inverse;
mod kinematics;
pub mod spherical_wrist;

pub use arm::Follower;
pub use build::{ChainError, DhRow, JointKind, JointSpec};
pub use inverse::{IkFailure, IkSolution, SearchBudget};

use crate::limits;
use crate::rigid_body::Body;
use crate::spatial::{JointVector, Pose};
use glam::DVec3;
use spherical_wrist::SphericalWrist;

/// Most joints that a chain may have.
pub const MAX_JOINTS: usize = 8;

/// A joint inside: it moves about or along z of a frame mounted on the link before.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Link {
    origin: Pose,
    kind: JointKind,
    body: Body,
}

impl Link {
    /// How far a joint can lie from its zero along its axis (m); a turning one does not.
    fn travel_bound_m<const N: usize>(&self, limits: &Limits<N>, joint: usize) -> f64 {
        match self.kind {
            JointKind::Revolute => 0.0,
            JointKind::Prismatic => limits.q_min[joint].abs().max(limits.q_max[joint].abs()),
        }
    }
}

/// What the joints may do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits<const N: usize> {
    /// Lower ends (rad or m).
    pub q_min: JointVector<N>,
    /// Upper ends (rad or m).
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
    /// Acceleration of a body at rest against gravity, base frame: +9.81 along the vertical.
    base_acceleration: DVec3,
    limits: Limits<N>,
    /// Inertia of the drives seen at the joints.
    reflected_inertia: JointVector<N>,
    /// Mean length of a link (m): what a radian is weighed against.
    mean_link_m: f64,
    wrist: Option<SphericalWrist>,
}

impl<const N: usize> Chain<N> {
    /// Limits of the joints.
    #[must_use]
    pub fn limits(&self) -> &Limits<N> {
        &self.limits
    }

    /// Inertia of the drives seen at the joints (kg m^2, kg for sliding joints).
    #[must_use]
    pub fn reflected_inertia(&self) -> &JointVector<N> {
        &self.reflected_inertia
    }

    /// The tool in the frame of the last joint (z along its axis).
    #[must_use]
    pub fn tool(&self) -> &Pose {
        &self.tool
    }

    /// The closed form of the inverse, where the arm was recognised: six turning joints, the last
    /// three with axes that meet at right angles, joints 2 and 3 parallel, joint 1 square to them.
    #[must_use]
    pub fn spherical_wrist(&self) -> Option<&SphericalWrist> {
        self.wrist.as_ref()
    }

    /// Whether every joint lies inside its limits as it stands; NaN does not.
    #[must_use]
    pub fn within_limits(&self, q: &JointVector<N>) -> bool {
        (0..N).all(|i| self.limits.q_min[i] <= q[i] && q[i] <= self.limits.q_max[i])
    }

    /// `q` shifted by whole turns, joint by joint, to the place inside the limits nearest to
    /// `previous`, and the largest joint distance; sliding joints stay. `None` outside the limits
    /// or where a number is not finite.
    #[must_use]
    pub fn nearest_equivalent(
        &self,
        q: &JointVector<N>,
        previous: &JointVector<N>,
    ) -> Option<(JointVector<N>, f64)> {
        let slides = (0..N).any(|i| {
            let outside = q[i] < self.limits.q_min[i] || q[i] > self.limits.q_max[i];
            self.links[i].kind == JointKind::Prismatic && outside
        });
        if slides || !q.iter().all(|x| x.is_finite()) {
            return None;
        }
        let mut wish = *previous;
        for i in 0..N {
            // A slide has no turns: it is where it is.
            if self.links[i].kind == JointKind::Prismatic && wish[i].is_finite() {
                wish[i] = q[i];
            }
        }
        let (out, _) =
            limits::nearest_equivalent(q, &wish, &self.limits.q_min, &self.limits.q_max)?;
        Some((out, (out - previous).amax()))
    }
}
