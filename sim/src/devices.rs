//! The hal halves of the simulated bench: each holds one end of a stamped link to the world and the
//! newest value that was visible when it was asked. Refuses to know physics, and refuses to be
//! ahead of its release.

use taktil_hal::link::{Receiver, Sender, link};
use taktil_hal::{
    AXES, AdcCode, AnalogIn, AnalogOut, Arrival, CHANNELS, Counts, DacCode, DigitalIn, DigitalOut,
    Encoders, Error, ForceTorque, Kind, LinesIn, LinesOut, MAX_TACTELS, Marks, Nanos, Reading,
    TactileArray, TactileFrame,
};

use crate::contact::SLICES;

/// Values that a link holds until they are taken: more than half a second at 400 Hz.
const CAPACITY: usize = 256;
/// Silence after which the simulated boards go safe by themselves.
pub const LONGEST_SILENCE: Nanos = Nanos::from_millis(50);
/// Codes of the simulated A/D and gauges: 12 bits.
pub const ADC_MAX: i32 = 2047;

/// One tactile scan on its way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Scan {
    pub(crate) sequence: u32,
    pub(crate) values: [u16; MAX_TACTELS],
}

/// The world's ends.
#[derive(Debug)]
pub(crate) struct WorldEnds {
    pub(crate) counts: Sender<[Counts; CHANNELS]>,
    /// Of a board that latches index pulses.
    pub(crate) marks: Option<Sender<Marks>>,
    pub(crate) currents: Sender<[AdcCode; CHANNELS]>,
    pub(crate) gauges: Sender<[AdcCode; AXES]>,
    pub(crate) lines: Sender<LinesIn>,
    /// Those of the finger and of the fingertip opposed to it.
    pub(crate) scans: [Sender<Scan>; 2],
    pub(crate) codes: Receiver<[i32; CHANNELS]>,
    pub(crate) orders: Receiver<LinesOut>,
}

/// Makes all links. `codes` is the D/A's range, `index` whether the encoder board latches index
/// pulses; of the tactile arrays, the finger's and the one opposed to it, the largest reading and
/// the time from row to row are told.
pub(crate) fn connect(
    delay: Nanos,
    (joints, codes): (usize, (i32, i32)),
    index: bool,
    tactile: [Option<(u16, Nanos)>; 2],
) -> (WorldEnds, taktil_hal::Devices) {
    let (counts_tx, counts_rx) = link(CAPACITY);
    let (marks_tx, marks_rx) = index.then(|| link(CAPACITY)).unzip();
    let (currents_tx, currents_rx) = link(CAPACITY);
    let (gauges_tx, gauges_rx) = link(CAPACITY);
    let (lines_tx, lines_rx) = link(CAPACITY);
    let ([tip_tx, opposed_tx], [tip_rx, opposed_rx]) = scan_links();
    let (codes_tx, codes_rx) = link(CAPACITY);
    let (orders_tx, orders_rx) = link(CAPACITY);
    let ends = WorldEnds {
        counts: counts_tx,
        marks: marks_tx,
        currents: currents_tx,
        gauges: gauges_tx,
        lines: lines_tx,
        scans: [tip_tx, opposed_tx],
        codes: codes_rx,
        orders: orders_rx,
    };
    let devices = taktil_hal::Devices {
        encoders: Box::new(SimEncoders {
            counts: Newest::new(counts_rx, "sim.encoders"),
            marks: marks_rx.map(|marks| Newest::new(marks, "sim.encoders")),
            joints,
        }),
        analog_out: Box::new(SimAnalogOut {
            order: Order::new(codes_tx, delay),
            range: codes,
            joints,
        }),
        analog_in: Box::new(SimAnalogIn {
            currents: Newest::new(currents_rx, "sim.analog_in"),
            joints,
        }),
        tactile: Box::new(SimTactile::new(tip_rx, tactile[0].unwrap_or_default())),
        tactile_opposed: tactile[1]
            .map(|facts| Box::new(SimTactile::new(opposed_rx, facts)) as Box<dyn TactileArray>),
        force_torque: Box::new(SimForceTorque(Newest::new(gauges_rx, "sim.force_torque"))),
        digital_in: Box::new(SimDigitalIn(Newest::new(lines_rx, "sim.digital_in"))),
        digital_out: Box::new(SimDigitalOut {
            order: Order::new(orders_tx, delay),
            last: LinesOut::SAFE,
        }),
    };
    (ends, devices)
}

/// The links of both arrays, senders first.
fn scan_links() -> ([Sender<Scan>; 2], [Receiver<Scan>; 2]) {
    let ((tip_tx, tip_rx), (opposed_tx, opposed_rx)) = (link(CAPACITY), link(CAPACITY));
    ([tip_tx, opposed_tx], [tip_rx, opposed_rx])
}

impl WorldEnds {
    /// Ends of links whose other ends are gone.
    pub(crate) fn nowhere() -> WorldEnds {
        WorldEnds {
            counts: link(1).0,
            marks: None,
            currents: link(1).0,
            gauges: link(1).0,
            lines: link(1).0,
            scans: [link(1).0, link(1).0],
            codes: link(1).1,
            orders: link(1).1,
        }
    }

    /// Says what the other ends hear first: a value of the past, which is visible at once.
    /// Links that are new have room for it.
    pub(crate) fn tell<T: Copy>(to: &mut Sender<T>, value: T, stamp: Nanos) {
        let _ = to.send(value, stamp, stamp);
    }
}

