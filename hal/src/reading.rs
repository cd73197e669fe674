//! A value and the instant at which it was acquired.

use crate::time::Nanos;

/// How many channels one half carries at most.
pub const CHANNELS: usize = 32;

/// What an input half hands out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Reading<T> {
    /// The value, in the device's own units.
    pub value: T,
    /// When the device latched it, in logical time: never later than the release that asked for
    /// it, never earlier than the reading before it.
    pub acquired: Nanos,
}
