//! Friction of the joints: Coulomb and viscous. The rigid-body dynamics leave it out; a caller adds
//! its torque.

use crate::spatial::{JointVector, Joints};

/// Friction at the joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Friction<const N: usize = 6> {
    /// Coulomb friction (N m).
    pub coulomb_nm: JointVector<N>,
    /// Viscous friction (N m s/rad).
    pub viscous_nms_rad: JointVector<N>,
}

impl Friction<6> {
    /// An estimate for the PUMA 260: the values of the PUMA 560 at its joints (Armstrong, Khatib
    /// and Burdick 1986) times 0.104, the cube of the ratio of lengths.
    #[must_use]
    pub fn reference() -> Friction<6> {
        Friction {
            coulomb_nm: Joints::new(2.708, 1.107, 0.663, 0.111, 0.0890, 0.0578),
            viscous_nms_rad: Joints::new(0.605, 0.990, 0.415, 0.0429, 0.0445, 0.0225),
        }
    }
}

impl<const N: usize> Friction<N> {
    /// The torque that overcomes friction at the joint speeds `qd` (rad/s): `viscous qd + coulomb
    /// sign(qd)` with a sign of 0 at rest (N m).
    #[must_use]
    pub fn torque_nm(&self, qd: &JointVector<N>) -> JointVector<N> {
        let sign = qd.map(|v| if v == 0.0 { 0.0 } else { v.signum() });
        self.viscous_nms_rad.component_mul(qd) + self.coulomb_nm.component_mul(&sign)
    }
}
