//! One line as a pure state machine: bytes and instants in, requests and stamped scans out.

use taktil_hal::{Invalid, Nanos};

use crate::board::{Agni, Board, FlexiTac, Phase, Request, Verdict, View, Weiss};
use crate::buffer::ByteBuffer;
use crate::config::{ArrayGeometry, BoardKind, Config, Pressure};
use crate::health::{Health, HealthMonitor};
use crate::payload::Payload;
use crate::timing::ArrivalEstimator;

/// One scan of the array, before a lane has taken it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Scan {
    /// Numbers the scans; gaps are scans that did not arrive.
    pub sequence: u32,
    /// When the last row was read.
    pub acquired: Nanos,
    /// From the read of one row to that of the next.
    pub row_period: Nanos,
    /// Counts, row by row; they grow under pressure.
    pub values: Box<[u16]>,
}

impl Scan {
    /// An empty scan of an array.
    #[must_use]
    pub fn new(geometry: &ArrayGeometry) -> Scan {
        Scan {
            sequence: 0,
            acquired: Nanos::ZERO,
            row_period: geometry.row_period,
            values: vec![0; geometry.rows * geometry.cols].into(),
        }
    }
}

/// Where scans come from empty and go to filled.
pub trait Outlet {
    /// A scan to be filled; `None` when all of them wait for a lane.
    fn take(&mut self) -> Option<Box<Scan>>;

    /// Takes a filled scan.
    fn put(&mut self, scan: Box<Scan>);
}

/// The state of one line.
pub struct Session {
    board: Box<dyn Board>,
    buffer: ByteBuffer,
    geometry: ArrayGeometry,
    estimator: ArrivalEstimator,
    monitor: HealthMonitor,
    locked: bool,
    head_at: Nanos,
    heard: Nanos,
    sequence: u32,
    stamped: Nanos,
    restarted: Nanos,
    silence: Nanos,
}

impl Session {
    /// A line that was not started yet.
    ///
    /// # Errors
    /// The configuration is refused; `path` is not looked at.
    pub fn new(config: &Config) -> Result<Session, Invalid> {
        config.check_array()?;
        let board: Box<dyn Board> = match config.board {
            BoardKind::Myrmex => Box::new(Agni::new(config)),
            BoardKind::Flexitac => Box::new(FlexiTac::new(config)),
            BoardKind::WeissWts | BoardKind::WeissDsa => Box::new(Weiss::new(config)),
        };
        let geometry = config.geometry();
        Ok(Session {
            buffer: ByteBuffer::new(board.message_bytes_max()),
            board,
            geometry,
            estimator: ArrivalEstimator::new(geometry.period),
            monitor: HealthMonitor::new(config),
            locked: false,
            head_at: Nanos::ZERO,
            heard: Nanos(i64::MIN / 4),
            sequence: 0,
            stamped: Nanos(i64::MIN),
            restarted: Nanos::ZERO,
            silence: Nanos::from_millis(i64::from(config.lost_after_ms)),
        })
    }

    /// Shape and timing of the array.
    #[must_use]
    pub fn geometry(&self) -> &ArrayGeometry {
        &self.geometry
    }

    /// Where the dialogue stands.
    #[must_use]
    pub fn phase(&self) -> Phase {
        self.board.phase()
    }

    /// Counters and state.
    #[must_use]
    pub fn health(&self) -> Health {
        self.monitor.health
    }

    /// Begins the dialogue anew, on a fresh port or after a silence.
    pub fn restart(&mut self, now: Nanos) {
        self.buffer.clear();
        self.locked = false;
        self.restarted = now;
        self.estimator.interrupt();
        self.monitor.health.restarts += 1;
        self.board.restart(now);
    }

    /// The port is gone.
    pub fn disconnect(&mut self) {
        self.monitor.disconnect();
        self.estimator.interrupt();
        self.locked = false;
    }

    /// The port was opened again.
    pub fn reconnect(&mut self, now: Nanos) {
        self.monitor.health.reopened += 1;
        self.restart(now);
    }

