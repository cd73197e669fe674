//! The state machine of an open segment: exchanges of process data, their working counter, the
//! states of the devices and the way back to operation. It never allocates and waits only for the
//! declared time.

mod outputs;

use std::ops::RangeInclusive;

use ethercrab::SubDeviceState;
use ethercrab::error::Error as LibraryError;
use ethercrab::subdevice_group::SafeOp;
use taktil_hal::{
    AdcCode, CHANNELS, Counts, DacCode, DriveActual, DriveRequest, Error, ErrorKind, LinesIn,
    LinesOut, Nanos,
};

use crate::config::{Config, ExchangeTimes};
use crate::drive::DriveUnit;
use crate::health::{Diagnostics, Health};
use crate::master::{Group, Master};
use crate::setup::Ready;
use crate::wiring::{LinePlace, Wiring};

/// The two output halves: targets and volts, by whichever of the two halves has them, and lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Half {
    Analog,
    Lines,
}

/// What an exchange gave.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Snapshot {
    pub(crate) counts: [Counts; CHANNELS],
    pub(crate) codes: [AdcCode; CHANNELS],
    pub(crate) lines: LinesIn,
    pub(crate) drives: [DriveActual; CHANNELS],
}

/// Why there is no snapshot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Failure {
    pub(crate) kind: ErrorKind,
    pub(crate) channel: u16,
}

impl Failure {
    pub(crate) const fn whole(kind: ErrorKind) -> Failure {
        Failure { kind, channel: Error::ALL_CHANNELS }
    }

    pub(crate) const fn of(self, device: &'static str) -> Error {
        Error { kind: self.kind, device, channel: self.channel }
    }
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
    enable: Nanos,
}

/// A segment that is open.
pub(crate) struct Bus {
    master: Master,
    group: Box<Group<SafeOp>>,
    wiring: Wiring,
    drives: Vec<DriveUnit>,
    spans: Spans,
    exchange: ExchangeTimes,
    health: Health,
    /// The newest raw numbers of narrow counters, and the counts that they were unfolded to.
    unfolded: [Option<(i32, i32)>; CHANNELS],
    sampled: Option<(Nanos, Result<Snapshot, Failure>)>,
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
    /// The half that committed second in the cycle before: it exchanges.
    closer: Option<Half>,
    unsent: Option<Half>,
}

/// The way of one device back to operation.
#[derive(Clone, Copy, Debug, Default)]
struct Recovery {
    device: usize,
    acknowledges: bool,
    /// A request was made since the newest exchange.
    is_made: bool,
    /// All devices were asked together since they operated last.
    has_asked_all: bool,
}

/// What the device that is asked for a state answers with a mark of an error is acknowledged by.
const ACKNOWLEDGE_SAFE_WORD: u16 = 0x0014;
/// Asks for operation.
const OPERATE_WORD: u16 = 0x0008;
/// Asks all devices for INIT, and acknowledges errors.
const RESET_WORD: u16 = 0x0011;
/// Register that asks for a state.
const AL_CONTROL_ADDRESS: u16 = 0x0120;

impl Bus {
    pub(crate) fn new(ready: Ready, config: &Config) -> Bus {
        let listed = config.devices.iter().filter(|one| one.kind == crate::config::Kind::Drive);
        let units = ready.wiring.drives.iter().zip(&ready.drives).zip(listed);
        let drives = units.map(|((places, facts), listed)| {
            DriveUnit::new(*places, listed.mode, listed.step_max_counts, facts.quick_stop())
        });
        let ms = |ms: u32| Nanos::from_millis(i64::from(ms));
        let mut health = Health::default();
        health.seen.emergencies = ready.master.counts.emergencies;
        Bus {
            drives: drives.collect(),
            master: ready.master,
            group: ready.group,
            wiring: ready.wiring,
            spans: Spans {
                wait: config.exchange_wait(),
                lost_after: ms(config.lost_ms),
                silence: ms(config.watchdog_ms),
                enable: ms(config.enable_ms),
            },
            exchange: config.exchange,
            health,
            unfolded: [None; CHANNELS],
            sampled: None,
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
        let steps = self.exchange == ExchangeTimes::Once || !self.digital.active;
        let outcome = match self.exchange(release, steps) {
            Ok(()) => self.snapshot(),
            Err(kind) => Err(Failure::whole(kind)),
        };
        self.sampled = Some((release, outcome));
        outcome
    }

    /// Exchanges the process data once; `steps`: the machines of the drives are stepped as well.
    fn exchange(&mut self, release: Nanos, steps: bool) -> Result<(), ErrorKind> {
        let outcome = self.exchange_once(release, steps);
        self.exchanged = Some((release, outcome));
        outcome
    }

    fn exchange_once(&mut self, release: Nanos, steps: bool) -> Result<(), ErrorKind> {
        if self.lost {
            return Err(ErrorKind::Lost);
        }
        self.put_out(release, steps);
        self.recovery.is_made = false;
        self.health.seen.exchanges += 1;
        let device = self.master.device();
        let answer = self.master.exchange(self.spans.wait, self.group.tx_rx(device));
        let is_good = match answer {
            Some(Ok(answer)) => {
                self.take_states(&answer.subdevice_states);
                let is_whole = answer.working_counter == self.wiring.counter;
                self.health.seen.wrong_counters += u64::from(!is_whole);
                is_whole
            }
            Some(Err(error)) => {
                self.count(&error);
                false
            }
            None => {
                self.health.seen.timeouts += 1;
                false
            }
        };
        if is_good {
            self.health.hit(release);
            self.take_reports();
            return if self.health.is_failed() { Err(ErrorKind::Stale) } else { Ok(()) };
        }
        self.lost |= self.health.miss(release) > self.spans.lost_after;
        Err(if self.lost {
            ErrorKind::Lost
        } else if self.health.is_failed() {
            ErrorKind::Stale
        } else {
            ErrorKind::Transient
        })
    }

    fn count(&mut self, error: &LibraryError) {
        // A device that is gone answers neither the image nor the question for its state.
        let is_counter = matches!(error, LibraryError::WorkingCounter { .. });
        self.health.seen.wrong_counters += u64::from(is_counter);
        self.health.seen.broken_exchanges += u64::from(!is_counter);
    }

    fn take_states(&mut self, states: &[SubDeviceState]) {
        let operates = |state: &SubDeviceState| *state == SubDeviceState::Op;
        let all = states.len() == self.group.len() && states.iter().all(operates);
        if self.operates && !all {
            self.health.seen.state_drops += 1;
            self.is_blocked |= self.wants_drives();
        }
        self.operates = all;
        self.recovery.has_asked_all &= !all;
        if let Some(device) = states.iter().position(|state| !operates(state)) {
            if device != self.recovery.device {
                self.recovery.acknowledges = false;
            }
            self.recovery.device = device;
        }
    }

    /// Lets the drives report.
    fn take_reports(&mut self) {
        let device = self.master.device();
        for drive in &mut self.drives {
            let Ok(one) = self.group.subdevice(device, drive.device()) else { continue };
            if drive.report(&one.inputs_raw()) {
                self.health.seen.drive_faults += 1;
                self.health.seen.newest_fault_device = drive.device() as u64 + 1;
                self.health.seen.newest_fault_code = 0;
            }
            let is_newest = self.health.seen.newest_fault_device == drive.device() as u64 + 1;
            if is_newest && drive.error != 0 {
                self.health.seen.newest_fault_code = u64::from(drive.error);
            }
        }
    }

    fn snapshot(&mut self) -> Result<Snapshot, Failure> {
        let mut snapshot = Snapshot::default();
        let device = self.master.device();
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
