//! Checks by central differences that a Jacobian is the derivative of its pose.

use nalgebra::{SMatrix, SVector, Vector3};
use taktil_mechanics::Pose;
use taktil_mechanics::spatial::{rotate_spatial_vector, to_nalgebra_matrix, to_nalgebra_vector};

/// Panics unless the Jacobians `base` and `tool`, in the base and in the tool frame, agree with
/// central differences of `pose` at `q`, and with each other for the speeds `qd`.
pub(crate) fn check<const N: usize>(
    q: &SVector<f64, N>,
    qd: &SVector<f64, N>,
    pose: impl Fn(&SVector<f64, N>) -> Pose,
    base: SMatrix<f64, 6, N>,
    tool: SMatrix<f64, 6, N>,
) {
    let here = pose(q);
    for joint in 0..N {
        let step = |h: f64| {
            let mut moved = *q;
            moved[joint] += h;
            pose(&moved)
        };
        let (ahead, behind) = (step(1e-6), step(-1e-6));
        let v = (ahead.translation - behind.translation) / 2e-6;
        let rate = to_nalgebra_matrix(&((ahead.rotation - behind.rotation) * 5e5))
            * to_nalgebra_matrix(&here.rotation).transpose();
        let w = Vector3::new(rate[(2, 1)], rate[(0, 2)], rate[(1, 0)]);
        assert!((base.fixed_view::<3, 1>(0, joint) - to_nalgebra_vector(v)).amax() < 1e-9);
        assert!((base.fixed_view::<3, 1>(3, joint) - w).amax() < 1e-9);
    }
    assert!((rotate_spatial_vector(&here.rotation, &(tool * qd)) - base * qd).amax() < 1e-14);
}
