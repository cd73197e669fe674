//! Tactile arrays on serial lines as state machines of bytes: what a host sends goes in, what the
//! board says comes out, time is an argument. [`Line`] puts a plan of faults between a board and
//! its host, [`serve`] gives the line a pseudo-terminal and paces it in real time.
//!
//! A pseudo-terminal knows no baud rate: a message appears at once when its scan is complete and
//! its transfer time has passed. The boards are written from public descriptions, apart from any
//! parser of a driver.
//!
//! ```
//! use taktil_drivers_serial_emulator::{FlexiTac, Line};
//! use taktil_hal::Nanos;
//! use taktil_hal::fault::FaultPlan;
//!
//! let board = Box::new(FlexiTac::new(16, 16, 100.0));
//! let mut line = Line::new(board, "pad", FaultPlan::default(), 1)?;
//! let mut bytes = Vec::new();
//! line.poll(Nanos::from_millis(15), &mut |_, values| values.fill(7), &mut bytes);
//! assert_eq!(bytes[..3], [0xaa, 0x55, 7]);
//! # Ok::<(), taktil_hal::Invalid>(())
//! ```

mod flexitac;
mod line;
mod myrmex;
mod scan;
mod terminal;
mod weiss;

pub use flexitac::FlexiTac;
pub use line::{EXECUTED_FAULTS, Line, Traffic};
pub use myrmex::Myrmex;
pub use terminal::{Terminal, serve};
pub use weiss::{WeissDsa, WeissWts};

use taktil_hal::Nanos;

/// A board at the end of a serial line.
pub trait Board: Send {
    /// Takes bytes from the host; answers are appended to `out`, one element a message.
    fn receive(&mut self, now: Nanos, bytes: &[u8], out: &mut Vec<Vec<u8>>);

    /// When the next scan is complete; [`Nanos::MAX`] while the board does not scan.
    fn scan_due(&self) -> Nanos;

    /// Completes the scan that is due, with an image of [`Board::tactels`] counts.
    fn scan(&mut self, values: &[u16], out: &mut Vec<Vec<u8>>);

    /// What the board says by itself at `now`, apart from scans.
    fn greet(&mut self, _now: Nanos, _out: &mut Vec<Vec<u8>>) {}

    /// When [`Board::greet`] next has something to say; [`Nanos::MAX`] for never.
    fn greet_due(&self) -> Nanos {
        Nanos::MAX
    }

    /// The power went off and on: settings are forgotten.
    fn restart(&mut self, now: Nanos);

    /// Length of an image, row by row.
    fn tactels(&self) -> usize;

    /// How long a byte takes on the line.
    fn byte_time(&self) -> Nanos;
}
