//! What the thread of a port does: it reads, answers the dialogue, hands scans over, and opens the
//! port again after the cable was pulled.

use rtrb::{Consumer, Producer, RingBuffer};
use taktil_hal::{Clock, Invalid, Nanos, OpenError};

use crate::array::SerialTactile;
use crate::board::{Phase, StartError};
use crate::config::{ArrayGeometry, Config};
use crate::error;
use crate::health::Health;
use crate::monitor::LineMonitor;
use crate::port::SerialFile;
use crate::session::{Outlet, Scan, Session};

/// Bytes that one cycle reads at most.
pub const READ_BYTES_MAX: usize = 4_096;
/// Reports that may wait for the lane.
const REPORTS_MAX: usize = 4;
/// Longest sleep of a worker without a port: how soon it sees that its half is gone.
const SLEEP_MAX: Nanos = Nanos::from_millis(50);

/// The rings between a line and its half: scans go out filled and come back empty, and reports of
/// the line's health go beside them. Neither side waits for the other.
pub struct ScanRings {
    filled: Producer<Box<Scan>>,
    empty: Consumer<Box<Scan>>,
    /// A scan that was taken and could not be handed on.
    spare: Option<Box<Scan>>,
    reports: Producer<Health>,
}

impl ScanRings {
    fn new(config: &Config, geometry: &ArrayGeometry) -> (SerialTactile, ScanRings) {
        let scans = config.queue_scans as usize;
        let (filled, from_worker) = RingBuffer::new(scans);
        let (mut to_worker, empty) = RingBuffer::new(scans);
        for _ in 0..scans {
            let _ = to_worker.push(Box::new(Scan::new(geometry)));
        }
        let (reports, read_reports) = RingBuffer::new(REPORTS_MAX);
        let array = SerialTactile::new(*geometry, from_worker, to_worker, read_reports);
        (array, ScanRings { filled, empty, spare: None, reports })
    }

    /// Reports the health of the line to the half, as far as there is room: a lane that looks finds
    /// a recent one.
    pub fn report(&mut self, health: Health) {
        let _ = self.reports.push(health);
    }

    fn is_abandoned(&self) -> bool {
        self.filled.is_abandoned()
    }
}

impl Outlet for ScanRings {
    fn take(&mut self) -> Option<Box<Scan>> {
        self.spare.take().or_else(|| self.empty.pop().ok())
    }

    fn put(&mut self, scan: Box<Scan>) {
        if let Err(rtrb::PushError::Full(scan)) = self.filled.push(scan) {
            self.spare = Some(scan);
        }
    }
}

impl std::fmt::Debug for ScanRings {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ScanRings").field("waiting", &self.spare.is_some()).finish_non_exhaustive()
    }
}

/// An array whose bytes somebody else carries, such as a model of the board in the same process in
/// virtual time: bytes go into the session, whose outlet the rings are, and requests come out of
/// it. The dialogue was not begun; `config.path` is not looked at.
///
/// # Errors
/// The configuration is refused.
pub fn attach(config: &Config) -> Result<(SerialTactile, Session, ScanRings), Invalid> {
    let session = Session::new(config)?;
    let (array, rings) = ScanRings::new(config, session.geometry());
    Ok((array, session, rings))
}

/// The part of an open array that owns the port. It runs in a thread of its own.
pub struct Worker {
    config: Config,
    clock: Box<dyn Clock + Send>,
    port: Option<SerialFile>,
    session: Session,
    rings: ScanRings,
    monitor: LineMonitor,
    bytes: Box<[u8; READ_BYTES_MAX]>,
    retry_at: Nanos,
    retry_pause: Nanos,
}

