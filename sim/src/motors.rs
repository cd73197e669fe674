//! The motors of an arm as drives see them: their angles and speeds in counts, and what each of
//! them has to move.

use taktil_hal::CHANNELS;
use taktil_mechanics::spatial::{JointMatrix, JointVector};
use taktil_mechanics::transmission::{Drive, Transmission};

use crate::manipulator::MotorMotion;

/// Counts as numbers.
pub(crate) fn counts_of<const N: usize>(counts: &[i32; N]) -> JointVector<N> {
    JointVector::from(counts.map(f64::from))
}

/// The motion of motors at these angles (counts) and speeds (counts/s).
pub(crate) fn motor_motion<const N: usize>(
    counts: &JointVector<N>,
    counts_s: &JointVector<N>,
) -> MotorMotion {
    let mut motion = MotorMotion::default();
    for i in 0..N.min(CHANNELS) {
        (motion.counts[i], motion.counts_s[i]) = (counts[i], counts_s[i]);
    }
    motion
}

/// Codes of the drives' currents for an acceleration of one count/s^2 of each motor alone: the
/// diagonal of `G^-T M G^-1`, in which a motor feels what turns with it, over what a code makes.
pub(crate) fn codes_per_acceleration<const N: usize>(
    inertia_kg_m2: &JointMatrix<N>,
    gears: &Transmission<N>,
    drive: &Drive<N>,
) -> Vec<f64> {
    let per_count = |motor: usize| {
        let mut counts = [0; N];
        // One turn is more than the rounding of a count.
        counts[motor] = gears.counts_per_revolution()[motor].abs().round() as i32;
        let turned = gears.joints(&counts) / f64::from(counts[motor]);
        let torque_nm = gears.motor_torque(&(inertia_kg_m2 * turned))[motor];
        torque_nm / drive.motor_torque_nm(1, motor)
    };
    (0..N).map(per_count).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_mechanics::Joints;

    #[test]
    fn a_motor_alone_moves_its_inertia_over_the_square_of_its_gear() {
        let ratio = Joints::repeat(50.0);
        let gears = Transmission::<6>::uncoupled(&ratio, &Joints::repeat(1000.0));
        let inertia = JointMatrix::<6>::from_diagonal(&Joints::repeat(0.5));
        let codes = codes_per_acceleration(&inertia, &gears, &Drive::reference());
        let count_rad = core::f64::consts::TAU / 1000.0;
        let motor_nm = 0.5 / 2500.0 * count_rad;
        for (i, code) in codes.into_iter().enumerate() {
            let due = motor_nm / Drive::reference().motor_torque_nm(1, i);
            assert!((code / due - 1.0).abs() < 1e-12, "{code} {due}");
        }
    }
}
