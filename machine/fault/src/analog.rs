//! D/A and A/D converters with faults: words that are lost, late, latched or turned, codes that are
//! clipped or stand still, and boards that do not answer.

use core::ops::RangeInclusive;

use taktil_hal::fault::FaultKind;
use taktil_hal::{
    AdcCode, AnalogIn, AnalogOut, CHANNELS, DacCode, Error, ErrorKind, Nanos, Reading,
};

use crate::target_faults::{Answer, TargetFaults};

/// The kinds that can befall D/A converters.
pub const ANALOG_OUT_KINDS: [FaultKind; 8] = [
    FaultKind::Failing,
    FaultKind::Frozen,
    FaultKind::Delay,
    FaultKind::Loss,
    FaultKind::Dead,
    FaultKind::Hot,
    FaultKind::Inversion,
    FaultKind::Unplugged,
];

/// The kinds that can befall A/D converters.
pub const ANALOG_IN_KINDS: [FaultKind; 9] = [
    FaultKind::Clipped,
    FaultKind::Frozen,
    FaultKind::Jump,
    FaultKind::Dead,
    FaultKind::Hot,
    FaultKind::Inversion,
    FaultKind::Failing,
    FaultKind::Silence,
    FaultKind::Unplugged,
];

const OUTPUT_DEVICE: &str = "fault.analog_out";
const INPUT_DEVICE: &str = "fault.analog_in";
/// Words that a late converter holds back.
const DELAYED_WORDS_MAX: usize = 64;

/// D/A converters behind faults.
pub(crate) struct FaultyAnalogOut {
    half: Box<dyn AnalogOut>,
    faults: TargetFaults,
    /// The newest words that were given, with their releases; the oldest is overwritten.
    given: Box<[(Nanos, [DacCode; CHANNELS])]>,
    next: usize,
    /// The word that was handed to the board last.
    put: [DacCode; CHANNELS],
    now: Nanos,
}

impl FaultyAnalogOut {
    pub(crate) fn new(half: Box<dyn AnalogOut>, faults: TargetFaults) -> FaultyAnalogOut {
        let safe = [half.safe_value(); CHANNELS];
        let given = vec![(Nanos(i64::MIN), safe); DELAYED_WORDS_MAX].into();
        FaultyAnalogOut { half, faults, given, next: 0, put: safe, now: Nanos(i64::MIN) }
    }

    /// The newest word that is at least `delay_s` old; the one put out last when none is.
    fn delayed(&self, release: Nanos, delay_s: f64) -> [DacCode; CHANNELS] {
        let due = Nanos(release.0.saturating_sub((delay_s * 1e9) as i64));
        let old = self.given.iter().filter(|(given, _)| *given <= due && given.0 > i64::MIN);
        old.max_by_key(|(given, _)| *given).map_or(self.put, |(_, word)| *word)
    }

    /// What the converters do with the code of one channel.
    fn code(&self, channel: usize, code: DacCode, now: Nanos) -> DacCode {
        let (low, high) = self.half.code_range();
        if self.faults.has(FaultKind::Frozen, channel, now) {
            self.put[channel]
        } else if self.faults.has(FaultKind::Dead, channel, now) {
            self.half.safe_value()
        } else if self.faults.has(FaultKind::Hot, channel, now) {
            high
        } else if self.faults.has(FaultKind::Inversion, channel, now) {
            DacCode(code.0.saturating_neg()).clamp(low, high)
        } else {
            code
        }
    }

    /// Whether a channel does not follow any word.
    fn is_latched(&self) -> bool {
        [FaultKind::Frozen, FaultKind::Hot]
            .into_iter()
            .any(|kind| self.faults.is_active(kind, self.now))
    }
}

impl AnalogOut for FaultyAnalogOut {
    fn channels(&self) -> usize {
        self.half.channels()
    }

    fn code_range(&self) -> (DacCode, DacCode) {
        self.half.code_range()
    }

    fn longest_wait(&self) -> Nanos {
        self.half.longest_wait()
    }

    fn commit(&mut self, release: Nanos, codes: &[DacCode; CHANNELS]) -> Result<(), Error> {
        self.now = release;
        let (low, high) = self.half.code_range();
        let wired = &codes[..self.half.channels().min(CHANNELS)];
        if let Some(bad) = wired.iter().position(|code| !(low..=high).contains(code)) {
            return Err(Error::on_channel(ErrorKind::OutOfRange, OUTPUT_DEVICE, bad as u16));
        }
        self.given[self.next] = (release, *codes);
        self.next = (self.next + 1) % self.given.len();
        if self.faults.is_active(FaultKind::Unplugged, release) {
            return Err(Error::whole(ErrorKind::Lost, OUTPUT_DEVICE));
        }
        if self.faults.happens(FaultKind::Failing, release) {
            return Err(Error::whole(ErrorKind::Transient, OUTPUT_DEVICE));
        }
        if self.faults.happens(FaultKind::Loss, release) {
            return Ok(());
        }
        let mut word = match self.faults.strength(FaultKind::Delay, 0, release) {
            Some(delay_s) => self.delayed(release, delay_s),
            None => *codes,
        };
        for (channel, code) in word.iter_mut().enumerate().take(self.half.channels()) {
            *code = self.code(channel, *code, release);
        }
        self.put = word;
        self.half.commit(release, &word)
    }

