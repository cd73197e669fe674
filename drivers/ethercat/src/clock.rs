//! The half of a segment's clock: the phase of the frames by the reference clock.

use std::sync::Arc;

use taktil_drivers_exchange::Shared;
use taktil_hal::{BoardClock, Error, ErrorKind, Nanos, Reading};

use crate::bus::Bus;
use crate::halves::Input;

const CLOCK_NAME: &str = "ethercat.board_clock";

/// The distributed clocks of a segment, by the one that all others follow.
#[derive(Debug)]
pub struct EthercatClock {
    input: Input,
    cycle: Nanos,
}

impl EthercatClock {
    pub(crate) fn new(shared: Arc<Shared<Bus>>, cycle: Nanos, wait: Nanos) -> EthercatClock {
        EthercatClock { input: Input::new(shared, CLOCK_NAME, wait), cycle }
    }
}

impl BoardClock for EthercatClock {
    fn cycle(&self) -> Nanos {
        self.cycle
    }

    fn longest_wait(&self) -> Nanos {
        self.input.wait
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<Nanos>, Error> {
        let Reading { value: phase, acquired } =
            self.input.sample(release, |snapshot| snapshot.phase)?;
        // A segment without a reference clock tells no time.
        let value = phase.ok_or(Error::whole(ErrorKind::Transient, CLOCK_NAME))?;
        Ok(Reading { value, acquired })
    }
}
