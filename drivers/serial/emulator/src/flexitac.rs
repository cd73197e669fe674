//! A FlexiTac board: it streams AA 55 and one byte a tactel from power-up on and hears nothing.

use taktil_hal::Nanos;

use crate::Board;
use crate::scan::ScanClock;

/// The board, with counts of 10 bits of which the upper 8 are sent.
#[derive(Clone, Debug)]
pub struct FlexiTac {
    tactels: usize,
    clock: ScanClock,
    diagnostic: bool,
}

impl FlexiTac {
    /// A board of this size that scans at `rate_hz`, since time zero.
    #[must_use]
    pub fn new(rows: usize, cols: usize, rate_hz: f64) -> FlexiTac {
        let mut clock = ScanClock::stopped(rate_hz);
        clock.start(Nanos::ZERO);
        FlexiTac { tactels: rows * cols, clock, diagnostic: false }
    }

    /// The same board with the makers' diagnostic firmware, which prints text.
    #[must_use]
    pub fn with_diagnostic_text(mut self) -> FlexiTac {
        self.diagnostic = true;
        self
    }
}

impl Board for FlexiTac {
    fn receive(&mut self, _now: Nanos, _bytes: &[u8], _out: &mut Vec<Vec<u8>>) {}

    fn scan_due(&self) -> Nanos {
        self.clock.due()
    }

    fn scan(&mut self, values: &[u16], out: &mut Vec<Vec<u8>>) {
        self.clock.advance();
        if self.diagnostic {
            let words: Vec<String> = values.iter().map(u16::to_string).collect();
            out.push(format!("frame: {}\r\n", words.join(" ")).into_bytes());
            return;
        }
        let mut message = vec![0xaa, 0x55];
        message.extend(values.iter().map(|value| (*value).min(255) as u8));
        out.push(message);
    }

    fn restart(&mut self, now: Nanos) {
        self.clock.start(now);
    }

    fn tactels(&self) -> usize {
        self.tactels
    }

    fn byte_time(&self) -> Nanos {
        Nanos(5_000)
    }
}
