//! The state machine of an open segment: exchanges of process data, their working counter, the
//! states of the devices and the way back to operation. It never allocates and waits only for the
//! declared time.

mod exchange;
mod outputs;

use std::ops::RangeInclusive;
use std::sync::Arc;

use ethercrab::error::Error as LibraryError;
use ethercrab::subdevice_group::SafeOp;
use taktil_drivers_exchange::{Failure, Half};
use taktil_hal::{
    AdcCode, CHANNELS, Counts, DacCode, DriveActual, DriveRequest, ErrorKind, LinesIn, LinesOut,
    Nanos, phase_in_cycle,
};

use crate::config::{Config, ExchangeTimes};
use crate::drive::DriveUnit;
use crate::health::{Diagnostics, Health};
use crate::master::{Group, Master};
use crate::setup::Ready;
use crate::transfer::Transfer;
use crate::wiring::{LinePlace, Wiring};

use exchange::{ImageAnswer, StateRequest, transfers};

/// What an exchange gave.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Snapshot {
    pub(crate) counts: [Counts; CHANNELS],
    pub(crate) codes: [AdcCode; CHANNELS],
    pub(crate) lines: LinesIn,
    pub(crate) drives: [DriveActual; CHANNELS],
    /// The release of the job that sent the frame.
    pub(crate) acquired: Nanos,
    /// How much later than its place in the segment's cycle the frame was, by the reference clock.
    pub(crate) phase: Option<Nanos>,
}

/// One of the output halves in the course of a cycle.
#[derive(Clone, Copy, Debug, Default)]
struct Commit {
    release: Option<Nanos>,
    /// The newest sign of life: a commit, for the lines with a change of the feed line.
    alive: Nanos,
    /// The half is driven by what it committed, not by its safe values.
    active: bool,
    /// What it committed last asks for more than its safe values.
    asks: bool,
}

/// What the half for drives wants of the power sections.
#[derive(Clone, Copy, Debug, Default)]
struct Acts {
    request: DriveRequest,
    reset: bool,
}

/// The spans that bound a segment.
#[derive(Clone, Copy, Debug)]
struct Spans {
    wait: Nanos,
    lost_after: Nanos,
    silence: Nanos,
}

/// A segment that is open.
pub(crate) struct Bus {
    master: Master,
    /// The frame with the process data, and a request of a state beside it.
    image: Transfer<(), Result<ImageAnswer, LibraryError>>,
    state: Transfer<StateRequest, Result<(), LibraryError>>,
    group: Arc<Group<SafeOp>>,
    wiring: Wiring,
    drives: Vec<DriveUnit>,
    spans: Spans,
    exchange: ExchangeTimes,
    health: Health,
    /// The cycle by the distributed clocks, where they are used, and what the reference clock said
    /// when the newest frame passed it (ns).
    cycle: Option<Nanos>,
    frame_time_ns: Option<u64>,
    /// The newest raw numbers of narrow counters, and the counts that they were unfolded to.
    unfolded: [Option<(i32, i32)>; CHANNELS],
    sampled: Option<(Nanos, Result<Snapshot, Failure>)>,
    /// The release of the job that sent the newest frame.
    sent: Nanos,
    /// What the newest answer that was collected a cycle later said.
    reading: Result<Snapshot, Failure>,
    /// The release of the newest exchange, with its outcome.
    exchanged: Option<(Nanos, Result<(), ErrorKind>)>,
    lost: bool,
    /// All devices are in OP.
    operates: bool,
    /// The device that a request of operation goes to next, and whether its error is acknowledged.
    recovery: Recovery,
    /// Operation was lost while the drives were wanted: the wish has to be given up first.
    is_blocked: bool,
    codes: [i32; CHANNELS],
    /// What the half for drives wants, once it has committed; the codes are its targets then.
    acts: Option<Acts>,
    lines: LinesOut,
    analog: Commit,
    digital: Commit,
    line_failure: LineFailure,
    /// The half that committed second in the cycle before: it exchanges.
    closer: Option<Half>,
    unsent: Option<Half>,
}

