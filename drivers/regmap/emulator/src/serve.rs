//! Lets a board run by a clock until it is told to end.

use std::io;

use taktil_hal::Clock;

use crate::emulator::Emulator;

/// Steps the board as often as the processor allows, as long as `goes_on` says so, which may also
/// pause. A driver whose looks at a busy bit are bounded needs a board that answers within
/// microseconds.
///
/// # Errors
/// The file's.
pub fn serve(
    emulator: &mut Emulator,
    clock: &dyn Clock,
    goes_on: &mut dyn FnMut() -> bool,
) -> io::Result<()> {
    while goes_on() {
        emulator.step(clock.now())?;
    }
    Ok(())
}
