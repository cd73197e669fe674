//! Converts joint torques to converter codes, checks the window of the following error, and decides
//! whether codes may leave in the present mode. The mode machine decides whether torque is allowed.

use taktil_mechanics::spatial::JointVector;
use taktil_mechanics::transmission::{Drive, Transmission};
use taktil_rtcore::{FaultCode, Mode};

/// The codes for one joint torque, and the torque that they make.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Command<const N: usize = 6> {
    /// Codes of the motors.
    pub codes: [i32; N],
    /// Joint torques (N m) that these codes make, after all limits and rounding.
    pub tau_nm: [f64; N],
    /// Bit j is set when the torque asked of joint j, or the motor of joint j, was limited.
    pub limited: u32,
}

/// Limits, gears and amplifiers.
#[derive(Clone, Debug)]
pub struct Law<const N: usize = 6> {
    transmission: Transmission<N>,
    drive: Drive<N>,
    torque_limit_nm: JointVector<N>,
    /// Codes at which no current flows.
    zero: [i32; N],
}

impl<const N: usize> Law<N> {
    /// Limits are at the joints, N m, positive.
    #[must_use]
    pub fn new(
        transmission: Transmission<N>,
        drive: Drive<N>,
        torque_limit_nm: JointVector<N>,
    ) -> Law<N> {
        Law { transmission, drive, torque_limit_nm, zero: [0; N] }
    }

    /// The same law for converters whose zero is displaced; `zero` holds the codes at which no
    /// current flows.
    #[must_use]
    pub fn with_zero(self, zero: [i32; N]) -> Law<N> {
        Law { zero, ..self }
    }

    /// Codes for a joint torque (N m): the torque is clamped at the joints, transmitted through the
    /// gears, rounded, and clamped at the converter.
    ///
    /// # Errors
    /// [`FaultCode::NotFinite`] when any joint's torque is NaN or infinite.
    pub fn command(&self, tau_nm: &[f64; N]) -> Result<Command<N>, FaultCode> {
        if !tau_nm.iter().all(|tau| tau.is_finite()) {
            return Err(FaultCode::NotFinite);
        }
        let mut limited = 0;
        let mut joint_nm = JointVector::zeros();
        for (i, tau) in tau_nm.iter().enumerate() {
            let limit = self.torque_limit_nm[i];
            joint_nm[i] = tau.clamp(-limit, limit);
            if tau.abs() > limit {
                limited |= 1 << i;
            }
        }
        let asked_nm = self.transmission.motor_torque(&joint_nm);
        let mut codes = [0; N];
        let mut motor_nm = JointVector::zeros();
        for (i, code) in codes.iter_mut().enumerate() {
            let (low, high) = self.drive.code_range();
            *code = (self.drive.dac_code(asked_nm[i], i) + self.zero[i]).clamp(low, high);
            motor_nm[i] = self.drive.motor_torque_nm(*code - self.zero[i], i);
            // Rounding moves a torque by at most half a step; more than that was cut off at the end
            // of the range.
            if (asked_nm[i] - motor_nm[i]).abs() > 0.6 * self.drive.motor_torque_nm(1, i) {
                limited |= 1 << i;
            }
        }
        Ok(Command { codes, tau_nm: self.joint_torque(&motor_nm), limited })
    }

    /// Joint torques (N m) that one code on all channels makes; used for the safe value.
    #[must_use]
    pub fn torque_of(&self, code: i32) -> [f64; N] {
        self.joint_torque(&JointVector::from_fn(|i, _| {
            self.drive.motor_torque_nm(code - self.zero[i], i)
        }))
    }

    /// Joint torques (N m) that the motors make at these codes, one each.
    #[must_use]
    pub fn torque_made(&self, codes: &[i32; N]) -> [f64; N] {
        self.joint_torque(&JointVector::from_fn(|i, _| self.drive.motor_torque_nm(codes[i], i)))
    }

    fn joint_torque(&self, motor_nm: &JointVector<N>) -> [f64; N] {
        self.transmission.joint_torque(motor_nm).into()
    }
}

