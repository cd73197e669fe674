//! Units of a drive: torque in thousandths of the rated torque (6076), positions in counts, and
//! the interpolation period (60C2) as a number and a power of ten.

use taktil_hal::Nanos;

/// The rated torque of the motor (6076), which scales target and actual torque.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RatedTorque {
    millinewton_metres: u32,
}

impl RatedTorque {
    /// The value of object 6076 (mNm); `None` for 0, by which nothing can be divided.
    #[must_use]
    pub const fn from_millinewton_metres(millinewton_metres: u32) -> Option<RatedTorque> {
        match millinewton_metres {
            0 => None,
            _ => Some(RatedTorque { millinewton_metres }),
        }
    }

    /// The torque of a code of 6071 or 6077 (Nm).
    #[must_use]
    pub fn torque_nm(self, code: i16) -> f64 {
        f64::from(code) * f64::from(self.millinewton_metres) * 1e-6
    }

    /// The code of a torque, rounded to the nearest; `None` when the torque is not finite or has
    /// no code.
    #[must_use]
    pub fn code(self, torque_nm: f64) -> Option<i16> {
        let code = (torque_nm * 1e6 / f64::from(self.millinewton_metres)).round();
        let fits = (f64::from(i16::MIN)..=f64::from(i16::MAX)).contains(&code);
        // The range has been checked, and the number is whole.
        fits.then_some(code as i16)
    }
}

/// The resolution of the position encoder (608F): counts for a number of turns of the motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PositionScale {
    counts: u32,
    turns: u32,
}

impl PositionScale {
    /// `counts` (608F:01) for `turns` of the motor (608F:02); `None` when one of them is 0.
    #[must_use]
    pub const fn new(counts: u32, turns: u32) -> Option<PositionScale> {
        if counts == 0 || turns == 0 { None } else { Some(PositionScale { counts, turns }) }
    }

    /// Turns of the motor from zero to a position (6064).
    #[must_use]
    pub fn turns(self, position: i32) -> f64 {
        f64::from(position) * f64::from(self.turns) / f64::from(self.counts)
    }

    /// The position after so many turns, rounded to the nearest count; `None` when the number is
    /// not finite or the position has no code.
    #[must_use]
    pub fn position(self, turns: f64) -> Option<i32> {
        let counts = (turns * f64::from(self.counts) / f64::from(self.turns)).round();
        let fits = (f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(&counts);
        // The range has been checked, and the number is whole.
        fits.then_some(counts as i32)
    }
}

/// The interpolation period of object 60C2, `value` times ten to the power of `exponent` seconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InterpolationPeriod {
    /// 60C2:01.
    pub value: u8,
    /// 60C2:02.
    pub exponent: i8,
}

/// The finest power of ten of a period (s): a nanosecond.
const EXPONENT_MIN: i8 = -9;

impl InterpolationPeriod {
    /// The exact form of a period; `None` when it is not positive or has more than a byte of
    /// digits, such as 1.234 ms.
    #[must_use]
    pub fn from_nanos(period: Nanos) -> Option<InterpolationPeriod> {
        let (mut value, mut exponent) = (period.0, EXPONENT_MIN);
        while value > 0 && value % 10 == 0 {
            (value, exponent) = (value / 10, exponent + 1);
        }
        match u8::try_from(value) {
            Ok(value) if value > 0 => Some(InterpolationPeriod { value, exponent }),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn torque_is_a_thousandth_of_the_rated_one() {
        let rated = RatedTorque::from_millinewton_metres(1_270).unwrap();
        assert_eq!((rated.code(1.27), rated.code(-0.635)), (Some(1000), Some(-500)));
        assert_eq!(rated.code(0.0006), Some(0), "less than half a code is none");
        // The product of two exact numbers and 1e-6 has two roundings.
        assert!((rated.torque_nm(1000) - 1.27).abs() < 1e-12);
        for code in i16::MIN..=i16::MAX {
            assert_eq!(rated.code(rated.torque_nm(code)), Some(code));
        }
    }

    #[test]
    fn what_has_no_code_is_refused() {
        let rated = RatedTorque::from_millinewton_metres(1).unwrap();
        for torque_nm in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1.0, -1.0, 0.0328] {
            assert_eq!(rated.code(torque_nm), None, "{torque_nm}");
        }
        assert_eq!(RatedTorque::from_millinewton_metres(0), None);
        assert_eq!((PositionScale::new(0, 1), PositionScale::new(1, 0)), (None, None));
        let scale = PositionScale::new(1 << 20, 1).unwrap();
        assert_eq!([f64::NAN, 2048.0, -2049.0].map(|turns| scale.position(turns)), [None; 3]);
    }

    #[test]
    fn positions_are_counts_of_the_encoder() {
        let scale = PositionScale::new(4096, 1).unwrap();
        assert_eq!((scale.turns(2048), scale.position(-0.25)), (0.5, Some(-1024)));
        assert_eq!(PositionScale::new(1000, 3).unwrap().turns(1000), 3.0);
        assert_eq!(
            (scale.position(-524_288.0), scale.turns(i32::MIN)),
            (Some(i32::MIN), -524_288.0)
        );
    }

    #[test]
    fn a_period_has_an_exact_form_or_none() {
        let form = |micros| {
            let period = InterpolationPeriod::from_nanos(Nanos::from_micros(micros));
            period.map(|period| (period.value, period.exponent))
        };
        assert_eq!(
            [1000, 2500, 250, 125].map(form),
            [(1, -3), (25, -4), (25, -5), (125, -6)].map(Some)
        );
        assert_eq!([0, -1000, 1234].map(form), [None; 3]);
        assert_eq!(InterpolationPeriod::from_nanos(Nanos::MAX), None);
    }
}
