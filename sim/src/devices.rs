//! The hal halves of the simulated bench. Each holds one end of a stamped link to the world and the
//! newest value that was visible when it was sampled. It never shows a value from after its
//! release, and it contains no physics.

use std::collections::BTreeMap;

use taktil_hal::link::{Receiver, Sender, link};
use taktil_hal::{
    AdcCode, AnalogIn, AnalogOut, Arrival, CHANNELS, Counts, DacCode, DigitalIn, DigitalOut,
    Encoders, Error, ErrorKind, FORCE_TORQUE_CHANNELS, ForceTorque, GaugeCodes, IndexPulses,
    LinesIn, LinesOut, Nanos, Reading, TactileArray, TactileFrame,
};

use crate::scan_link::{ScanReceiver, ScanSender, scan_link};

/// Number of values that a link holds until they are taken: more than half a second at 400 Hz.
pub(crate) const LINK_CAPACITY: usize = 256;
/// Silence after which the simulated boards go to their safe state by themselves.
pub const LONGEST_SILENCE: Nanos = Nanos::from_millis(50);
/// Largest code of the simulated A/D and gauges, which have 12 bits.
pub const ADC_MAX: i32 = 2047;

/// The most tactile arrays of a world: one on each finger of a hand.
pub(crate) const ARRAYS_MAX: usize = crate::hand::grasp::FINGERS_MAX;
/// Names of the arrays on the fingers of a hand.
pub(crate) const HAND_ARRAYS: [&str; ARRAYS_MAX] =
    ["tactile_finger1", "tactile_finger2", "tactile_finger3"];

/// The world's ends of all links.
#[derive(Debug)]
pub(crate) struct WorldLinks {
    pub(crate) counts: Sender<[Counts; CHANNELS]>,
    /// Present on a board that latches index pulses.
    pub(crate) marks: Option<Sender<IndexPulses>>,
    pub(crate) currents: Sender<[AdcCode; CHANNELS]>,
    pub(crate) gauges: Sender<[AdcCode; FORCE_TORQUE_CHANNELS]>,
    pub(crate) lines: Sender<LinesIn>,
    /// The scans of the finger's array and of the array opposed to it, or of a hand's fingers.
    pub(crate) scans: [ScanSender; ARRAYS_MAX],
    pub(crate) codes: Receiver<[i32; CHANNELS]>,
    pub(crate) lines_out: Receiver<LinesOut>,
}

/// The boards of an arm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct BoardSpec {
    /// Number of wired channels, one for each joint.
    pub(crate) joints: usize,
    /// Lowest and highest code of the D/A converter.
    pub(crate) code_min: i32,
    pub(crate) code_max: i32,
}

/// The description that a tactile array gives of itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct TactileSpec {
    /// Its name among the devices.
    pub(crate) name: &'static str,
    pub(crate) rows: usize,
    pub(crate) cols: usize,
    /// Its largest reading (counts).
    pub(crate) full_scale: u16,
    /// Time from one row's reading to the next one's.
    pub(crate) row: Nanos,
}

/// Makes all links. `index` says whether the encoder board latches index pulses; `tactile`
/// describes the arrays, where they exist.
pub(crate) fn connect(
    delay: Nanos,
    board: BoardSpec,
    index: bool,
    tactile: [Option<TactileSpec>; ARRAYS_MAX],
) -> (WorldLinks, taktil_hal::Devices) {
    let (counts_tx, counts_rx) = link(LINK_CAPACITY);
    let (marks_tx, marks_rx) = index.then(|| link(LINK_CAPACITY)).unzip();
    let (currents_tx, currents_rx) = link(LINK_CAPACITY);
    let (gauges_tx, gauges_rx) = link(LINK_CAPACITY);
    let (lines_tx, lines_rx) = link(LINK_CAPACITY);
    let (scan_txs, scan_rxs) = scan_links(tactile);
    let (codes_tx, codes_rx) = link(LINK_CAPACITY);
    let (orders_tx, orders_rx) = link(LINK_CAPACITY);
    let links = WorldLinks {
        counts: counts_tx,
        marks: marks_tx,
        currents: currents_tx,
        gauges: gauges_tx,
        lines: lines_tx,
        scans: scan_txs,
        codes: codes_rx,
        lines_out: orders_rx,
    };
    let mut arrays = BTreeMap::new();
    for (scans, spec) in scan_rxs.into_iter().zip(tactile) {
        if let Some(spec) = spec {
            let array: Box<dyn TactileArray> = Box::new(SimTactile::new(scans, spec));
            arrays.insert(spec.name.to_owned(), array);
        }
    }
    let devices = taktil_hal::Devices {
        encoders: Some(Box::new(SimEncoders {
            counts: NewestReading::new(counts_rx, "sim.encoders"),
            marks: marks_rx.map(|marks| NewestReading::new(marks, "sim.encoders")),
            joints: board.joints,
        })),
        analog_out: Some(Box::new(SimAnalogOut {
            order: DelayedOutput::new(codes_tx, delay),
            board,
        })),
        analog_in: Some(Box::new(SimAnalogIn {
            currents: NewestReading::new(currents_rx, "sim.analog_in"),
            joints: board.joints,
        })),
        tactile: arrays,
        force_torque: Some(Box::new(SimForceTorque(NewestReading::new(
            gauges_rx,
            "sim.force_torque",
        )))),
        drive_out: None,
        drive_in: None,
        board_clock: None,
        digital_in: Some(Box::new(SimDigitalIn(NewestReading::new(lines_rx, "sim.digital_in")))),
        digital_out: Some(Box::new(SimDigitalOut {
            order: DelayedOutput::new(orders_tx, delay),
            last: LinesOut::SAFE,
        })),
    };
    (links, devices)
}