/// Whether the newest commits have failed, and whether the enable line fell after one that had.
#[derive(Clone, Copy, Debug, Default)]
struct LineFailure {
    motors: bool,
    lines: bool,
    gave_up: bool,
}

impl LineFailure {
    /// Takes the level of the enable line before a commit and with it.
    fn note(&mut self, before: bool, now: bool) {
        match (before, now) {
            (true, false) => self.gave_up = self.motors || self.lines,
            (_, true) => self.gave_up = false,
            (false, false) => {}
        }
    }
}

/// The way of one device back to operation.
#[derive(Clone, Copy, Debug, Default)]
struct Recovery {
    device: usize,
    acknowledges: bool,
    /// The newest request is one of operation.
    asks_operation: bool,
    /// A request was made whose effect no answer has shown yet.
    is_made: bool,
    /// The frame that is under way was sent after it.
    is_followed: bool,
    /// All devices were asked together since they operated last.
    has_asked_all: bool,
}

/// What the device that is asked for a state answers with a mark of an error is acknowledged by.
const ACKNOWLEDGE_SAFE_WORD: u16 = 0x0014;
/// Asks for operation.
const OPERATE_WORD: u16 = 0x0008;
/// Asks all devices for INIT, and acknowledges errors.
const RESET_WORD: u16 = 0x0011;

impl Bus {
    pub(crate) fn new(ready: Ready, config: &Config) -> Bus {
        let listed = config.devices.iter().filter(|one| one.kind == crate::config::Kind::Drive);
        let ms = |ms: u32| Nanos::from_millis(i64::from(ms));
        let units = ready.wiring.drives.iter().zip(&ready.drives).zip(listed);
        let drives = units.map(|((places, facts), listed)| {
            let (mode, step) = (listed.mode, listed.step_max_counts);
            DriveUnit::new(*places, mode, step, facts.quick_stop(), ms(config.enable_ms))
        });
        let mut health = Health::default();
        health.seen.emergencies = ready.master.counts.emergencies;
        let group = Arc::from(ready.group);
        let (image, state) = transfers(ready.master.device(), &group, config.sync.is_some());
        Bus {
            drives: drives.collect(),
            master: ready.master,
            image,
            state,
            group,
            wiring: ready.wiring,
            spans: Spans {
                wait: config.answer_wait(),
                lost_after: ms(config.lost_ms),
                silence: ms(config.watchdog_ms),
            },
            exchange: config.exchange,
            health,
            cycle: config.sync.map(|_| config.period()),
            frame_time_ns: None,
            unfolded: [None; CHANNELS],
            sampled: None,
            sent: Nanos::ZERO,
            reading: Err(Failure::whole(ErrorKind::Transient)),
            exchanged: None,
            lost: false,
            operates: false,
            recovery: Recovery::default(),
            is_blocked: false,
            codes: [0; CHANNELS],
            acts: None,
            lines: LinesOut::SAFE,
            analog: Commit::default(),
            digital: Commit::default(),
            line_failure: LineFailure::default(),
            closer: None,
            unsent: None,
        }
    }

    /// What was counted.
    pub(crate) fn seen(&self) -> Diagnostics {
        let cable = self.master.counts;
        Diagnostics {
            stray_frames: cable.stray_frames,
            send_failures: cable.send_failures,
            link_failures: self.health.level.failures(),
            error_level: self.health.level.level().into(),
            ..self.health.seen
        }
    }

