//! Reads values that the board publishes under a number. A value is never a mixture of two, is not
//! stale, and is read once per release. Reading never waits: the number of retries is bounded, and
//! a board that is busy all the time gives a transient error.

use taktil_hal::{Error, ErrorKind, Nanos, Reading};

use crate::io::RegisterFile;
use crate::registers::{Block, ID, ID_VALUE};

/// How often a block is read again when the board published another one meanwhile.
pub const TORN_RETRIES: usize = 3;

/// Reads a block until its two numbers agree, at most [`TORN_RETRIES`] times again; returns the
/// number, or `None` when every attempt was torn. What `copy` took from a torn attempt must not be
/// used.
pub(crate) fn read_consistent(
    registers: &RegisterFile,
    block: Block,
    mut copy: impl FnMut(&RegisterFile),
) -> Option<u16> {
    for _ in 0..=TORN_RETRIES {
        let end = registers.read(block.end);
        registers.order_reads();
        copy(registers);
        registers.order_reads();
        if registers.read(block.begin) == end {
            return Some(end);
        }
    }
    None
}

/// Checks that the board still answers; once it did not, this half stays lost.
#[derive(Debug, Default)]
pub(crate) struct Presence {
    lost: bool,
}

impl Presence {
    pub(crate) fn check(
        &mut self,
        registers: &RegisterFile,
        device: &'static str,
    ) -> Result<(), Error> {
        self.lost |= registers.read(ID) != ID_VALUE;
        if self.lost { Err(Error::whole(ErrorKind::Lost, device)) } else { Ok(()) }
    }
}

/// Turns numbered values into readings, one per release. A reading is stamped with the release at
/// which its number was seen first, and is stale when the number stands still for too long.
#[derive(Debug)]
pub(crate) struct NumberedReadings<T> {
    device: &'static str,
    stale_after: Nanos,
    presence: Presence,
    /// The number last seen and the release that saw it first.
    newest: Option<(u16, Nanos)>,
    last: Option<(Nanos, Reading<T>)>,
}

impl<T: Copy> NumberedReadings<T> {
    pub(crate) fn new(device: &'static str, stale_after: Nanos) -> NumberedReadings<T> {
        NumberedReadings {
            device,
            stale_after,
            presence: Presence::default(),
            newest: None,
            last: None,
        }
    }

    /// The reading for `release`; `read` gives the value and its number.
    pub(crate) fn sample(
        &mut self,
        registers: &RegisterFile,
        release: Nanos,
        read: impl FnOnce(&RegisterFile) -> Result<(u16, T), Error>,
    ) -> Result<Reading<T>, Error> {
        if let Some((at, reading)) = self.last
            && at == release
        {
            return Ok(reading);
        }
        self.presence.check(registers, self.device)?;
        let (number, value) = read(registers)?;
        let acquired = match self.newest {
            Some((seen, since)) if seen == number => since,
            _ => release,
        };
        self.newest = Some((number, acquired));
        if release - acquired > self.stale_after {
            return Err(Error::whole(ErrorKind::Stale, self.device));
        }
        let reading = Reading { value, acquired };
        self.last = Some((release, reading));
        Ok(reading)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registers::ADC;

    /// Tears every attempt before the `whole`-th, counted from 1; the number and the attempts.
    fn torn_until(whole: usize) -> (Option<u16>, usize) {
        let registers = RegisterFile::anonymous().unwrap();
        let mut attempts = 0;
        let number = read_consistent(&registers, ADC, |registers| {
            attempts += 1;
            let number = registers.read(ADC.end);
            let begun = if attempts < whole { number.wrapping_add(1) } else { number };
            registers.write(ADC.begin, begun);
        });
        (number, attempts)
    }

    #[test]
    fn a_torn_block_is_read_again_and_not_for_ever() {
        assert_eq!(torn_until(1), (Some(0), 1));
        assert_eq!(torn_until(TORN_RETRIES + 1), (Some(0), TORN_RETRIES + 1));
        assert_eq!(torn_until(usize::MAX), (None, TORN_RETRIES + 1));
    }
}
