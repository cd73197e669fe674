//! Between joints and motors: encoder counts, gears with the coupling of the wrist, torques and
//! the codes of the converters that set motor currents. Refuses to know which device reads or
//! writes.

use crate::spatial::{JointMatrix, JointVector, Joints, Matrix6};
use core::f64::consts::TAU;

/// Motor revolutions per joint revolution (published for the PUMA 260 of the Babybot robot; tooth
/// ratios 1168/25, 5248/75, 3224/75, 1958/45, 512/13, 413/13).
pub const GEAR_RATIO: [f64; 6] = [46.72, 69.9733, 42.9867, 43.5111, 39.3846, 31.7692];
/// Encoder counts per motor revolution after quadrature (same source).
pub const COUNTS_PER_REVOLUTION: [f64; 6] = [1000.0, 1000.0, 1000.0, 800.0, 800.0, 800.0];
/// Revolutions of motor 5 per revolution of joint 4 (same source).
pub const COUPLING_54: f64 = -9.8462;
/// Revolutions of motor 6 per revolution of joint 4 (same source).
pub const COUPLING_64: f64 = 1.0;
/// Revolutions of motor 6 per revolution of joint 5 (same source).
pub const COUPLING_65: f64 = -5.6;

/// The gears: `motor angle = G joint angle`, G lower triangular in its last three rows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transmission<const N: usize = 6> {
    gear_matrix: JointMatrix<N>,
    gear_matrix_inverse: JointMatrix<N>,
    counts_per_motor_rad: JointVector<N>,
}

impl Transmission<6> {
    /// The reference gears; zero counts at q = 0.
    #[must_use]
    pub fn reference() -> Transmission<6> {
        let mut gear = Matrix6::from_diagonal(&Joints::from(GEAR_RATIO));
        gear[(4, 3)] = COUPLING_54;
        gear[(5, 3)] = COUPLING_64;
        gear[(5, 4)] = COUPLING_65;
        Transmission {
            gear_matrix: gear,
            gear_matrix_inverse: lower_triangular_inverse(&gear),
            counts_per_motor_rad: Joints::from(COUNTS_PER_REVOLUTION) / TAU,
        }
    }
}

impl<const N: usize> Transmission<N> {
    /// Gears without coupling: motor revolutions per joint revolution (negative where the motor
    /// runs the other way), and encoder counts per motor revolution; zero counts at q = 0. Ratios
    /// and counts that are not finite or zero give angles that are not finite.
    #[must_use]
    pub fn uncoupled(ratio: &JointVector<N>, counts_per_rev: &JointVector<N>) -> Transmission<N> {
        Transmission {
            gear_matrix: JointMatrix::from_diagonal(ratio),
            gear_matrix_inverse: JointMatrix::from_diagonal(&ratio.map(f64::recip)),
            counts_per_motor_rad: counts_per_rev / TAU,
        }
    }

    /// The same gears with encoders of so many times the counts.
    #[must_use]
    pub fn with_encoder_scale(&self, scale: f64) -> Transmission<N> {
        Transmission { counts_per_motor_rad: self.counts_per_motor_rad * scale, ..*self }
    }

    /// Encoder counts of joint angles (rad), not rounded.
    #[must_use]
    pub fn exact_counts(&self, q: &JointVector<N>) -> JointVector<N> {
        (self.gear_matrix * q).component_mul(&self.counts_per_motor_rad)
    }

    /// Encoder counts of joint angles (rad), nearest whole numbers, halves away from zero. Counts
    /// beyond 32 bits stay at the end of the range; with a joint that is not finite, counts that
    /// are NaN become 0.
    #[must_use]
    pub fn counts(&self, q: &JointVector<N>) -> [i32; N] {
        let exact = self.exact_counts(q);
        core::array::from_fn(|i| saturating_i32(exact[i].round()))
    }

    /// Joint angles (rad) of encoder counts.
    #[must_use]
    pub fn joints(&self, counts: &[i32; N]) -> JointVector<N> {
        let counts = JointVector::<N>::from(counts.map(f64::from));
        self.gear_matrix_inverse * counts.component_div(&self.counts_per_motor_rad)
    }

    /// Motor torques that make joint torques (N m): `G^-T tau`.
    #[must_use]
    pub fn motor_torque(&self, joint_nm: &JointVector<N>) -> JointVector<N> {
        self.gear_matrix_inverse.tr_mul(joint_nm)
    }

