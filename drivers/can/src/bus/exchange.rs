//! The bus as what its halves share: safe values, the last ones, and the numbers that are shown.

use taktil_drivers_exchange::{Exchange, Failure, Half};

use super::{Bus, END_WAITS_MAX};
use crate::monitor::BusMonitor;

impl Exchange for Bus {
    type Shown = BusMonitor;

    fn publish(&self, shown: &BusMonitor, collisions: u64) {
        shown.publish(self, collisions);
    }

    fn safe(&mut self, half: Half) -> Result<(), Failure> {
        let is_sent = self.send_safe_values(half);
        self.answer(is_sent)
    }

    /// Nothing is sent after it, so that a queue that is full is waited for, for a time that is
    /// bounded.
    fn end(&mut self, half: Half) {
        self.waits_left = END_WAITS_MAX;
        self.send_safe_values(half);
        self.waits_left = 0;
        self.has_lines &= half != Half::Lines;
    }
}
