//! Joint steps for small motions of the tool, of a chain with as many joints as the tool has
//! motions or more: damped least squares, and what the tool leaves free for a wished step of the
//! joints.
//!
//! With J the Jacobian in tool axes, its rows of positions divided by the mean link length, and x
//! the motion scaled alike, the step is
//!
//! ```text
//! dq = J' (J J' + lambda^2 I)^-1 x + (I - J' (J J')^-1 J) w
//! ```
//! (Liegeois 1977; Nakamura and Hanafusa 1986). The first part is the shortest step that makes the
//! motion, the second the part of the wish w that does not move the tool: with w towards a fixed
//! posture, joints after a closed path of the tool are near those before it, where the shortest
//! steps alone let them drift (Klein and Huang 1983). Away from singularities lambda is zero, and
//! the motion is made exactly to first order; nearer than twice the distance that the caller bears
//! lambda grows ([`damping_squared`](crate::dls::damping_squared)).

use super::Chain;
use crate::dls::damping_squared;
use crate::spatial::{Jacobian, JointVector, Joints, Matrix6};

/// Damping begins at so many times the distance from a singularity that the caller bears.
const DAMPING_BEGINS_RATIO: f64 = 2.0;

impl<const N: usize> Chain<N> {
    /// The joint step (rad or m) for the small motion `motion` of the tool in its own axes, `[v;
    /// w]` (m, rad), at `q` (rad or m), and for as much of the step `wish` (rad or m) as leaves the
    /// tool where it is. `None` nearer to a singularity than `distance_min` and for numbers that
    /// are not finite. The distance is `1 / sqrt(trace (J J')^-1)`: at most the smallest singular
    /// value of the scaled Jacobian, and at least that over the square root of six.
    #[must_use]
    pub fn tool_step(
        &self,
        q: &JointVector<N>,
        motion: &Joints,
        wish: &JointVector<N>,
        distance_min: f64,
    ) -> Option<JointVector<N>> {
        let jacobian = self.scaled_tool_jacobian(q);
        let gram = jacobian * jacobian.transpose();
        let exact = gram.cholesky()?;
        let distance = 1.0 / exact.inverse().trace().sqrt();
        if distance.is_nan() || distance < distance_min {
            return None;
        }
        let square = damping_squared(distance, DAMPING_BEGINS_RATIO * distance_min, distance_min);
        let mut scaled = *motion;
        for row in 0..3 {
            scaled[row] /= self.mean_link_m;
        }
        let forces = match square > 0.0 {
            true => (gram + Matrix6::identity() * square).cholesky()?.solve(&scaled),
            false => exact.solve(&scaled),
        };
        let mut step = jacobian.tr_mul(&forces);
        if N > 6 {
            step += wish - jacobian.tr_mul(&exact.solve(&(jacobian * wish)));
        }
        step.iter().all(|x| x.is_finite()).then_some(step)
    }

    /// The Jacobian in tool axes with its rows of positions divided by the mean link length.
    fn scaled_tool_jacobian(&self, q: &JointVector<N>) -> Jacobian<N> {
        let mut jacobian = self.jacobian_tool(q);
        for column in 0..N {
            for row in 0..3 {
                jacobian[(row, column)] /= self.mean_link_m;
            }
        }
        jacobian
    }
}
