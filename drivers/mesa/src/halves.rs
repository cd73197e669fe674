//! The halves of a card: encoders, analog outputs and lines, each by hal's traits.

use std::sync::Arc;

use taktil_drivers_exchange::{Failure, Half, Presence, Shared};
use taktil_hal::{
    AnalogOut, CHANNELS, Counts, DacCode, DigitalIn, DigitalOut, Encoders, Error, ErrorKind,
    IndexPulses, LinesIn, LinesOut, Nanos, Reading,
};

use crate::card::Card;
use crate::config::WaitBound;
use crate::link::Diagnostics;

const ENCODERS_NAME: &str = "mesa.encoders";
const ANALOG_OUT_NAME: &str = "mesa.analog_out";
const DIGITAL_IN_NAME: &str = "mesa.digital_in";
const DIGITAL_OUT_NAME: &str = "mesa.digital_out";

/// No volts and no duty: no current through any motor.
const SAFE_CODE: DacCode = DacCode(0);

/// Sends a cycle's request early and tells what was counted; it is no device half. A copy may stand
/// on any thread: what it tells is read without entering the card, and disturbs no lane.
#[derive(Clone, Debug)]
pub struct CardMonitor {
    shared: Arc<Shared<Card>>,
    bound: WaitBound,
}

impl CardMonitor {
    pub(crate) fn new(shared: Arc<Shared<Card>>, bound: WaitBound) -> CardMonitor {
        CardMonitor { shared, bound }
    }

    /// Sends the request of the job released at `release`, if no half did: its answer is on its way
    /// while the job does something else, and the first half that is sampled collects it. For the
    /// lane of the halves alone.
    pub fn request(&self, release: Nanos) {
        let _ = self.shared.with(|card| card.request(release));
    }

    /// What had happened on the link and the card when a half left it last. Each number is whole;
    /// two of them may be a cycle apart.
    #[must_use]
    pub fn diagnostics(&self) -> Diagnostics {
        self.shared.shown().diagnostics()
    }

    /// Speeds of the encoders at the latest reading (counts a second); see
    /// [`MesaEncoders::speeds_counts_s`].
    #[must_use]
    pub fn speeds_counts_s(&self) -> [f64; CHANNELS] {
        self.shared.shown().speeds()
    }

    /// How long a job may wait in a half.
    #[must_use]
    pub fn wait_bound(&self) -> WaitBound {
        self.bound
    }
}

/// Encoder channels.
#[derive(Debug)]
pub struct MesaEncoders {
    shared: Arc<Shared<Card>>,
    joints: usize,
    index: bool,
    pulses: IndexPulses,
    speeds: [f64; CHANNELS],
    presence: Presence,
    wait: Nanos,
}

impl MesaEncoders {
    pub(crate) fn new(
        shared: Arc<Shared<Card>>,
        joints: usize,
        index: bool,
        wait: Nanos,
    ) -> MesaEncoders {
        MesaEncoders {
            wait,
            shared,
            joints,
            index,
            pulses: [None; CHANNELS],
            speeds: [0.0; CHANNELS],
            presence: Presence::default(),
        }
    }

    /// Sends the cycle's request early; see [`CardMonitor::request`].
    pub fn request(&self, release: Nanos) {
        let _ = self.shared.with(|card| card.request(release));
    }

    /// Speeds at the latest reading (counts a second), from the card's stamps of the edges: exact
    /// where a difference of counts would be a multiple of one count a period. Without an edge the
    /// speed falls with the time since the last one.
    #[must_use]
    pub fn speeds_counts_s(&self) -> [f64; CHANNELS] {
        self.speeds
    }
}

impl Encoders for MesaEncoders {
    fn longest_wait(&self) -> Nanos {
        self.wait
    }