/// The window in which a joint has to follow: half width `floor + gain * |speed|`.
#[derive(Clone, Copy, Debug)]
pub struct FollowingWindow<const N: usize = 6> {
    /// Half width at rest, rad.
    pub floor_rad: [f64; N],
    /// Growth with the desired speed, s. The measured speed must not widen the window: a joint that
    /// runs away would open it for itself.
    pub gain_s: f64,
}

impl<const N: usize> FollowingWindow<N> {
    /// True when every joint is inside the window. The edge belongs to the window, NaN does not.
    #[must_use]
    pub fn contains(&self, error_rad: &[f64; N], desired_rad_s: &[f64; N]) -> bool {
        let half = |i: usize| self.floor_rad[i] + self.gain_s * desired_rad_s[i].abs();
        (0..N).all(|i| error_rad[i].abs() <= half(i))
    }
}

/// Whether codes other than the safe value may leave, and why they may not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gate {
    /// Torque may leave.
    Open,
    /// The mode does not allow torque.
    Shut,
    /// The mode allows torque, but an input that should arrive in each job has stopped arriving.
    Silent,
}

/// The gate for a mode, given whether a torque and this job's control state are there.
///
/// `own` is the mode that came with this job's control state (`None`: it did not come), `told` the
/// mode that the machine told this task. Both have to allow torque.
#[must_use]
pub fn gate(own: Option<Mode>, told: Mode, torque: bool) -> Gate {
    match own {
        None if told.torque_allowed() => Gate::Silent,
        None => Gate::Shut,
        Some(own) if !(own.torque_allowed() && told.torque_allowed()) => Gate::Shut,
        Some(_) if torque => Gate::Open,
        Some(_) => Gate::Silent,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_mechanics::Joints;

    fn law(limit: f64) -> Law {
        Law::new(Transmission::reference(), Drive::reference(), Joints::repeat(limit))
    }

    #[test]
    fn the_converter_offset_is_added_and_the_reported_torque_is_the_applied_one() {
        let law = || Law::new(Transmission::reference(), Drive::reference(), Joints::repeat(1e6));
        let (plain, moved) = (law(), law().with_zero([10, -7, 0, 3, 0, 100]));
        let asked = [1.0, -2.0, 0.5, 0.1, -0.1, 0.05];
        let (a, b) = (plain.command(&asked).unwrap(), moved.command(&asked).unwrap());
        for (i, zero) in [10, -7, 0, 3, 0, 100].into_iter().enumerate() {
            assert_eq!(b.codes[i], a.codes[i] + zero);
        }
        assert_eq!((b.tau_nm, b.limited), (a.tau_nm, a.limited));
        assert_eq!(moved.command(&[0.0; 6]).unwrap().codes, [10, -7, 0, 3, 0, 100]);
        // A displaced zero takes a part of the range on one side, and no torque beyond the rest is
        // reported.
        let (full, cut) = (plain.command(&[1e3; 6]).unwrap(), moved.command(&[1e3; 6]).unwrap());
        assert_eq!((cut.codes[0], cut.limited & 1), (2047, 1));
        assert!(cut.tau_nm[0] < full.tau_nm[0]);
        assert_eq!(moved.torque_of(10)[0], plain.torque_of(0)[0]);
    }

    #[test]
    fn a_moderate_torque_arrives_within_half_a_step_per_motor() {
        let asked = [1.0, -2.0, 0.5, 0.3, -0.2, 0.1];
        let command = law(5.0).command(&asked).unwrap();
        assert_eq!(command.limited, 0);
        for (made, wanted) in command.tau_nm.iter().zip(asked) {
            assert!((made - wanted).abs() < 0.006, "{command:?}");
        }
        assert!(command.codes[0] > 0 && command.codes[1] < 0);
    }

    #[test]
    fn the_coupling_of_the_wrist_is_in_the_torque_map() {
        let command = law(5.0).command(&[0.0, 0.0, 0.0, 0.0, 0.0, 0.5]).unwrap();
        assert_ne!(command.codes[5], 0);
        assert_ne!(command.codes[4], 0, "motor 5 has to balance what motor 6 does to joint 5");
        assert!((command.tau_nm[5] - 0.5).abs() < 2e-3 && command.tau_nm[4].abs() < 2e-3);
    }

    #[test]
    fn each_joint_is_clamped_at_its_limit_and_reported() {
        let law = law(0.8);
        let at = law.command(&[0.8, -0.8, 0.8, 0.0, 0.0, 0.0]).unwrap();
        assert_eq!(at.limited, 0, "the limit itself is allowed");
        let over = law.command(&[1e300, -0.8000001, 0.0, 0.0, f64::MAX, 0.0]).unwrap();
        assert_eq!(over.limited & 0b01_0011, 0b01_0011);
        let same = law.command(&[0.8, -0.8, 0.0, 0.0, 0.8, 0.0]).unwrap();
        assert_eq!(over.codes, same.codes);
    }

    #[test]
    fn a_motor_at_the_end_of_its_range_is_limited_too() {
        let drive = Drive::reference();
        let peak = drive.peak_joint_torque(&Transmission::reference());
        let law = Law::new(Transmission::reference(), drive, Joints::repeat(1e6));
        let command = law.command(&[2.0 * peak[0], 0.0, -2.0 * peak[2], 0.0, 0.0, 0.0]).unwrap();
        assert_eq!((command.codes[0], command.codes[2]), (2047, -2048));
        assert_eq!(command.limited, 0b101);
        assert!((command.tau_nm[0] - peak[0]).abs() < 0.01 * peak[0]);
        let slightly = law.command(&[peak[0] + 0.02, 0.0, 0.0, 0.0, 0.0, 0.0]).unwrap();
        assert_eq!((slightly.codes[0], slightly.limited), (2047, 1), "three steps too much");
        let negative_end = law.command(&[-peak[0], 0.0, 0.0, 0.0, 0.0, 0.0]).unwrap();
        assert_eq!((negative_end.codes[0], negative_end.limited), (-2048, 0));
    }

    #[test]
    fn non_finite_numbers_are_refused_on_every_joint() {
        for i in 0..6 {
            for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
                let mut tau = [0.0; 6];
                tau[i] = bad;
                assert_eq!(law(1.0).command(&tau), Err(FaultCode::NotFinite));
            }
        }
    }

    #[test]
    fn zero_torque_needs_no_current() {
        let command = law(1.0).command(&[0.0, -0.0, 0.0, -0.0, 0.0, 0.0]).unwrap();
        assert_eq!((command.codes, command.limited), ([0; 6], 0));
        assert_eq!(law(1.0).torque_of(0), [0.0; 6]);
    }

    #[test]
    fn the_window_grows_with_speed_and_includes_its_edge() {
        let window = FollowingWindow { floor_rad: [0.25; 6], gain_s: 0.5 };
        let one = |i: usize, x: f64| core::array::from_fn(|k| if k == i { x } else { 0.0 });
        for i in 0..6 {
            assert!(window.contains(&one(i, -0.25), &[0.0; 6]));
            assert!(!window.contains(&one(i, -0.250_001), &[0.0; 6]));
            assert!(window.contains(&one(i, 0.75), &one(i, -1.0)));
            assert!(
                !window.contains(&one(i, 0.75), &one((i + 1) % 6, -1.0)),
                "its own speed counts"
            );
            assert!(!window.contains(&one(i, f64::NAN), &[0.0; 6]));
            assert!(!window.contains(&[0.0; 6], &one(i, f64::NAN)));
        }
        assert!(!window.contains(&[f64::INFINITY; 6], &[1.0; 6]));
    }

    #[test]
    fn torque_leaves_only_when_both_modes_and_a_torque_say_so() {
        for own in Mode::ALL {
            for told in Mode::ALL {
                let both = own.torque_allowed() && told.torque_allowed();
                let open = gate(Some(own), told, true);
                assert_eq!(open == Gate::Open, both, "{own:?} {told:?}");
                assert_eq!(gate(Some(own), told, false) == Gate::Silent, both, "{own:?} {told:?}");
            }
            assert_ne!(gate(None, own, true), Gate::Open);
            assert_eq!(gate(None, own, true) == Gate::Silent, own.torque_allowed());
        }
    }
}
