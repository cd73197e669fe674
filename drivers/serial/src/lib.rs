//! Tactile arrays on serial lines: Myrmex v2 (AGNI serial protocol), FlexiTac, Weiss WTS and Weiss
//! DSA, each with its start-up dialogue, its framing and its check sums.
//!
//! # Three layers
//!
//! - [`Session`] is a pure state machine: bytes and instants in, requests and stamped scans out. It
//!   runs in virtual time as well as on a wire.
//! - [`Worker`] owns the port. A thread of the machine calls [`Worker::cycle`] (or
//!   [`Worker::run`]); it reads what is there, answers the dialogue, hands scans over rings without
//!   locks, and opens the port again by its path after the cable was pulled, with growing pauses.
//! - [`SerialTactile`] is the half for a lane. It takes the newest scan acquired at or before the
//!   release and never waits.
//!
//! ```no_run
//! use taktil_drivers_serial::{Config, open};
//! # use taktil_hal::{Clock, Nanos, TactileArray};
//! # struct Monotonic;
//! # impl Clock for Monotonic {
//! #     fn now(&self) -> Nanos { Nanos::ZERO }
//! #     fn sleep_until(&self, _: Nanos) {}
//! # }
//!
//! let config = Config { path: "/dev/ttyACM0".to_owned(), ..Config::default() };
//! let (mut array, worker) = open(&config, Box::new(Monotonic))?;
//! std::thread::spawn(move || worker.run());
//! assert_eq!((array.rows(), array.cols()), (16, 16));
//! # Ok::<(), taktil_hal::OpenError>(())
//! ```
//!
//! # Time
//!
//! A scan is stamped with the arrival of its last byte, less what arrived behind it, less the
//! transfer time of the message, less the configured latency; rows lie evenly over the scan time
//! before that. Arrivals jitter by the host's buffers and scheduling, always to the late side: the
//! stamp follows the lower envelope of the arrivals ([`ArrivalEstimator`]), and the distance
//! between arrivals and envelope is reported as the spread ([`Health::spread`]).
//!
//! # What can go wrong
//!
//! Damaged messages are left out and counted, missing scans are counted by the gaps between
//! arrivals. Their share of a window makes the line healthy, degraded or lost ([`LineState`]). A
//! lost line answers [`Stale`](taktil_hal::ErrorKind::Stale) and may come back;
//! [`Lost`](taktil_hal::ErrorKind::Lost), which is final, means that the worker has ended.
//!
//! FlexiTac messages carry no length, number or check sum: a changed byte is not seen, and a
//! picture that stands still and holds AA 55 can be locked on at the wrong place. Myrmex has a sum
//! of 8 bits: one damaged message in 256 is taken for a good one.
//!
//! # System calls
//!
//! `SerialTactile::sample`: none ([`SYSTEM_CALLS`] is empty). `Worker::cycle` while the port is
//! open: `poll` (at most [`POLL_MAX_MS`]), `read` and `write` without waiting, and those of the
//! clock. It allocates only while the port is opened again. Work of a call is bounded by
//! [`READ_BYTES_MAX`] and the queue.

mod array;
mod board;
mod buffer;
mod checksum;
mod config;
mod error;
mod health;
mod monitor;
mod payload;
mod port;
mod session;
mod timing;
mod udev;
mod worker;

use taktil_hal::SystemCall;

pub use array::SerialTactile;
pub use board::{Phase, REQUEST_BYTES_MAX, Request, StartError};
pub use config::{ArrayGeometry, BoardKind, COLS_MAX, Config, Pressure, ROWS_MAX};

pub use health::{Health, LineState};
pub use monitor::LineMonitor;
pub use port::{POLL_MAX_MS, SerialFile};
pub use session::{Outlet, Scan, Session};
pub use taktil_hal::OpenError;
pub use timing::{Arrival, ArrivalEstimator};
pub use udev::UDEV_RULES;
pub use worker::{READ_BYTES_MAX, ScanRings, Worker, attach, open};

/// What the half asks of the kernel within a job: nothing. The worker's calls are made on a thread
/// of its own.
pub const SYSTEM_CALLS: &[SystemCall] = &[];
