//! Denavit-Hartenberg rows (a (m), d (m), alpha (rad)) of two public arms, for tests and examples
//! that need an arm other than the PUMA 260. Limits and masses are left to each user.

use core::f64::consts::FRAC_PI_2;

use taktil_mechanics::Pose;
use taktil_mechanics::chain::{Chain, DhRow, JointSpec};

/// Six joints, 2 to 4 parallel, no spherical wrist: as Universal Robots publishes them for its
/// UR5e.
pub(crate) const UR5E_ROWS: [(f64, f64, f64); 6] = [
    (0.0, 0.1625, FRAC_PI_2),
    (-0.425, 0.0, 0.0),
    (-0.3922, 0.0, 0.0),
    (0.0, 0.1333, FRAC_PI_2),
    (0.0, 0.0997, -FRAC_PI_2),
    (0.0, 0.0996, 0.0),
];

/// Seven joints with offsets at elbow and wrist: those that Franka Robotics publishes for its arm,
/// in the standard convention.
pub(crate) const SEVEN_JOINT_ROWS: [(f64, f64, f64); 7] = [
    (0.0, 0.333, -FRAC_PI_2),
    (0.0, 0.0, FRAC_PI_2),
    (0.0825, 0.316, FRAC_PI_2),
    (-0.0825, 0.0, -FRAC_PI_2),
    (0.0, 0.384, FRAC_PI_2),
    (0.088, 0.0, FRAC_PI_2),
    (0.0, 0.107, 0.0),
];

/// The chain of such rows, every joint with the same limits.
pub(crate) fn chain<const N: usize>(rows: &[(f64, f64, f64); N], spec: &JointSpec) -> Chain<N> {
    let rows = rows.map(|(a_m, d_m, alpha_rad)| DhRow {
        a_m,
        d_m,
        alpha_rad,
        theta_rad: 0.0,
        spec: *spec,
    });
    Chain::from_dh(&rows, &Pose::IDENTITY).expect("a chain")
}