/// Opens an array, leads it through its start-up dialogue and waits for its first scan. `clock`
/// gives the time of the run; scans are stamped in it.
///
/// # Errors
/// The configuration is refused, the port cannot be opened, or the board does not start; the
/// message names the cause and the remedy.
pub fn open(
    config: &Config,
    clock: Box<dyn Clock + Send>,
) -> Result<(SerialTactile, Worker), OpenError> {
    config.check()?;
    let (array, session, rings) = attach(config)?;
    let port = SerialFile::open(config).map_err(|error| error::port(config, &error))?;
    let now = clock.now();
    let mut worker = Worker {
        config: config.clone(),
        clock,
        port: Some(port),
        session,
        rings,
        monitor: LineMonitor::default(),
        bytes: Box::new([0; READ_BYTES_MAX]),
        retry_at: now,
        retry_pause: Nanos::from_millis(i64::from(config.retry_min_ms)),
    };
    worker.session.restart(now);
    let deadline = now + Nanos::from_millis(2 * i64::from(config.start_timeout_ms));
    while worker.session.phase() != Phase::Streaming {
        worker.exchange().map_err(|_| error::start(config, StartError::NoAnswer("open")))?;
        if let Phase::Failed(error) = worker.session.phase() {
            return Err(error::start(config, error));
        }
        if worker.clock.now() >= deadline {
            return Err(error::start(config, StartError::NoAnswer("start")));
        }
    }
    Ok((array, worker))
}

impl Worker {
    /// Runs until the half is dropped.
    pub fn run(mut self) {
        while self.cycle() {}
    }

    /// Whether the tty has taken the low-latency setting.
    #[must_use]
    pub fn is_low_latency(&self) -> bool {
        self.port.as_ref().is_some_and(SerialFile::is_low_latency)
    }

    /// Counters and state.
    #[must_use]
    pub fn health(&self) -> Health {
        self.session.health()
    }

    /// The counters, for any thread.
    #[must_use]
    pub fn monitor(&self) -> LineMonitor {
        self.monitor.clone()
    }

    /// Reads once, waiting at most [`POLL_MAX_MS`](crate::POLL_MAX_MS), or tries once to open the
    /// port again. Answers whether the half is still there.
    pub fn cycle(&mut self) -> bool {
        if self.rings.is_abandoned() {
            return false;
        }
        if self.port.is_none() {
            self.reopen();
        } else if self.exchange().is_err() {
            self.close();
        } else if matches!(self.session.phase(), Phase::Failed(_)) {
            // Another device may be on the path now, or the board was too slow.
            self.close();
        }
        let health = self.session.health();
        self.rings.report(health);
        self.monitor.publish(&health);
        true
    }

    /// One read and what follows from it.
    fn exchange(&mut self) -> std::io::Result<()> {
        let Some(port) = &mut self.port else { return Ok(()) };
        let count = port.read(&mut self.bytes[..])?;
        let now = self.clock.now();
        self.session.push(now, &self.bytes[..count], &mut self.rings);
        if let Some(request) = self.session.poll(now) {
            port.write(request.bytes())?;
        }
        Ok(())
    }

    fn close(&mut self) {
        self.port = None;
        self.session.disconnect();
        self.retry_at = self.clock.now() + self.retry_pause;
    }

    fn reopen(&mut self) {
        let now = self.clock.now();
        if now < self.retry_at {
            self.clock.sleep_until(self.retry_at.min(now + SLEEP_MAX));
            return;
        }
        match SerialFile::open(&self.config) {
            Ok(port) => {
                self.port = Some(port);
                self.session.reconnect(now);
                self.retry_pause = Nanos::from_millis(i64::from(self.config.retry_min_ms));
            }
            Err(_) => {
                let longest = Nanos::from_millis(i64::from(self.config.retry_max_ms));
                self.retry_pause = (self.retry_pause * 2).min(longest);
                self.retry_at = now + self.retry_pause;
            }
        }
    }
}

impl std::fmt::Debug for Worker {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Worker")
            .field("path", &self.config.path)
            .field("open", &self.port.is_some())
            .field("session", &self.session)
            .finish_non_exhaustive()
    }
}
