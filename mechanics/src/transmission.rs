//! The transmission between joints and motors, with the coupling of the wrist: encoder counts,
//! torques, and the codes of the digital-to-analogue converters that set motor currents.

use crate::spatial::{JointMatrix, JointVector, Joints, Matrix6};
use core::f64::consts::TAU;

/// Motor revolutions per joint revolution of the PUMA 260, as published for the Babybot robot. The
/// tooth ratios are 1168/25, 5248/75, 3224/75, 1958/45, 512/13 and 413/13.
pub const GEAR_RATIO: [f64; 6] = [46.72, 69.9733, 42.9867, 43.5111, 39.3846, 31.7692];
/// Encoder counts per motor revolution after quadrature (same source).
pub const COUNTS_PER_REVOLUTION: [f64; 6] = [1000.0, 1000.0, 1000.0, 800.0, 800.0, 800.0];
/// Revolutions of motor 5 per revolution of joint 4 (same source).
pub const COUPLING_54: f64 = -9.8462;
/// Revolutions of motor 6 per revolution of joint 4 (same source).
pub const COUPLING_64: f64 = 1.0;
/// Revolutions of motor 6 per revolution of joint 5 (same source).
pub const COUPLING_65: f64 = -5.6;

/// The transmission: `motor angle = G joint angle` with the transmission matrix G (Craig, section
/// 8.5). For the PUMA 260 it is lower triangular, because joints 4 and 5 move motors 5 and 6.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transmission<const N: usize = 6> {
    gear_matrix: JointMatrix<N>,
    gear_matrix_inverse: JointMatrix<N>,
    counts_per_motor_rad: JointVector<N>,
}

impl Transmission<6> {
    /// The gears of the PUMA 260; the encoders read zero at q = 0.
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
    /// Gears without coupling. `ratio` is motor revolutions per joint revolution, negative where
    /// the motor runs in the other direction; `counts_per_rev` is encoder counts per motor
    /// revolution. The encoders read zero at q = 0. A ratio or count that is zero or not finite
    /// makes angles that are not finite.
    #[must_use]
    pub fn uncoupled(ratio: &JointVector<N>, counts_per_rev: &JointVector<N>) -> Transmission<N> {
        Transmission {
            gear_matrix: JointMatrix::from_diagonal(ratio),
            gear_matrix_inverse: JointMatrix::from_diagonal(&ratio.map(f64::recip)),
            counts_per_motor_rad: counts_per_rev / TAU,
        }
    }

    /// The same gears with encoders whose counts per revolution are `scale` times as many.
    #[must_use]
    pub fn with_encoder_scale(&self, scale: f64) -> Transmission<N> {
        Transmission { counts_per_motor_rad: self.counts_per_motor_rad * scale, ..*self }
    }

    /// The same gears with motor `i` turning `ratio[i]` times as far and an encoder of
    /// `counts_per_rev[i]` counts per motor revolution.
    #[must_use]
    pub fn rescaled(
        &self,
        ratio: &JointVector<N>,
        counts_per_rev: &JointVector<N>,
    ) -> Transmission<N> {
        Transmission {
            gear_matrix: JointMatrix::from_diagonal(ratio) * self.gear_matrix,
            gear_matrix_inverse: self.gear_matrix_inverse
                * JointMatrix::from_diagonal(&ratio.map(f64::recip)),
            counts_per_motor_rad: counts_per_rev / TAU,
        }
    }

    /// Encoder counts at joint angles `q` (rad), not rounded.
    #[must_use]
    pub fn exact_counts(&self, q: &JointVector<N>) -> JointVector<N> {
        (self.gear_matrix * q).component_mul(&self.counts_per_motor_rad)
    }

    /// Encoder counts at joint angles `q` (rad), rounded to the nearest integer, halves away from
    /// zero. Counts beyond 32 bits saturate; counts that are NaN become 0.
    #[must_use]
    pub fn counts(&self, q: &JointVector<N>) -> [i32; N] {
        let exact = self.exact_counts(q);
        core::array::from_fn(|i| saturating_i32(exact[i].round()))
    }

    /// Joint angles (rad) at encoder counts.
    #[must_use]
    pub fn joints(&self, counts: &[i32; N]) -> JointVector<N> {
        let counts = JointVector::<N>::from(counts.map(f64::from));
        self.gear_matrix_inverse * counts.component_div(&self.counts_per_motor_rad)
    }