/// An input half: the newest visible value, held until a newer one is visible.
struct Newest<T> {
    from: Receiver<T>,
    held: Option<Reading<T>>,
    asked: Nanos,
    device: &'static str,
}

impl<T: Copy> Newest<T> {
    fn new(from: Receiver<T>, device: &'static str) -> Newest<T> {
        Newest { from, held: None, asked: Nanos(i64::MIN), device }
    }

    /// The same release gives the same reading, whatever has arrived meanwhile.
    fn sample(&mut self, release: Nanos) -> Result<Reading<T>, Error> {
        if release > self.asked || self.held.is_none() {
            self.asked = release;
            if let Some(new) = self.from.newest(release) {
                self.held = Some(Reading { value: new.value, acquired: new.stamp });
            }
        }
        self.held.ok_or(Error::whole(Kind::Stale, self.device))
    }
}

/// An output half: words that act one actuation delay after their release.
struct Order<T> {
    to: Sender<T>,
    delay: Nanos,
    latest: Nanos,
}

impl<T: Copy> Order<T> {
    fn new(to: Sender<T>, delay: Nanos) -> Order<T> {
        Order { to, delay, latest: Nanos::ZERO }
    }

    fn send(&mut self, value: T, release: Nanos, device: &'static str) -> Result<(), Error> {
        let visible = (release + self.delay).max(self.latest);
        self.to.send(value, release, visible).map_err(|_| Error::whole(Kind::Transient, device))?;
        self.latest = visible;
        Ok(())
    }

    /// At once: behind the words already on their way, at the latest one's instant.
    fn send_now(&mut self, value: T, device: &'static str) -> Result<(), Error> {
        self.send(value, self.latest - self.delay, device)
    }
}

struct SimEncoders {
    counts: Newest<[Counts; CHANNELS]>,
    marks: Option<Newest<Marks>>,
    joints: usize,
}

impl Encoders for SimEncoders {
    fn joints(&self) -> usize {
        self.joints
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[Counts; CHANNELS]>, Error> {
        if let Some(marks) = &mut self.marks {
            // They come with the counts: an answer there is an answer here.
            let _ = marks.sample(release);
        }
        self.counts.sample(release)
    }

    fn has_index(&self) -> bool {
        self.marks.is_some()
    }

    fn marks(&self) -> Marks {
        let held = self.marks.as_ref().and_then(|marks| marks.held);
        held.map_or([None; CHANNELS], |held| held.value)
    }
}

struct SimAnalogIn {
    currents: Newest<[AdcCode; CHANNELS]>,
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

struct SimForceTorque(Newest<[AdcCode; AXES]>);

impl ForceTorque for SimForceTorque {
    fn sample(&mut self, release: Nanos) -> Result<Reading<[AdcCode; AXES]>, Error> {
        self.0.sample(release)
    }
}

struct SimDigitalIn(Newest<LinesIn>);

impl DigitalIn for SimDigitalIn {
    fn sample(&mut self, release: Nanos) -> Result<Reading<LinesIn>, Error> {
        self.0.sample(release)
    }
}

struct SimTactile {
    scans: Receiver<Scan>,
    full_scale: u16,
    /// Time from one row's reading to the next one's.
    row: Nanos,
}

impl SimTactile {
    fn new(scans: Receiver<Scan>, (full_scale, row): (u16, Nanos)) -> SimTactile {
        SimTactile { scans, full_scale, row }
    }
}

impl TactileArray for SimTactile {
    fn rows(&self) -> usize {
        SLICES
    }

    fn cols(&self) -> usize {
        SLICES
    }

    fn full_scale(&self) -> u16 {
        self.full_scale
    }

    fn sample(&mut self, release: Nanos, frame: &mut TactileFrame) -> Result<Arrival, Error> {
        let Some(scan) = self.scans.newest(release) else {
            return Ok(Arrival::Held);
        };
        frame.rows = SLICES as u16;
        frame.cols = SLICES as u16;
        frame.sequence = scan.value.sequence;
        frame.acquired = scan.stamp;
        frame.values = scan.value.values;
        frame.valid = [true; MAX_TACTELS];
        for (row, acquired) in frame.row_acquired.iter_mut().enumerate() {
            let rest = (SLICES - 1).saturating_sub(row) as i64;
            *acquired = (scan.stamp - self.row * rest).max(Nanos::ZERO);
        }
        Ok(Arrival::New)
    }
}

struct SimAnalogOut {
    order: Order<[i32; CHANNELS]>,
    range: (i32, i32),
    joints: usize,
}

const ANALOG_OUT: &str = "sim.analog_out";

impl AnalogOut for SimAnalogOut {
    fn channels(&self) -> usize {
        self.joints
    }

    fn code_range(&self) -> (DacCode, DacCode) {
        (DacCode(self.range.0), DacCode(self.range.1))
    }

    fn commit(&mut self, release: Nanos, codes: &[DacCode; CHANNELS]) -> Result<(), Error> {
        let mut word = [0; CHANNELS];
        for (channel, (slot, code)) in word.iter_mut().zip(codes).enumerate().take(self.joints) {
            if !(self.range.0..=self.range.1).contains(&code.0) {
                return Err(Error::on_channel(Kind::OutOfRange, ANALOG_OUT, channel as u16));
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
        // A full link means a world that stopped: nothing is left to make safe.
        let _ = self.safe();
    }
}

struct SimDigitalOut {
    order: Order<LinesOut>,
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
        // As above: a world that stopped has its brakes on.
        let _ = self.safe();
    }
}