    /// Judges the line and gives the request that is due. A board that has streamed and is silent
    /// is started anew, because it may have forgotten its settings.
    pub fn poll(&mut self, now: Nanos) -> Option<Request> {
        self.monitor.update(now);
        let silent = self.monitor.is_silent(now) && now - self.restarted >= self.silence;
        if self.board.phase() == Phase::Streaming && silent {
            self.restart(now);
        }
        self.board.poll(now, self.heard)
    }

    /// Takes bytes that were received at `now`.
    ///
    /// Work is bounded: each step drops at least one byte or waits for more, and looks at one
    /// message's length at most.
    pub fn push(&mut self, now: Nanos, mut bytes: &[u8], outlet: &mut dyn Outlet) {
        if !bytes.is_empty() {
            self.heard = now;
        }
        while !bytes.is_empty() {
            if self.buffer.unread().is_empty() {
                self.head_at = now;
            }
            let count = self.buffer.append(bytes);
            bytes = &bytes[count..];
            self.scan_buffer(now, bytes.len(), outlet);
        }
    }

    fn scan_buffer(&mut self, now: Nanos, behind: usize, outlet: &mut dyn Outlet) {
        loop {
            let unread = self.buffer.unread();
            if unread.is_empty() {
                return;
            }
            let view = View { bytes: unread, locked: self.locked, head_at: self.head_at, now };
            match self.board.examine(view) {
                Verdict::Incomplete => return,
                Verdict::Skip(count) => {
                    self.monitor.health.skipped_bytes += count as u64;
                    self.monitor.health.garbled += u64::from(self.locked);
                    self.locked = false;
                    self.buffer.consume(count.max(1));
                }
                Verdict::Message(length) => {
                    self.locked = true;
                    let (image, complete) = self.board.accept(&unread[..length], now);
                    let after = (unread.len() - length + behind) as i64;
                    if let Some(image) = image {
                        let passed = Nanos(after * self.geometry.byte_time.0);
                        let arrival = complete.unwrap_or(now - passed);
                        let transfer = self.geometry.byte_time * length as i64;
                        let departure = arrival - self.geometry.transfer.unwrap_or(transfer);
                        let line = &mut Line {
                            geometry: &self.geometry,
                            estimator: &mut self.estimator,
                            monitor: &mut self.monitor,
                            sequence: &mut self.sequence,
                            stamped: &mut self.stamped,
                        };
                        line.deliver(image, arrival, departure, outlet);
                    }
                    self.buffer.consume(length);
                }
            }
            self.head_at = now;
        }
    }
}

/// The parts of a session that an image concerns.
struct Line<'a> {
    geometry: &'a ArrayGeometry,
    estimator: &'a mut ArrivalEstimator,
    monitor: &'a mut HealthMonitor,
    sequence: &'a mut u32,
    stamped: &'a mut Nanos,
}

impl Line<'_> {
    /// Stamps and numbers an image and hands it on. `departure` is when the board began to send it,
    /// as late as the host makes it look.
    fn deliver(
        &mut self,
        image: Payload<'_>,
        arrival: Nanos,
        departure: Nanos,
        outlet: &mut dyn Outlet,
    ) {
        let health = &mut self.monitor.health;
        if !image.is_image(self.geometry.rows * self.geometry.cols) {
            health.garbled += 1;
            return;
        }
        let seen = self.estimator.observe(departure);
        health.missing += u64::from(seen.advance - 1);
        health.spread = self.estimator.spread();
        health.period = self.estimator.period();
        *self.sequence = self.sequence.wrapping_add(seen.advance);
        *self.stamped = (seen.undelayed - self.geometry.latency).max(*self.stamped);
        match outlet.take() {
            Some(mut scan) => {
                scan.sequence = *self.sequence;
                scan.acquired = *self.stamped;
                scan.row_period = self.geometry.row_period;
                image.decode(&mut scan.values);
                if self.geometry.pressure == Pressure::Lowers {
                    for value in &mut scan.values {
                        *value = self.geometry.full_scale.saturating_sub(*value);
                    }
                }
                outlet.put(scan);
            }
            None => health.overruns += 1,
        }
        self.monitor.scan(arrival);
    }
}

impl std::fmt::Debug for Session {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Session")
            .field("geometry", &self.geometry)
            .field("phase", &self.board.phase())
            .field("health", &self.monitor.health)
            .finish_non_exhaustive()
    }
}
