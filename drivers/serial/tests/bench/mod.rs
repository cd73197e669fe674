//! A session and an emulated line joined in virtual time.
#![allow(dead_code, reason = "each test binary uses a part of it")]

use taktil_drivers_serial::{Config, Outlet, Scan, Session};
use taktil_drivers_serial_emulator::{Board, Line};
use taktil_hal::Nanos;
use taktil_hal::fault::FaultPlan;

/// From one exchange of bytes to the next.
const EXCHANGE_PERIOD: Nanos = Nanos::from_micros(100);

/// Collects scans without end.
#[derive(Default)]
pub(crate) struct Shelf(pub(crate) Vec<Scan>, Option<Scan>);

impl Shelf {
    pub(crate) fn new(session: &Session) -> Shelf {
        Shelf(Vec::new(), Some(Scan::new(session.geometry())))
    }
}

impl Outlet for Shelf {
    fn take(&mut self) -> Option<Box<Scan>> {
        self.1.clone().map(Box::new)
    }

    fn put(&mut self, scan: Box<Scan>) {
        self.0.push(*scan);
    }
}

/// What an image function does: fill in the counts of an instant.
pub(crate) type Image = Box<dyn FnMut(Nanos, &mut [u16])>;

/// A session and a line.
pub(crate) struct Bench {
    pub(crate) session: Session,
    pub(crate) line: Line,
    pub(crate) scans: Vec<Scan>,
    pub(crate) image: Image,
    pub(crate) requests: Vec<Vec<u8>>,
    pub(crate) request_times: Vec<Nanos>,
    /// All bytes of the board.
    pub(crate) stream: Vec<u8>,
    /// When the board scanned.
    pub(crate) instants: Vec<Nanos>,
    now: Nanos,
    connected: bool,
}

/// Every tactel another count, another image every 10 ms. Values of 8 bits never hold AA 55.
pub(crate) fn ramp(now: Nanos, cols: usize, values: &mut [u16]) {
    let tick = (now.0 / 10_000_000) as usize;
    for (tactel, value) in values.iter_mut().enumerate() {
        *value = ((7 * (tactel / cols) + tactel % cols + 3 * tick) % 160) as u16;
    }
}

/// Faults, one a line of text.
pub(crate) fn plan(text: &str) -> FaultPlan {
    let lines = text.split(';').filter(|line| !line.trim().is_empty());
    FaultPlan::new(lines.map(|line| line.parse().unwrap()).collect())
}

impl Bench {
    pub(crate) fn new(config: &Config, board: Box<dyn Board>, faults: &str) -> Bench {
        let mut session = Session::new(config).unwrap();
        session.restart(Nanos::ZERO);
        let cols = usize::from(config.cols);
        Bench {
            session,
            line: Line::new(board, "pad", plan(faults), 5).unwrap(),
            scans: Vec::new(),
            image: Box::new(move |now, values| ramp(now, cols, values)),
            requests: Vec::new(),
            request_times: Vec::new(),
            stream: Vec::new(),
            instants: Vec::new(),
            now: Nanos::ZERO,
            connected: true,
        }
    }

    /// The instant of the board's scan that is next to a stamp.
    pub(crate) fn instant_of(&self, stamp: Nanos) -> Nanos {
        let near = self.instants.iter().min_by_key(|at| (**at - stamp).0.abs());
        *near.expect("the board has scanned")
    }

    /// Runs on to `end`; a cable that is pulled is seen as a worker sees it.
    pub(crate) fn run(&mut self, end: Nanos) {
        let mut shelf = Shelf::new(&self.session);
        let mut bytes = Vec::new();
        while self.now < end {
            self.now += EXCHANGE_PERIOD;
            bytes.clear();
            let (image, instants) = (&mut self.image, &mut self.instants);
            let mut scan = |at: Nanos, values: &mut [u16]| {
                instants.push(at);
                image(at, values);
            };
            self.line.poll(self.now, &mut scan, &mut bytes);
            let plugged = self.line.is_plugged(self.now);
            if self.connected && !plugged {
                self.session.disconnect();
            } else if !self.connected && plugged {
                self.session.reconnect(self.now);
            }
            self.connected = plugged;
            if !plugged {
                continue;
            }
            self.stream.extend(&bytes);
            self.session.push(self.now, &bytes, &mut shelf);
            if let Some(request) = self.session.poll(self.now) {
                self.requests.push(request.bytes().to_vec());
                self.request_times.push(self.now);
                self.line.receive(self.now, request.bytes());
            }
        }
        self.scans.append(&mut shelf.0);
    }
}