/// The links of all arrays, senders first.
fn scan_links(
    tactile: [Option<TactileSpec>; ARRAYS_MAX],
) -> ([ScanSender; ARRAYS_MAX], [ScanReceiver; ARRAYS_MAX]) {
    let [a, b, c] = tactile.map(|spec| match spec {
        Some(spec) => scan_link(LINK_CAPACITY, spec.rows * spec.cols),
        None => scan_link(1, 0),
    });
    ([a.0, b.0, c.0], [a.1, b.1, c.1])
}

impl WorldLinks {
    /// Ends of links whose other ends do not exist.
    pub(crate) fn disconnected() -> WorldLinks {
        WorldLinks {
            counts: link(1).0,
            marks: None,
            currents: link(1).0,
            gauges: link(1).0,
            lines: link(1).0,
            scans: core::array::from_fn(|_| scan_link(1, 0).0),
            codes: link(1).1,
            lines_out: link(1).1,
        }
    }

    /// Sends the first value of a new link with a stamp of the past, which is visible at once. A
    /// new link always has room for it.
    pub(crate) fn send<T: Copy>(to: &mut Sender<T>, value: T, stamp: Nanos) {
        let _ = to.send(value, stamp, stamp);
    }
}

/// An input half: the newest visible value, held until a newer one is visible.
pub(crate) struct NewestReading<T> {
    from: Receiver<T>,
    reading: Option<Reading<T>>,
    asked: Nanos,
    device: &'static str,
}

impl<T: Copy> NewestReading<T> {
    pub(crate) fn new(from: Receiver<T>, device: &'static str) -> NewestReading<T> {
        NewestReading { from, reading: None, asked: Nanos(i64::MIN), device }
    }

    /// Samples at a release; the same release gives the same reading, whatever has arrived in
    /// between.
    pub(crate) fn sample(&mut self, release: Nanos) -> Result<Reading<T>, Error> {
        if release > self.asked || self.reading.is_none() {
            self.asked = release;
            if let Some(new) = self.from.newest(release) {
                self.reading = Some(Reading { value: new.value, acquired: new.stamp });
            }
        }
        self.reading.ok_or(Error::whole(ErrorKind::Stale, self.device))
    }
}

/// An output half: commands that act one actuation delay after their release.
pub(crate) struct DelayedOutput<T> {
    to: Sender<T>,
    delay: Nanos,
    latest: Nanos,
}

impl<T: Copy> DelayedOutput<T> {
    pub(crate) fn new(to: Sender<T>, delay: Nanos) -> DelayedOutput<T> {
        DelayedOutput { to, delay, latest: Nanos::ZERO }
    }

    pub(crate) fn send(
        &mut self,
        value: T,
        release: Nanos,
        device: &'static str,
    ) -> Result<(), Error> {
        let visible = (release + self.delay).max(self.latest);
        self.to
            .send(value, release, visible)
            .map_err(|_| Error::whole(ErrorKind::Transient, device))?;
        self.latest = visible;
        Ok(())
    }

    /// Sends a command that acts as early as possible, at the instant of the latest command on its
    /// way.
    pub(crate) fn send_now(&mut self, value: T, device: &'static str) -> Result<(), Error> {
        self.send(value, self.latest - self.delay, device)
    }
}

struct SimEncoders {
    counts: NewestReading<[Counts; CHANNELS]>,
    marks: Option<NewestReading<IndexPulses>>,
    joints: usize,
}

impl Encoders for SimEncoders {
    fn joints(&self) -> usize {
        self.joints
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[Counts; CHANNELS]>, Error> {
        if let Some(marks) = &mut self.marks {
            // The marks are sent together with the counts, so that the counts' answer covers both.
            let _ = marks.sample(release);
        }
        self.counts.sample(release)
    }

    fn has_index(&self) -> bool {
        self.marks.is_some()
    }

    fn index_pulses(&self) -> IndexPulses {
        let reading = self.marks.as_ref().and_then(|marks| marks.reading);
        reading.map_or([None; CHANNELS], |reading| reading.value)
    }
}

struct SimAnalogIn {
    currents: NewestReading<[AdcCode; CHANNELS]>,
    joints: usize,
}

impl AnalogIn for SimAnalogIn {
    fn channels(&self) -> usize {
        self.joints
    }