    /// The inputs for the job released at `release`: the same for all halves.
    pub(crate) fn sample(&mut self, release: Nanos) -> Result<Snapshot, Failure> {
        if let Some((at, outcome)) = self.sampled {
            if at == release {
                return outcome;
            }
            // Another lane is ahead of this one.
            if at > release {
                return Err(Failure::whole(ErrorKind::Transient));
            }
        }
        self.watch(release);
        // The machines of the drives are stepped where lines are taken in; drives that nobody wants
        // are led on here as well.
        let steps = self.exchange != ExchangeTimes::Twice || !self.digital.active;
        let is_exchanged = self.exchanged.is_some_and(|(at, _)| at == release);
        let outcome = match self.exchange {
            ExchangeTimes::Pipelined => {
                if !is_exchanged {
                    let _ = self.exchange(release, steps);
                }
                self.reading
            }
            ExchangeTimes::Twice | ExchangeTimes::Once => self
                .exchange(release, steps)
                .map_err(Failure::whole)
                .and_then(|()| self.snapshot(release)),
        };
        self.sampled = Some((release, outcome));
        outcome
    }

    /// The inputs of an exchange that was sent for the job released at `acquired`.
    fn snapshot(&mut self, acquired: Nanos) -> Result<Snapshot, Failure> {
        let mut snapshot = Snapshot { acquired, ..Snapshot::default() };
        let device = self.master.device();
        let phase = |cycle| self.frame_time_ns.map(|time_ns| phase_in_cycle(time_ns, cycle));
        snapshot.phase = self.cycle.and_then(phase);
        for (channel, field) in self.wiring.encoders.iter().enumerate() {
            let Ok(one) = self.group.subdevice(device, field.device) else { continue };
            let raw = field.signed(&one.inputs_raw());
            snapshot.counts[channel] = Counts(unfold(&mut self.unfolded[channel], raw, field.bits));
        }
        for (code, field) in snapshot.codes.iter_mut().zip(&self.wiring.analog_in) {
            let Ok(one) = self.group.subdevice(device, field.device) else { continue };
            *code = AdcCode(field.signed(&one.inputs_raw()));
        }
        for (actual, drive) in snapshot.drives.iter_mut().zip(&self.drives) {
            *actual = drive.actual();
        }
        if let Some(places) = self.wiring.lines_in {
            let has_voltage = self.drives.iter().all(DriveUnit::has_voltage);
            snapshot.lines = places.lines(|place| match place {
                LinePlace::Drives => has_voltage,
                LinePlace::Terminal(field, _) => self
                    .group
                    .subdevice(device, field.device)
                    .is_ok_and(|one| place.read(&one.inputs_raw())),
            });
        }
        Ok(snapshot)
    }
}

/// A counter that is narrower than 32 bits as if it had never wrapped.
fn unfold(state: &mut Option<(i32, i32)>, raw: i32, bits: u8) -> i32 {
    let shift = 32 - u32::from(bits.clamp(1, 32));
    let counts = match *state {
        None => raw,
        Some((before, counts)) => {
            let step = (raw.wrapping_sub(before) << shift) >> shift;
            counts.wrapping_add(step)
        }
    };
    *state = Some((raw, counts));
    counts
}

/// The codes of channels from a commit.
pub(crate) fn words_in_range(
    codes: &[DacCode; CHANNELS],
    channels: usize,
    range: &RangeInclusive<DacCode>,
) -> Result<[i32; CHANNELS], u16> {
    let mut words = [0; CHANNELS];
    for (channel, (word, code)) in (0_u16..).zip(words.iter_mut().zip(codes).take(channels)) {
        if !range.contains(code) {
            return Err(channel);
        }
        *word = code.0;
    }
    Ok(words)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_narrow_counter_goes_on_across_its_wrap() {
        let mut state = None;
        let raws = [32_767, -32_768, -32_767, 32_767, 30_000];
        let counts = raws.map(|raw| unfold(&mut state, raw, 16));
        assert_eq!(counts, [32_767, 32_768, 32_769, 32_767, 30_000]);
        let mut wide = None;
        let counts = [i32::MAX, i32::MIN, 5].map(|raw| unfold(&mut wide, raw, 32));
        assert_eq!(counts, [i32::MAX, i32::MIN, 5]);
    }
}