    /// Joint torques that motor torques make (N m): `G^T tau`.
    #[must_use]
    pub fn joint_torque(&self, motor_nm: &JointVector<N>) -> JointVector<N> {
        self.gear_matrix.tr_mul(motor_nm)
    }

    /// Motor speeds of joint speeds (rad/s), or motor angles of joint angles (rad).
    #[must_use]
    pub fn motor_speed(&self, qd: &JointVector<N>) -> JointVector<N> {
        self.gear_matrix * qd
    }

    /// Encoder counts in one turn of each motor.
    #[must_use]
    pub fn counts_per_revolution(&self) -> JointVector<N> {
        self.counts_per_motor_rad * TAU
    }

    /// G itself (motor rad per joint rad).
    #[must_use]
    pub fn gear_matrix(&self) -> &JointMatrix<N> {
        &self.gear_matrix
    }
}

/// The current amplifiers and the converter in front of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drive<const N: usize = 6> {
    /// Torque constants (N m/A).
    pub torque_constant_nm_a: JointVector<N>,
    /// Current at full scale of the converter (A).
    pub current_max_a: JointVector<N>,
    /// Width of the two's complement code; values outside 2..=24 are taken as the nearer end.
    pub dac_bits: u32,
}

impl Drive<6> {
    /// Estimates: torque constants near the PUMA 560's scaled, 5 A amplifiers of a documented
    /// retrofit of the 260, 12 bit converter of the class of the thesis's eight-channel board.
    #[must_use]
    pub fn reference() -> Drive<6> {
        Drive {
            torque_constant_nm_a: Joints::new(0.055, 0.055, 0.055, 0.030, 0.030, 0.030),
            current_max_a: Joints::new(5.0, 5.0, 5.0, 2.0, 2.0, 2.0),
            dac_bits: 12,
        }
    }
}

impl<const N: usize> Drive<N> {
    /// Codes per full scale: 2048 for 12 bit.
    fn codes_at_full_scale(&self) -> f64 {
        f64::from(1_i32 << (self.dac_bits.clamp(2, 24) - 1))
    }

    /// Lowest and highest code: -2048 and 2047 for 12 bit.
    #[must_use]
    pub fn code_range(&self) -> (i32, i32) {
        let half = 1_i32 << (self.dac_bits.clamp(2, 24) - 1);
        (-half, half - 1)
    }

    /// Torque of the motor of `joint` (0..N) at full scale (N m); 0 for other joints.
    #[must_use]
    pub fn full_scale_nm(&self, joint: usize) -> f64 {
        if joint < N { self.torque_constant_nm_a[joint] * self.current_max_a[joint] } else { 0.0 }
    }

    /// The code nearest to a motor torque (N m), clamped to the range. NaN, a joint outside 0..N
    /// and a drive without torque give 0, the code of no current.
    #[must_use]
    pub fn dac_code(&self, motor_nm: f64, joint: usize) -> i32 {
        let full = self.full_scale_nm(joint);
        if motor_nm.is_nan() || full.is_nan() || full <= 0.0 {
            return 0;
        }
        let (low, high) = self.code_range();
        saturating_i32((motor_nm / full * self.codes_at_full_scale()).round()).clamp(low, high)
    }

    /// The motor torque (N m) of a code, clamped to the range.
    #[must_use]
    pub fn motor_torque_nm(&self, code: i32, joint: usize) -> f64 {
        let (low, high) = self.code_range();
        f64::from(code.clamp(low, high)) / self.codes_at_full_scale() * self.full_scale_nm(joint)
    }

    /// Largest torque at each joint (N m) with its own motor at full scale and the others idle.
    #[must_use]
    pub fn peak_joint_torque(&self, gears: &Transmission<N>) -> JointVector<N> {
        JointVector::from_fn(|i, _| self.full_scale_nm(i) * gears.gear_matrix[(i, i)].abs())
    }
}

/// Inverse of a lower triangular matrix by forward substitution.
fn lower_triangular_inverse(l: &Matrix6) -> Matrix6 {
    let mut inverse = Matrix6::zeros();
    for column in 0..6 {
        inverse[(column, column)] = 1.0 / l[(column, column)];
        for row in column + 1..6 {
            let mut sum = 0.0;
            for k in column..row {
                sum -= l[(row, k)] * inverse[(k, column)];
            }
            inverse[(row, column)] = sum / l[(row, row)];
        }
    }
    inverse
}

/// A rounded number as an integer; `as` saturates and sends NaN to 0.
#[expect(clippy::cast_possible_truncation, reason = "saturating is what is wanted")]
fn saturating_i32(x: f64) -> i32 {
    x as i32
}
