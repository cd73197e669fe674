//! Moves the double of a board on, and tells what it puts out, for the tests of the driver.
#![allow(dead_code, reason = "each test binary takes what it needs")]

mod node;

use taktil_hal::conformance::CycleDriver;
use taktil_hal::{CHANNELS, DacCode, LinesOut, Nanos};

#[allow(unused_imports, reason = "each test binary takes what it needs")]
pub(crate) use node::{FIRST_OUTPUT_LINE, SharedDouble, robot_config};

pub(crate) const CYCLE_PERIOD: Nanos = Nanos::from_micros(2_500);
/// Numbers of the subdevices of the double's robot board.
pub(crate) const ANALOG_IN_SUBDEVICE: usize = 0;
pub(crate) const ANALOG_OUT_SUBDEVICE: usize = 1;
pub(crate) const LINES_SUBDEVICE: usize = 2;
pub(crate) const COUNTERS_SUBDEVICE: usize = 3;

/// The codes that the double's D/A channels put out.
pub(crate) fn codes_out(double: &SharedDouble) -> [DacCode; CHANNELS] {
    let double = double.look();
    core::array::from_fn(|at| {
        DacCode(double.sample(ANALOG_OUT_SUBDEVICE, at).cast_signed() - 0x8000)
    })
}

/// The lines as a cell that is wired to the double sees them; what is not driven is false.
pub(crate) fn lines_out(double: &SharedDouble) -> LinesOut {
    let double = double.look();
    let level = |at: u16| double.level(LINES_SUBDEVICE, usize::from(FIRST_OUTPUT_LINE + at));
    LinesOut {
        enable: level(0) == Some(true),
        brake_release: level(1) == Some(false),
        watchdog_feed: level(2) == Some(true),
    }
}

/// Moves the double on: discs turn, voltages change.
pub(crate) fn advance(double: &SharedDouble, now: Nanos) {
    let mut double = double.look();
    double.advance(now);
    let step = now.0 / CYCLE_PERIOD.0;
    for channel in 0..8 {
        double.set_count(COUNTERS_SUBDEVICE, channel, 1_000 * step * (channel as i64 - 3));
        double.set_sample(
            ANALOG_IN_SUBDEVICE,
            channel,
            (step as u32 * 37 + channel as u32) & 0xffff,
        );
    }
}

/// Cycles that move the double on.
pub(crate) fn bench(double: &SharedDouble) -> CycleDriver<'_> {
    CycleDriver::new(Nanos::ZERO, CYCLE_PERIOD, |now| advance(double, now))
}
