//! Tests the bound of a joint's acceleration.

use taktil_mechanics::Joints;
use taktil_mechanics::puma260::dynamics::Dynamics;

use super::*;

#[test]
fn free_joints_accelerate_at_half_the_bound() {
    let (arm, mut most) = (Dynamics::reference(), 0.0_f64);
    let angle = |i: u32| core::f64::consts::PI * f64::from(i) / 6.0;
    for pose in 0..12_u32.pow(4) {
        let [a, b, c, d] = [1, 12, 144, 1728].map(|per| angle(pose / per % 12));
        let q = Joints::new(0.0, a, b, c, d, 0.0);
        let inertia = arm.mass_matrix(&q).cholesky().unwrap();
        most = most.max(inertia.solve(&arm.gravity_torque(&q)).amax());
    }
    assert!(
        (0.4 * FREE_ACCELERATION_RAD_S2..0.5 * FREE_ACCELERATION_RAD_S2).contains(&most),
        "{most}"
    );
}
