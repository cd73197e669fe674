//! The lines of a cell with faults: broken and stuck lines, contacts that bounce, channels that
//! disagree, words that are lost, and boards that do not answer. Channels of the inputs: 1 drive
//! power, 2 and 3 the emergency stop; of the outputs: 1 enable, 2 brake release, 3 watchdog.

use taktil_hal::fault::{Fault, FaultKind};
use taktil_hal::{DigitalIn, DigitalOut, Error, ErrorKind, LinesIn, LinesOut, Nanos, Reading};

use crate::analog::input_failure;
use crate::target_faults::{Answer, TargetFaults};

/// The kinds that can befall input lines.
pub const DIGITAL_IN_KINDS: [FaultKind; 8] = [
    FaultKind::Bounce,
    FaultKind::Dead,
    FaultKind::Hot,
    FaultKind::Frozen,
    FaultKind::Inversion,
    FaultKind::Failing,
    FaultKind::Silence,
    FaultKind::Unplugged,
];

/// The kinds that can befall output lines.
pub const DIGITAL_OUT_KINDS: [FaultKind; 7] = [
    FaultKind::Failing,
    FaultKind::Loss,
    FaultKind::Frozen,
    FaultKind::Dead,
    FaultKind::Hot,
    FaultKind::Inversion,
    FaultKind::Unplugged,
];

const INPUT_DEVICE: &str = "fault.digital_in";
const OUTPUT_DEVICE: &str = "fault.digital_out";

/// What a fault makes of a line; `shown` is its level before.
fn line(faults: &TargetFaults, channel: usize, level: bool, shown: bool, now: Nanos) -> bool {
    if faults.has(FaultKind::Frozen, channel, now) {
        return shown;
    }
    if faults.has(FaultKind::Dead, channel, now) {
        return false;
    }
    if faults.has(FaultKind::Hot, channel, now) {
        return true;
    }
    let bounces = |fault: &Fault| {
        let period = ((fault.value * 1e9) as i64).max(1);
        fault.kind == FaultKind::Bounce
            && fault.is_under_way(now)
            && fault.has_channel(channel)
            && (now.0 - fault.at.0) / period % 2 == 0
    };
    let turned = faults.has(FaultKind::Inversion, channel, now);
    (level && !faults.faults().iter().any(bounces)) != turned
}

/// Input lines behind faults.
pub(crate) struct FaultyDigitalIn {
    half: Box<dyn DigitalIn>,
    faults: TargetFaults,
    answered: Option<(Nanos, Answer<LinesIn>)>,
    shown: LinesIn,
}

impl FaultyDigitalIn {
    pub(crate) fn new(half: Box<dyn DigitalIn>, faults: TargetFaults) -> FaultyDigitalIn {
        FaultyDigitalIn { half, faults, answered: None, shown: LinesIn::default() }
    }

    fn answer(&mut self, release: Nanos) -> Result<Reading<LinesIn>, Error> {
        let reading = self.half.sample(release);
        input_failure(&mut self.faults, release, INPUT_DEVICE)?;
        let Reading { value, acquired } = reading?;
        let (faults, shown) = (&self.faults, self.shown);
        let lines = LinesIn {
            drive_power: line(faults, 0, value.drive_power, shown.drive_power, release),
            estop_a_closed: line(faults, 1, value.estop_a_closed, shown.estop_a_closed, release),
            estop_b_closed: line(faults, 2, value.estop_b_closed, shown.estop_b_closed, release),
        };
        self.shown = lines;
        Ok(Reading { value: lines, acquired })
    }
}

impl DigitalIn for FaultyDigitalIn {
    fn longest_wait(&self) -> Nanos {
        self.half.longest_wait()
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<LinesIn>, Error> {
        if let Some((_, answer)) = self.answered.filter(|(at, _)| *at == release) {
            return answer;
        }
        let answer = self.answer(release);
        self.answered = Some((release, answer));
        answer
    }
}

/// Output lines behind faults.
pub(crate) struct FaultyDigitalOut {
    half: Box<dyn DigitalOut>,
    faults: TargetFaults,
    put: LinesOut,
    now: Nanos,
}

impl FaultyDigitalOut {
    pub(crate) fn new(half: Box<dyn DigitalOut>, faults: TargetFaults) -> FaultyDigitalOut {
        FaultyDigitalOut { half, faults, put: LinesOut::SAFE, now: Nanos(i64::MIN) }
    }

    /// Whether a line does not follow any word.
    fn is_latched(&self) -> bool {
        [FaultKind::Frozen, FaultKind::Hot]
            .into_iter()
            .any(|kind| self.faults.is_active(kind, self.now))
    }
}

impl DigitalOut for FaultyDigitalOut {
    fn longest_wait(&self) -> Nanos {
        self.half.longest_wait()
    }

    fn commit(&mut self, release: Nanos, lines: &LinesOut) -> Result<(), Error> {
        self.now = release;
        if self.faults.is_active(FaultKind::Unplugged, release) {
            return Err(Error::whole(ErrorKind::Lost, OUTPUT_DEVICE));
        }
        if self.faults.happens(FaultKind::Failing, release) {
            return Err(Error::whole(ErrorKind::Transient, OUTPUT_DEVICE));
        }
        if self.faults.happens(FaultKind::Loss, release) {
            return Ok(());
        }
        let (faults, put) = (&self.faults, self.put);
        self.put = LinesOut {
            enable: line(faults, 0, lines.enable, put.enable, release),
            brake_release: line(faults, 1, lines.brake_release, put.brake_release, release),
            watchdog_feed: line(faults, 2, lines.watchdog_feed, put.watchdog_feed, release),
        };
        self.half.commit(release, &self.put)
    }

    fn safe(&mut self) -> Result<(), Error> {
        if self.faults.is_active(FaultKind::Unplugged, self.now) {
            return Err(Error::whole(ErrorKind::Lost, OUTPUT_DEVICE));
        }
        if self.is_latched() {
            return Ok(());
        }
        self.put = LinesOut { watchdog_feed: self.put.watchdog_feed, ..LinesOut::SAFE };
        self.half.safe()
    }

    fn longest_silence(&self) -> Nanos {
        self.half.longest_silence()
    }
}
