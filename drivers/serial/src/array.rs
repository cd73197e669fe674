//! The half for a lane: it takes the newest scan from the worker's ring and never waits.

use rtrb::{Consumer, Producer};
use taktil_hal::{Arrival, Error, ErrorKind, Nanos, TactileArray, TactileFrame};

use crate::config::ArrayGeometry;
use crate::health::{Health, LineState};
use crate::session::Scan;

const DEVICE_NAME: &str = "serial.tactile";

/// A tactile array on a serial line, as a lane sees it.
///
/// A line that is lost answers [`ErrorKind::Stale`] until scans come again; a worker that has ended
/// answers [`ErrorKind::Lost`].
#[derive(Debug)]
pub struct SerialTactile {
    geometry: ArrayGeometry,
    filled: Consumer<Box<Scan>>,
    empty: Producer<Box<Scan>>,
    reports: Consumer<Health>,
    health: Health,
    last_new: Option<Nanos>,
}

impl SerialTactile {
    pub(crate) fn new(
        geometry: ArrayGeometry,
        filled: Consumer<Box<Scan>>,
        empty: Producer<Box<Scan>>,
        reports: Consumer<Health>,
    ) -> SerialTactile {
        let health = Health::default();
        SerialTactile { geometry, filled, empty, reports, health, last_new: None }
    }

    /// Counters and state as the worker reported them last.
    pub fn health(&mut self) -> Health {
        let count = self.reports.slots();
        if count > 0
            && let Ok(chunk) = self.reports.read_chunk(count)
        {
            for health in chunk {
                self.health = health;
            }
        }
        self.health
    }

    /// The newest scan acquired at or before `release`; older ones go back. Bounded by the queue.
    fn newest(&mut self, release: Nanos) -> Option<Box<Scan>> {
        let mut newest: Option<Box<Scan>> = None;
        for _ in 0..self.filled.slots() {
            if self.filled.peek().is_ok_and(|scan| scan.acquired > release) {
                break;
            }
            let Ok(scan) = self.filled.pop() else { break };
            if let Some(older) = newest.replace(scan) {
                self.give_back(older);
            }
        }
        newest
    }

    /// The ring holds all scans there are: there is always room.
    fn give_back(&mut self, scan: Box<Scan>) {
        if let Err(rtrb::PushError::Full(scan)) = self.empty.push(scan) {
            // Not reached; freeing memory in a lane would be worse than to keep it.
            std::mem::forget(scan);
        }
    }
}

/// Writes a scan into the frame of a lane: the only place that knows how a frame is laid out.
fn fill(scan: &Scan, frame: &mut TactileFrame) {
    frame.sequence = scan.sequence;
    frame.acquired = scan.acquired;
    for (to, from) in frame.values.iter_mut().zip(&scan.values) {
        *to = *from;
    }
    frame.valid.fill(true);
    let rows = frame.row_acquired.len();
    for (row, acquired) in frame.row_acquired.iter_mut().enumerate() {
        let later = rows.saturating_sub(row + 1) as i64;
        *acquired = scan.acquired - scan.row_period * later;
    }
}

impl TactileArray for SerialTactile {
    fn rows(&self) -> usize {
        self.geometry.rows
    }

    fn cols(&self) -> usize {
        self.geometry.cols
    }

    fn full_scale(&self) -> u16 {
        self.geometry.full_scale
    }

    fn sample(&mut self, release: Nanos, frame: &mut TactileFrame) -> Result<Arrival, Error> {
        if !frame.fits(self) {
            return Err(Error::whole(ErrorKind::OutOfRange, DEVICE_NAME));
        }
        if self.last_new == Some(release) {
            return Ok(Arrival::Held);
        }
        let state = self.health().state;
        let Some(scan) = self.newest(release) else {
            return if self.filled.is_abandoned() {
                Err(Error::whole(ErrorKind::Lost, DEVICE_NAME))
            } else if state == LineState::Lost {
                Err(Error::whole(ErrorKind::Stale, DEVICE_NAME))
            } else {
                Ok(Arrival::Held)
            };
        };
        let full_scale = self.geometry.full_scale;
        let beyond = scan.values.iter().position(|value| *value > full_scale);
        if beyond.is_none() {
            fill(&scan, frame);
            self.last_new = Some(release);
        }
        self.give_back(scan);
        match beyond {
            Some(tactel) => {
                Err(Error::on_channel(ErrorKind::OutOfRange, DEVICE_NAME, tactel as u16))
            }
            None => Ok(Arrival::New),
        }
    }
}
