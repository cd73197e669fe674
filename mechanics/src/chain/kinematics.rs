//! Forward kinematics, Jacobians and singular values of a chain.

use super::{Chain, JointKind, Link};
use crate::spatial::{Jacobian, JointVector, Pose};
use glam::{DMat3, DVec3};

/// Axes and origins of the joints (m) and the pose of the tool, all in the base frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frames<const N: usize> {
    pub(super) axis: [DVec3; N],
    pub(super) origin: [DVec3; N],
    pub(super) tool: Pose,
}

/// `rotation * Rz(q)` for an angle `q` (rad).
#[inline(always)]
fn rotated_about_z(rotation: &DMat3, q: f64) -> DMat3 {
    let (s, c) = libm::sincos(q);
    let (x, y) = (rotation.x_axis, rotation.y_axis);
    DMat3::from_cols(c * x + s * y, c * y - s * x, rotation.z_axis)
}

impl Link {
    /// The pose of this link in the base frame at the joint value `q`, where `before` is the pose
    /// of the link before it.
    #[inline(always)]
    fn link_pose(&self, before: &Pose, q: f64) -> Pose {
        let frame = before.compose(&self.origin);
        match self.kind {
            JointKind::Revolute => {
                Pose::new(rotated_about_z(&frame.rotation, q), frame.translation)
            }
            JointKind::Prismatic => {
                Pose::new(frame.rotation, frame.translation + q * frame.rotation.z_axis)
            }
        }
    }
}

impl<const N: usize> Chain<N> {
    /// The frames of all joints and of the tool at `q` (rad or m).
    pub(super) fn frames(&self, q: &JointVector<N>) -> Frames<N> {
        let mut at = Pose::IDENTITY;
        let (mut axis, mut origin) = ([DVec3::ZERO; N], [DVec3::ZERO; N]);
        for i in 0..N {
            at = self.links[i].link_pose(&at, q[i]);
            axis[i] = at.rotation.z_axis;
            origin[i] = at.translation;
        }
        Frames { axis, origin, tool: at.compose(&self.tool) }
    }

    /// Forward kinematics: the pose of the tool frame in the base frame at `q` (rad or m).
    #[must_use]
    pub fn tool_pose(&self, q: &JointVector<N>) -> Pose {
        let mut at = Pose::IDENTITY;
        for (link, q) in self.links.iter().zip(q.iter()) {
            at = link.link_pose(&at, *q);
        }
        at.compose(&self.tool)
    }

    /// The Jacobian of the tool point at `q` (rad or m), rows vx vy vz wx wy wz, both halves in the
    /// base frame.
    #[must_use]
    pub fn jacobian_base(&self, q: &JointVector<N>) -> Jacobian<N> {
        self.jacobian_from_frames(&self.frames(q), &DMat3::IDENTITY)
    }

    /// The pose of the tool frame in the base frame at `q` (rad or m), and the Jacobian of the tool
    /// point there, rows vx vy vz wx wy wz, both halves in the base frame: what
    /// [`Chain::tool_pose`] and [`Chain::jacobian_base`] give, at the cost of one of them.
    #[must_use]
    pub fn tool_and_jacobian(&self, q: &JointVector<N>) -> (Pose, Jacobian<N>) {
        let frames = self.frames(q);
        (frames.tool, self.jacobian_from_frames(&frames, &DMat3::IDENTITY))
    }

    /// The Jacobian of the tool point at `q` (rad or m), rows vx vy vz wx wy wz, both halves in the
    /// tool frame.
    #[must_use]
    pub fn jacobian_tool(&self, q: &JointVector<N>) -> Jacobian<N> {
        let frames = self.frames(q);
        self.jacobian_from_frames(&frames, &frames.tool.rotation.transpose())
    }

    /// The Jacobian of the tool point from the frames in the base frame, in axes to which `into`
    /// rotates.
    pub(super) fn jacobian_from_frames(&self, frames: &Frames<N>, into: &DMat3) -> Jacobian<N> {
        let mut out = Jacobian::<N>::zeros();
        for i in 0..N {
            let axis = frames.axis[i];
            let (v, w) = match self.links[i].kind {
                JointKind::Revolute => {
                    (axis.cross(frames.tool.translation - frames.origin[i]), axis)
                }
                JointKind::Prismatic => (axis, DVec3::ZERO),
            };
            let (v, w) = (*into * v, *into * w);
            out.column_mut(i).copy_from_slice(&[v.x, v.y, v.z, w.x, w.y, w.z]);
        }
        out
    }

    /// The singular values of the Jacobian at `q` (rad or m), largest first. Lengths are divided by
    /// the mean link length, so that the rows are comparable. The last value measures the distance
    /// from any singularity. Values beyond the number of joints are 0. They are NaN for joints that
    /// are not finite.
    ///
    /// They are computed by one-sided Jacobi rotations (Hestenes 1958) on the rows of the Jacobian,
    /// which keep the accuracy of small values.
    #[must_use]
    pub fn singular_values(&self, q: &JointVector<N>) -> [f64; 6] {
        let mut j = self.jacobian_base(q);
        for column in 0..N {
            for row in 0..3 {
                j[(row, column)] /= self.mean_link_m;
            }
        }
        for _ in 0..JACOBI_SWEEPS_MAX {
            let mut has_rotated = false;
            for a in 0..6 {
                for b in a + 1..6 {
                    has_rotated |= orthogonalise_rows(&mut j, a, b);
                }
            }
            if !has_rotated {
                break;
            }
        }
        let mut out = [0.0; 6];
        for (row, value) in out.iter_mut().enumerate() {
            *value = j.row(row).norm();
        }
        out.sort_unstable_by(|a, b| b.total_cmp(a));
        out
    }
}

/// Largest number of sweeps over all pairs of rows; ten are usual.
const JACOBI_SWEEPS_MAX: usize = 30;

/// Rotates two rows in their plane so that they become orthogonal. Returns false where they already
/// were.
fn orthogonalise_rows<const N: usize>(j: &mut Jacobian<N>, a: usize, b: usize) -> bool {
    let (mut alpha, mut beta, mut gamma) = (0.0, 0.0, 0.0);
    for k in 0..N {
        let (x, y) = (j[(a, k)], j[(b, k)]);
        alpha += x * x;
        beta += y * y;
        gamma += x * y;
    }
    if gamma == 0.0 || gamma.abs() <= f64::EPSILON * (alpha * beta).sqrt() {
        return false;
    }
    let zeta = (beta - alpha) / (2.0 * gamma);
    let t = zeta.signum() / (zeta.abs() + (1.0 + zeta * zeta).sqrt());
    let c = 1.0 / (1.0 + t * t).sqrt();
    let s = c * t;
    for k in 0..N {
        let (x, y) = (j[(a, k)], j[(b, k)]);
        j[(a, k)] = c * x - s * y;
        j[(b, k)] = s * x + c * y;
    }
    true
}