    fn joints(&self) -> usize {
        self.joints
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[Counts; CHANNELS]>, Error> {
        let (pulses, speeds) = (&mut self.pulses, &mut self.speeds);
        let outcome = self.shared.with(|card| {
            let snapshot = card.sample(release)?;
            (*pulses, *speeds) = (card.pulses(), card.speeds());
            Ok::<_, Failure>(Reading { value: snapshot.counts, acquired: release })
        });
        self.presence.answer(ENCODERS_NAME, outcome)
    }

    fn has_index(&self) -> bool {
        self.index
    }

    fn index_pulses(&self) -> IndexPulses {
        self.pulses
    }

    fn index_pulse_reach(&self) -> i32 {
        i32::from(i16::MAX)
    }
}

/// Lines from the cell. Those at the terminals of a 7I77 come by the exchange of the cycle before,
/// and their stamp says so.
#[derive(Debug)]
pub struct MesaDigitalIn {
    shared: Arc<Shared<Card>>,
    /// Older lines are withheld.
    stale_after: Nanos,
    presence: Presence,
    wait: Nanos,
}

impl MesaDigitalIn {
    pub(crate) fn new(shared: Arc<Shared<Card>>, stale_after: Nanos, wait: Nanos) -> MesaDigitalIn {
        MesaDigitalIn { shared, stale_after, presence: Presence::default(), wait }
    }
}

impl DigitalIn for MesaDigitalIn {
    fn longest_wait(&self) -> Nanos {
        self.wait
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<LinesIn>, Error> {
        let stale_after = self.stale_after;
        let outcome = self.shared.with(|card| {
            let snapshot = card.sample(release)?;
            match snapshot.lines_acquired {
                Some(acquired) if release - acquired <= stale_after => {
                    Ok(Reading { value: snapshot.lines, acquired })
                }
                Some(_) => Err(Failure::whole(ErrorKind::Stale)),
                None => Err(Failure::whole(ErrorKind::Transient)),
            }
        });
        self.presence.answer(DIGITAL_IN_NAME, outcome)
    }
}

/// How long an output half lives without a commit, and how long a commit may wait.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OutputTimes {
    pub(crate) longest_silence: Nanos,
    pub(crate) wait: Nanos,
}

/// What an output half needs for its answers.
#[derive(Debug)]
struct Output {
    shared: Arc<Shared<Card>>,
    half: Half,
    device: &'static str,
    longest_silence: Nanos,
    wait: Nanos,
    presence: Presence,
}

impl Output {
    fn safe(&mut self) -> Result<(), Error> {
        // The wish stays until somebody heard it: this call, or whoever is in the card.
        self.presence.answer(self.device, self.shared.safe(self.half))
    }
}

/// Analog outputs: of a 7I77, or the duty of pulse-width modulators.
#[derive(Debug)]
pub struct MesaAnalogOut {
    output: Output,
    channels: usize,
    range: (DacCode, DacCode),
}

impl MesaAnalogOut {
    pub(crate) fn new(
        shared: Arc<Shared<Card>>,
        channels: usize,
        low: DacCode,
        high: DacCode,
        times: OutputTimes,
    ) -> MesaAnalogOut {
        let OutputTimes { longest_silence, wait } = times;
        let output = Output {
            shared,
            half: Half::Motors,
            device: ANALOG_OUT_NAME,
            longest_silence,
            wait,
            presence: Presence::default(),
        };
        MesaAnalogOut { output, channels, range: (low, high) }
    }
}

impl AnalogOut for MesaAnalogOut {
    fn longest_wait(&self) -> Nanos {
        self.output.wait
    }

    fn channels(&self) -> usize {
        self.channels
    }

    fn code_range(&self) -> (DacCode, DacCode) {
        self.range
    }

    fn commit(&mut self, release: Nanos, codes: &[DacCode; CHANNELS]) -> Result<(), Error> {
        let (low, high) = self.range;
        let mut words = [0; CHANNELS];
        for (channel, (word, code)) in (0u16..).zip(words.iter_mut().zip(codes).take(self.channels))
        {
            if !(low..=high).contains(code) {
                return Err(Error::on_channel(ErrorKind::OutOfRange, ANALOG_OUT_NAME, channel));
            }
            *word = code.0;
        }
        let outcome = self.output.shared.with(|card| card.commit_codes(release, &words));
        self.output.presence.answer(ANALOG_OUT_NAME, outcome)
    }

    fn safe(&mut self) -> Result<(), Error> {
        self.output.safe()
    }

    fn safe_value(&self) -> DacCode {
        SAFE_CODE
    }

    fn longest_silence(&self) -> Nanos {
        self.output.longest_silence
    }
}

impl Drop for MesaAnalogOut {
    fn drop(&mut self) {
        let _ = self.output.safe();
    }
}

/// Lines to the cell.
#[derive(Debug)]
pub struct MesaDigitalOut {
    output: Output,
}

impl MesaDigitalOut {
    pub(crate) fn new(shared: Arc<Shared<Card>>, times: OutputTimes) -> MesaDigitalOut {
        let OutputTimes { longest_silence, wait } = times;
        let output = Output {
            shared,
            half: Half::Lines,
            device: DIGITAL_OUT_NAME,
            longest_silence,
            wait,
            presence: Presence::default(),
        };
        MesaDigitalOut { output }
    }
}

impl DigitalOut for MesaDigitalOut {
    fn longest_wait(&self) -> Nanos {
        self.output.wait
    }

    fn commit(&mut self, release: Nanos, lines: &LinesOut) -> Result<(), Error> {
        let outcome = self.output.shared.with(|card| card.commit_lines(release, lines));
        self.output.presence.answer(DIGITAL_OUT_NAME, outcome)
    }

    fn safe(&mut self) -> Result<(), Error> {
        self.output.safe()
    }

    fn longest_silence(&self) -> Nanos {
        self.output.longest_silence
    }
}

impl Drop for MesaDigitalOut {
    fn drop(&mut self) {
        let _ = self.output.safe();
    }
}