    /// The motor torques that produce the joint torques `joint_nm` (N m): `G^-T tau`.
    #[must_use]
    pub fn motor_torque(&self, joint_nm: &JointVector<N>) -> JointVector<N> {
        self.gear_matrix_inverse.tr_mul(joint_nm)
    }

    /// The joint torques that the motor torques `motor_nm` produce (N m): `G^T tau`.
    #[must_use]
    pub fn joint_torque(&self, motor_nm: &JointVector<N>) -> JointVector<N> {
        self.gear_matrix.tr_mul(motor_nm)
    }

    /// Motor speeds at joint speeds `qd` (rad/s); also motor angles at joint angles (rad).
    #[must_use]
    pub fn motor_speed(&self, qd: &JointVector<N>) -> JointVector<N> {
        self.gear_matrix * qd
    }

    /// Encoder counts per revolution of each motor.
    #[must_use]
    pub fn counts_per_revolution(&self) -> JointVector<N> {
        self.counts_per_motor_rad * TAU
    }

    /// The transmission matrix G (motor rad per joint rad).
    #[must_use]
    pub fn gear_matrix(&self) -> &JointMatrix<N> {
        &self.gear_matrix
    }
}

/// The current amplifiers of the motors and the digital-to-analogue converter in front of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drive<const N: usize = 6> {
    /// Torque constants (N m/A).
    pub torque_constant_nm_a: JointVector<N>,
    /// Current at full scale of the converter (A).
    pub current_max_a: JointVector<N>,
    /// Number of bits of the two's complement code; values outside 2..=24 are clamped to that
    /// range.
    pub dac_bits: u32,
}

impl Drive<6> {
    /// Estimates for the PUMA 260: torque constants near those of the PUMA 560, scaled; the 5 A
    /// amplifiers of a documented retrofit; a converter of 12 bits like that of the thesis's
    /// eight-channel board.
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
    /// The number of codes between zero and full scale: 2048 for 12 bits.
    fn codes_at_full_scale(&self) -> f64 {
        f64::from(1_i32 << (self.dac_bits.clamp(2, 24) - 1))
    }

    /// The lowest and the highest code: -2048 and 2047 for 12 bits.
    #[must_use]
    pub fn code_range(&self) -> (i32, i32) {
        let half = 1_i32 << (self.dac_bits.clamp(2, 24) - 1);
        (-half, half - 1)
    }

    /// The torque of the motor of `joint` (0..N) at full scale (N m); 0 for any other number.
    #[must_use]
    pub fn full_scale_nm(&self, joint: usize) -> f64 {
        if joint < N { self.torque_constant_nm_a[joint] * self.current_max_a[joint] } else { 0.0 }
    }

    /// The code nearest to the torque `motor_nm` (N m) of the motor of `joint`, clamped to the
    /// range of codes. It is 0, the code of no current, for NaN, for a joint outside 0..N and for a
    /// motor without torque.
    #[must_use]
    pub fn dac_code(&self, motor_nm: f64, joint: usize) -> i32 {
        let full = self.full_scale_nm(joint);
        if motor_nm.is_nan() || full.is_nan() || full <= 0.0 {
            return 0;
        }
        let (low, high) = self.code_range();
        saturating_i32((motor_nm / full * self.codes_at_full_scale()).round()).clamp(low, high)
    }

    /// The torque of the motor of `joint` at `code` (N m); the code is clamped to the range of
    /// codes.
    #[must_use]
    pub fn motor_torque_nm(&self, code: i32, joint: usize) -> f64 {
        let (low, high) = self.code_range();
        f64::from(code.clamp(low, high)) / self.codes_at_full_scale() * self.full_scale_nm(joint)
    }

    /// The largest torque at each joint (N m), with its own motor at full scale and no current in
    /// the other motors.
    #[must_use]
    pub fn peak_joint_torque(&self, gears: &Transmission<N>) -> JointVector<N> {
        JointVector::from_fn(|i, _| self.full_scale_nm(i) * gears.gear_matrix[(i, i)].abs())
    }
}

/// The inverse of the lower triangular matrix `l`, by forward substitution.
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

/// A rounded number as an integer: saturated beyond 32 bits, and 0 for NaN.
#[expect(clippy::cast_possible_truncation, reason = "saturation is intended")]
fn saturating_i32(x: f64) -> i32 {
    x as i32
}
