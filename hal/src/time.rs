//! Time as an integer number of nanoseconds, and the clock as a device. Time is never a
//! floating-point number, and a clock is always passed as an argument.

use core::fmt;
use core::ops::{Add, AddAssign, Mul, Sub, SubAssign};

/// An instant (nanoseconds since the start of the run) or a span, signed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Nanos(pub i64);

impl Nanos {
    /// The start of the run, or no time at all.
    pub const ZERO: Nanos = Nanos(0);
    /// Later than every instant of a run.
    pub const MAX: Nanos = Nanos(i64::MAX);

    /// A span of whole microseconds.
    #[must_use]
    pub const fn from_micros(us: i64) -> Nanos {
        Nanos(us * 1_000)
    }

    /// A span of whole milliseconds.
    #[must_use]
    pub const fn from_millis(ms: i64) -> Nanos {
        Nanos(ms * 1_000_000)
    }

    /// A span of whole seconds.
    #[must_use]
    pub const fn from_secs(s: i64) -> Nanos {
        Nanos(s * 1_000_000_000)
    }

    /// The span in seconds, for arithmetic of laws and plots; never fed back into a schedule.
    #[must_use]
    #[expect(
        clippy::cast_precision_loss,
        reason = "spans of a run stay far below 2^53 ns = 104 days"
    )]
    pub fn as_secs_f64(self) -> f64 {
        self.0 as f64 * 1e-9
    }

    /// The span in microseconds, for reports.
    #[must_use]
    pub fn as_micros_f64(self) -> f64 {
        self.as_secs_f64() * 1e6
    }
}

impl Add for Nanos {
    type Output = Nanos;
    fn add(self, other: Nanos) -> Nanos {
        Nanos(self.0 + other.0)
    }
}

impl AddAssign for Nanos {
    fn add_assign(&mut self, other: Nanos) {
        self.0 += other.0;
    }
}

impl Sub for Nanos {
    type Output = Nanos;
    fn sub(self, other: Nanos) -> Nanos {
        Nanos(self.0 - other.0)
    }
}

impl SubAssign for Nanos {
    fn sub_assign(&mut self, other: Nanos) {
        self.0 -= other.0;
    }
}

impl Mul<i64> for Nanos {
    type Output = Nanos;
    fn mul(self, n: i64) -> Nanos {
        Nanos(self.0 * n)
    }
}

impl fmt::Display for Nanos {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            n if n % 1_000_000 == 0 => write!(f, "{} ms", n / 1_000_000),
            n if n % 1_000 == 0 => write!(f, "{} us", n / 1_000),
            n => write!(f, "{n} ns"),
        }
    }
}

/// A source of time. Two exist: the kernel's monotonic clock and the virtual one, which only moves
/// when told to.
pub trait Clock {
    /// Nanoseconds since the start of the run; negative before it.
    fn now(&self) -> Nanos;
    /// Returns at or after `instant`; at once when it has passed.
    fn sleep_until(&self, instant: Nanos);
}
