//! The end stops of joints: a joint that reaches one stays there without bouncing.

use taktil_mechanics::spatial::{JointMatrix, JointVector};

/// Holds joints at their end stops. Each blow acts on one joint alone, so that the momenta of the
/// others stay and their speeds change: `qd -= M^-1 e_i (qd_i / (M^-1)_ii)` (Featherstone, Rigid
/// Body Dynamics Algorithms, 2008, section 11.7, without restitution). `limits` gives the lowest
/// and the highest angle of a joint (rad), `inertia` the mass matrix M at joint angles (kg m^2);
/// speeds in rad/s.
pub(crate) fn stop_at_limits<const N: usize>(
    q: &mut JointVector<N>,
    qd: &mut JointVector<N>,
    limits: impl Fn(usize) -> (f64, f64),
    inertia: impl Fn(&JointVector<N>) -> JointMatrix<N>,
) {
    for i in 0..N {
        let (low, high) = limits(i);
        let inside = q[i].clamp(low, high);
        if inside == q[i] {
            continue;
        }
        q[i] = inside;
        // Where the mass matrix is not positive definite the joint stops alone.
        if let Some(factor) = inertia(q).cholesky() {
            let blow = JointVector::<N>::from_fn(|j, _| f64::from(u8::from(i == j)));
            let thrown = factor.solve(&blow);
            *qd -= thrown * (qd[i] / thrown[i]);
        }
        qd[i] = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_blow_on_an_end_stop_leaves_the_momenta_of_the_other_joints() {
        // Two coupled joints; the first arrives at its stop, the second is free.
        let inertia = JointMatrix::<2>::new(0.5, 0.2, 0.2, 0.3);
        let (mut q, mut qd) = (JointVector::<2>::new(1.01, 0.0), JointVector::<2>::new(0.4, -0.1));
        let before = qd;
        stop_at_limits(&mut q, &mut qd, |_| (-1.0, 1.0), |_| inertia);
        assert_eq!((q[0], qd[0]), (1.0, 0.0));
        let blow = inertia * (qd - before);
        assert!(blow[0] < -0.1, "{blow}");
        assert!(blow[1].abs() < 1e-15, "{blow}");
        // The momentum of the second, 0.2 * 0.4 - 0.3 * 0.1, is all its own now.
        assert!((qd[1] - 0.05 / 0.3).abs() < 1e-15, "{qd}");
        // No energy comes out of a stop.
        assert!(qd.dot(&(inertia * qd)) < before.dot(&(inertia * before)));
    }

    #[test]
    fn joints_inside_their_limits_are_left_alone() {
        let (mut q, mut qd) = (JointVector::<2>::new(1.0, -1.0), JointVector::<2>::new(0.4, -0.1));
        stop_at_limits(&mut q, &mut qd, |_| (-1.0, 1.0), |_| unreachable!("no joint arrives"));
        assert_eq!((q, qd), (JointVector::<2>::new(1.0, -1.0), JointVector::<2>::new(0.4, -0.1)));
    }
}