    fn safe(&mut self) -> Result<(), Error> {
        if self.faults.is_active(FaultKind::Unplugged, self.now) {
            return Err(Error::whole(ErrorKind::Lost, OUTPUT_DEVICE));
        }
        if self.is_latched() {
            return Ok(());
        }
        self.put = [self.half.safe_value(); CHANNELS];
        self.half.safe()
    }

    fn safe_value(&self) -> DacCode {
        self.half.safe_value()
    }

    fn longest_silence(&self) -> Nanos {
        self.half.longest_silence()
    }
}

/// A/D converters behind faults.
pub(crate) struct FaultyAnalogIn {
    half: Box<dyn AnalogIn>,
    faults: TargetFaults,
    answered: Option<(Nanos, Answer<[AdcCode; CHANNELS]>)>,
    shown: [AdcCode; CHANNELS],
}

impl FaultyAnalogIn {
    pub(crate) fn new(half: Box<dyn AnalogIn>, faults: TargetFaults) -> FaultyAnalogIn {
        FaultyAnalogIn { half, faults, answered: None, shown: [AdcCode(0); CHANNELS] }
    }

    fn answer(&mut self, release: Nanos) -> Result<Reading<[AdcCode; CHANNELS]>, Error> {
        let reading = self.half.sample(release);
        input_failure(&mut self.faults, release, INPUT_DEVICE)?;
        let mut reading = reading?;
        let (low, high) = self.half.code_range();
        let range = low..=high;
        for channel in 0..self.half.channels().min(CHANNELS) {
            let code = reading.value[channel];
            let shown = self.shown[channel];
            let faulty = input_code(&self.faults, channel, code, shown, &range, release);
            self.shown[channel] = faulty;
            reading.value[channel] = faulty;
        }
        Ok(reading)
    }
}

/// The error with which a board answers that does not deliver.
pub(crate) fn input_failure(
    faults: &mut TargetFaults,
    release: Nanos,
    device: &'static str,
) -> Result<(), Error> {
    if faults.is_active(FaultKind::Unplugged, release) {
        return Err(Error::whole(ErrorKind::Lost, device));
    }
    if faults.is_active(FaultKind::Silence, release) {
        return Err(Error::whole(ErrorKind::Stale, device));
    }
    if faults.happens(FaultKind::Failing, release) {
        return Err(Error::whole(ErrorKind::Transient, device));
    }
    Ok(())
}

/// What becomes of a code that was converted, of which `shown` was handed out before it.
pub(crate) fn input_code(
    faults: &TargetFaults,
    channel: usize,
    code: AdcCode,
    shown: AdcCode,
    range: &RangeInclusive<AdcCode>,
    now: Nanos,
) -> AdcCode {
    let (low, high) = (*range.start(), *range.end());
    if faults.has(FaultKind::Frozen, channel, now) {
        return shown;
    }
    if faults.has(FaultKind::Dead, channel, now) {
        return AdcCode(0);
    }
    if faults.has(FaultKind::Hot, channel, now) {
        return high;
    }
    let mut code = code;
    if faults.has(FaultKind::Inversion, channel, now) {
        code = AdcCode(code.0.saturating_neg());
    }
    if let Some(jump) = faults.strength(FaultKind::Jump, channel, now) {
        code = AdcCode(code.0.saturating_add(jump as i32));
    }
    if let Some(part) = faults.strength(FaultKind::Clipped, channel, now) {
        let end = |end: AdcCode| AdcCode((f64::from(end.0) * part) as i32);
        code = code.clamp(end(low), end(high));
    }
    code.clamp(low, high)
}

impl AnalogIn for FaultyAnalogIn {
    fn channels(&self) -> usize {
        self.half.channels()
    }

    fn code_range(&self) -> (AdcCode, AdcCode) {
        self.half.code_range()
    }

    fn longest_wait(&self) -> Nanos {
        self.half.longest_wait()
    }

    fn sample(&mut self, release: Nanos) -> Result<Reading<[AdcCode; CHANNELS]>, Error> {
        if let Some((_, answer)) = self.answered.filter(|(at, _)| *at == release) {
            return answer;
        }
        let answer = self.answer(release);
        self.answered = Some((release, answer));
        answer
    }
}