    fn code_range(&self) -> (AdcCode, AdcCode) {
        (AdcCode(-ADC_MAX - 1), AdcCode(ADC_MAX))
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[AdcCode; CHANNELS]>, Error> {
        self.currents.sample(release)
    }
}

struct SimForceTorque(NewestReading<[AdcCode; FORCE_TORQUE_CHANNELS]>);

impl ForceTorque for SimForceTorque {
    fn sample(&mut self, release: Nanos) -> Result<Reading<GaugeCodes>, Error> {
        let Reading { value, acquired } = self.0.sample(release)?;
        let value = GaugeCodes::within(AdcCode(-ADC_MAX - 1), AdcCode(ADC_MAX), value);
        Ok(Reading { value, acquired })
    }
}

struct SimDigitalIn(NewestReading<LinesIn>);

impl DigitalIn for SimDigitalIn {
    fn sample(&mut self, release: Nanos) -> Result<Reading<LinesIn>, Error> {
        self.0.sample(release)
    }
}

struct SimTactile {
    scans: ScanReceiver,
    spec: TactileSpec,
}

impl SimTactile {
    fn new(scans: ScanReceiver, spec: TactileSpec) -> SimTactile {
        SimTactile { scans, spec }
    }
}

impl TactileArray for SimTactile {
    fn rows(&self) -> usize {
        self.spec.rows
    }

    fn cols(&self) -> usize {
        self.spec.cols
    }

    fn full_scale(&self) -> u16 {
        self.spec.full_scale
    }

    fn sample(&mut self, release: Nanos, frame: &mut TactileFrame) -> Result<Arrival, Error> {
        if !frame.fits(self) {
            return Err(Error::whole(ErrorKind::OutOfRange, "sim.tactile"));
        }
        let Some(scan) = self.scans.newest(release) else {
            return Ok(Arrival::Held);
        };
        frame.sequence = scan.sequence;
        frame.acquired = scan.stamp;
        frame.values.copy_from_slice(&scan.values);
        frame.valid.fill(true);
        for (row, acquired) in frame.row_acquired.iter_mut().enumerate() {
            let rest = (self.spec.rows - 1).saturating_sub(row) as i64;
            *acquired = (scan.stamp - self.spec.row * rest).max(Nanos::ZERO);
        }
        Ok(Arrival::New)
    }
}

struct SimAnalogOut {
    order: DelayedOutput<[i32; CHANNELS]>,
    board: BoardSpec,
}

const ANALOG_OUT: &str = "sim.analog_out";

impl AnalogOut for SimAnalogOut {
    fn channels(&self) -> usize {
        self.board.joints
    }

    fn code_range(&self) -> (DacCode, DacCode) {
        (DacCode(self.board.code_min), DacCode(self.board.code_max))
    }

    fn commit(&mut self, release: Nanos, codes: &[DacCode; CHANNELS]) -> Result<(), Error> {
        let mut word = [0; CHANNELS];
        for (channel, (slot, code)) in
            word.iter_mut().zip(codes).enumerate().take(self.board.joints)
        {
            if !(self.board.code_min..=self.board.code_max).contains(&code.0) {
                return Err(Error::on_channel(ErrorKind::OutOfRange, ANALOG_OUT, channel as u16));
            }
            *slot = code.0;
        }
        self.order.send(word, release, ANALOG_OUT)
    }

    fn safe(&mut self) -> Result<(), Error> {
        self.order.send_now([0; CHANNELS], ANALOG_OUT)
    }

    fn safe_value(&self) -> DacCode {
        DacCode(0)
    }

    fn longest_silence(&self) -> Nanos {
        LONGEST_SILENCE
    }
}

impl Drop for SimAnalogOut {
    fn drop(&mut self) {
        // The link is full only when the world has stopped; then nothing is left to make safe.
        let _ = self.safe();
    }
}

struct SimDigitalOut {
    order: DelayedOutput<LinesOut>,
    last: LinesOut,
}

const DIGITAL_OUT: &str = "sim.digital_out";

impl DigitalOut for SimDigitalOut {
    fn commit(&mut self, release: Nanos, lines: &LinesOut) -> Result<(), Error> {
        self.order.send(*lines, release, DIGITAL_OUT)?;
        self.last = *lines;
        Ok(())
    }

    fn safe(&mut self) -> Result<(), Error> {
        let safe = LinesOut { watchdog_feed: self.last.watchdog_feed, ..LinesOut::SAFE };
        self.order.send_now(safe, DIGITAL_OUT)
    }

    fn longest_silence(&self) -> Nanos {
        LONGEST_SILENCE
    }
}

impl Drop for SimDigitalOut {
    fn drop(&mut self) {
        // The link is full only when the world has stopped; then its brakes are on.
        let _ = self.safe();
    }
}
