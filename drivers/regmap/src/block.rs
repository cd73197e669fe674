//! Reads values that the board publishes under a number. A value is never a mixture of two, is not
//! stale, and is read once per release. Reading never waits: the number of retries is bounded, and
//! a board that is busy all the time gives a transient error.

use taktil_hal::{Error, ErrorKind, Nanos, Reading};

use crate::bus::{Bus, State};

/// How often a block is read again when the board published another one meanwhile.
pub const TORN_RETRIES: usize = 3;

/// The registers of the number under which a block is published.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Numbers {
    /// Written before the words.
    pub(crate) begin: usize,
    /// Written after the words.
    pub(crate) end: usize,
}

impl Numbers {
    /// Both registers, or none.
    pub(crate) fn new(begin: Option<usize>, end: Option<usize>) -> Option<Numbers> {
        Some(Numbers { begin: begin?, end: end? })
    }
}

/// What was read is a mixture, as often as it was tried.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Torn;

/// Reads a block until its two numbers agree, at most [`TORN_RETRIES`] times again; returns the
/// number. What `copy` took from a torn attempt must not be used.
///
/// # Errors
/// Every attempt was torn.
pub(crate) fn read_consistent(
    bus: &Bus,
    numbers: Numbers,
    mut copy: impl FnMut(&Bus),
) -> Result<u32, Torn> {
    for _ in 0..=TORN_RETRIES {
        let end = bus.read(numbers.end);
        bus.order_reads();
        copy(bus);
        bus.order_reads();
        if bus.read(numbers.begin) == end {
            return Ok(end);
        }
    }
    Err(Torn)
}

/// Reads words until two passes are equal, at most [`TORN_RETRIES`] times again after the second.
///
/// # Errors
/// No pass was equal to the one before it.
pub(crate) fn read_twice<T: PartialEq>(
    bus: &Bus,
    mut pass: impl FnMut(&Bus) -> T,
) -> Result<T, Torn> {
    let mut before = pass(bus);
    for _ in 0..=TORN_RETRIES {
        bus.order_reads();
        let now = pass(bus);
        if now == before {
            return Ok(now);
        }
        before = now;
    }
    Err(Torn)
}

/// Checks that the board still answers; once it did not, this half stays lost. A board without a
/// register for that never counts as lost.
#[derive(Clone, Debug)]
pub(crate) struct Presence {
    state: Option<State>,
    lost: bool,
}

impl Presence {
    pub(crate) fn new(state: Option<State>) -> Presence {
        Presence { state, lost: false }
    }

    pub(crate) fn check(&mut self, bus: &Bus, device: &'static str) -> Result<(), Error> {
        self.lost |= self.state.is_some_and(|state| !state.holds(bus));
        if self.lost { Err(Error::whole(ErrorKind::Lost, device)) } else { Ok(()) }
    }
}

/// Turns values into readings, one per release. A value with a number is stamped with the release
/// at which its number was seen first, and is stale when the number stands still for too long; one
/// without is taken for this release.
#[derive(Debug)]
pub(crate) struct NumberedReadings<T> {
    device: &'static str,
    stale_after: Nanos,
    presence: Presence,
    /// The number last seen and the release that saw it first.
    newest: Option<(u32, Nanos)>,
    last: Option<(Nanos, Reading<T>)>,
}

impl<T: Copy> NumberedReadings<T> {
    pub(crate) fn new(
        device: &'static str,
        stale_after: Nanos,
        presence: Presence,
    ) -> NumberedReadings<T> {
        NumberedReadings { device, stale_after, presence, newest: None, last: None }
    }

    /// The reading for `release`; `read` gives the value and its number.
    pub(crate) fn sample(
        &mut self,
        bus: &Bus,
        release: Nanos,
        read: impl FnOnce(&Bus) -> Result<(Option<u32>, T), Error>,
    ) -> Result<Reading<T>, Error> {
        if let Some((at, reading)) = self.last
            && at == release
        {
            return Ok(reading);
        }
        self.presence.check(bus, self.device)?;
        let (number, value) = read(bus)?;
        let acquired = match (number, self.newest) {
            (Some(number), Some((seen, since))) if seen == number => since,
            _ => release,
        };
        self.newest = number.map(|number| (number, acquired));
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
    use crate::description::Description;
    use crate::io::RegisterFile;
    use crate::registers::ADC;
    use crate::shipped::SHIPPED_BOARDS;
    use std::sync::Arc;

    fn bus() -> Bus {
        let own = Description::from_toml(SHIPPED_BOARDS[0].1).unwrap();
        Bus::new(Arc::new(RegisterFile::anonymous().unwrap()), &own)
    }

    /// Tears every attempt before the `whole`-th, counted from 1; the number and the attempts.
    fn torn_until(whole: usize) -> (Result<u32, Torn>, usize) {
        let mut attempts = 0;
        let numbers = Numbers { begin: ADC.begin.offset_bytes(), end: ADC.end.offset_bytes() };
        let number = read_consistent(&bus(), numbers, |bus| {
            attempts += 1;
            let number = bus.read(numbers.end);
            bus.write(
                numbers.begin,
                if attempts < whole { number.wrapping_add(1) } else { number },
            );
        });
        (number, attempts)
    }

    #[test]
    fn a_torn_block_is_read_again_and_not_for_ever() {
        assert_eq!(torn_until(1), (Ok(0), 1));
        assert_eq!(torn_until(TORN_RETRIES + 1), (Ok(0), TORN_RETRIES + 1));
        assert_eq!(torn_until(usize::MAX), (Err(Torn), TORN_RETRIES + 1));
    }

    #[test]
    fn two_equal_passes_are_enough_and_none_is_waited_for() {
        let passes = |values: &[u32]| {
            let mut values = values.iter().copied();
            let mut count = 0;
            let found = read_twice(&bus(), |_| {
                count += 1;
                values.next().unwrap()
            });
            (found, count)
        };
        assert_eq!(passes(&[4, 4, 9]), (Ok(4), 2));
        assert_eq!(passes(&[1, 2, 3, 4, 4]), (Ok(4), TORN_RETRIES + 2));
        assert_eq!(passes(&[1, 2, 1, 2, 1, 1]), (Err(Torn), TORN_RETRIES + 2));
    }
}
