//! The state machine of an open card: one request and one write packet a cycle, answers judged by
//! their number, and the way back after a bite of a watchdog. It never allocates and waits only for
//! the declared time.

mod outputs;

use taktil_drivers_exchange::{Failure, Half};
use taktil_hal::{CHANNELS, Counts, ErrorKind, IndexPulses, LinesIn, LinesOut, Nanos};

use crate::config::{COMMAND_READS_MAX, Config};
use crate::cycle::{Cycle, Drive, Status};
use crate::lbp16::PACKET_BYTES_MAX;
use crate::link::{Kind, Link};
use crate::modules::encoder::EncoderBank;
use crate::modules::gpio::{InputLines, OutputLines};
use crate::port::Port;
use crate::recovery::{Phase, Step};
use crate::wiring::Wiring;

/// Datagrams that one wait takes at most: what is late from the cycles before, doubled, and the
/// answer itself.
const ANSWERS_MAX: usize = 16;

/// What a cycle's answer gave.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Snapshot {
    pub(crate) counts: [Counts; CHANNELS],
    pub(crate) lines: LinesIn,
    /// When the lines were read, `None` while smart serial has not read them.
    pub(crate) lines_acquired: Option<Nanos>,
}

/// One of the output halves in the course of a cycle.
#[derive(Clone, Copy, Debug, Default)]
struct Commit {
    release: Option<Nanos>,
    /// A commit came since the newest write packet, for the lines with a change of the feed line.
    alive: bool,
    /// The half asks for more than its safe values.
    active: bool,
}

/// A card that is open.
pub(crate) struct Card {
    port: Box<dyn Port>,
    cycle: Cycle,
    link: Link,
    bank: EncoderBank,
    inputs: Option<InputLines>,
    outputs: Option<OutputLines>,
    session: u32,
    wait: Nanos,
    /// Longest wait for one look at an exchange before a write.
    settle_wait: Nanos,
    lost_after: Nanos,
    field_mask: u32,
    analog_mask: u32,
    spindle_mask: u32,
    reads_field: bool,
    has_encoders: bool,
    buffer: [u8; PACKET_BYTES_MAX],
    requested: Option<Nanos>,
    sampled: Option<(Nanos, Result<Snapshot, Failure>)>,
    lost: bool,
    /// Another program drives the card: nothing is written any more.
    taken_over: bool,
    drive: Drive,
    lines: LinesOut,
    analog: Commit,
    digital: Commit,
    /// The half that committed second in the cycle before: it sends the write packet.
    closer: Option<Half>,
    unsent: Option<Half>,
    write_number: u32,
    written: bool,
    armed: bool,
    phase: Phase,
    /// An exchange was started and has not been seen finished; with its release and channels.
    exchange: Option<(Nanos, u32)>,
    /// An exchange was started since the newest sample.
    exchanged: bool,
    /// A write packet was sent since the newest sample.
    wrote: bool,
    field_acquired: Option<Nanos>,
}

impl Card {
    pub(crate) fn new(
        port: Box<dyn Port>,
        cycle: Cycle,
        config: &Config,
        wiring: &Wiring,
        session: u32,
        number: u32,
    ) -> Card {
        let serial = wiring.serial.as_ref();
        let drive = Drive {
            levels: wiring.outputs.map(|lines| lines.levels(&LinesOut::SAFE)).unwrap_or_default(),
            ..Drive::default()
        };
        Card {
            port,
            cycle,
            link: Link::new(number),
            bank: EncoderBank::new(config.encoders, config.step_max_counts, config.index),
            inputs: wiring.inputs,
            outputs: wiring.outputs,
            session,
            wait: config.wait_bound().sample,
            settle_wait: Nanos(config.wait_bound().commit.0 / COMMAND_READS_MAX as i64),
            lost_after: Nanos::from_millis(i64::from(config.lost_ms)),
            field_mask: serial.map_or(0, |serial| serial.field_mask()),
            analog_mask: serial.map_or(0, |serial| serial.analog_mask()),
            spindle_mask: serial.map_or(0, |serial| serial.spindle_mask()),
            reads_field: config.reads_field(),
            has_encoders: config.encoders > 0,
            buffer: [0; PACKET_BYTES_MAX],
            requested: None,
            sampled: None,
            lost: false,
            taken_over: false,
            drive,
            lines: LinesOut::SAFE,
            analog: Commit::default(),
            digital: Commit::default(),
            closer: None,
            unsent: None,
            write_number: number,
            written: false,
            armed: false,
            // Smart serial was started when the card was opened.
            phase: Phase::Running,
            exchange: None,
            exchanged: false,
            wrote: false,
            field_acquired: None,
        }
    }

    pub(crate) fn pulses(&self) -> IndexPulses {
        self.bank.pulses()
    }

    pub(crate) fn speeds(&self) -> [f64; CHANNELS] {
        self.bank.speeds()
    }

    /// Sends the request of the cycle, unless it was sent.
    pub(crate) fn request(&mut self, release: Nanos) {
        let sampled = self.sampled.is_some_and(|(at, _)| at >= release);
        if self.requested == Some(release) || sampled {
            return;
        }
        self.requested = Some(release);
        self.send_request();
    }

    fn send_request(&mut self) {
        if self.taken_over {
            return;
        }
        let number = self.link.next_number();
        self.cycle.set_request(number);
        let sent = self.port.send(self.cycle.read.bytes());
        self.link.seen.send_failures += u64::from(sent.is_err());
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
        self.request(release);
        let mut outcome = self.collect(release);
        self.requested = None;
        if outcome.is_ok() {
            self.link.seen.slow_exchanges += u64::from(self.exchange.is_some());
            self.act_while_idle(release);
        }
        if self.reads_field && outcome.is_ok() && self.field_acquired.is_none() {
            // The first time the terminals are read by an exchange that this cycle starts.
            for _ in 0..COMMAND_READS_MAX {
                self.send_request();
                outcome = self.collect(release);
                if outcome.is_err() || self.field_acquired.is_some() {
                    break;
                }
            }
        }
        self.sampled = Some((release, outcome));
        outcome
    }

    /// Waits for the answer to the newest request.
    fn collect(&mut self, release: Nanos) -> Result<Snapshot, Failure> {
        self.collect_within(release, self.wait)
    }

    /// As [`Card::collect`], at most for `wait`.
    fn collect_within(&mut self, release: Nanos, wait: Nanos) -> Result<Snapshot, Failure> {
        if self.lost {
            return Err(Failure::whole(ErrorKind::Lost));
        }
        self.port.start_wait(wait);
        for _ in 0..ANSWERS_MAX {
            let Some(bytes) = self.port.receive(&mut self.buffer) else { break };
            let answer = &self.buffer[..bytes.min(PACKET_BYTES_MAX)];
            if self.link.judge(self.cycle.request_number(answer)) == Kind::Fresh {
                self.link.seen.answers += 1;
                self.link.level.hit(release);
                let status = self.cycle.status(answer);
                return self.take_in(release, bytes, &status);
            }
        }
        self.link.seen.refusals += u64::from(self.port.is_refused());
        self.link.seen.timeouts += 1;
        let silence = self.link.level.miss(release);
        self.lost |= silence > self.lost_after;
        Err(Failure::whole(if self.lost {
            ErrorKind::Lost
        } else if self.link.level.is_failed() {
            ErrorKind::Stale
        } else {
            ErrorKind::Transient
        }))
    }

    /// Takes a fresh answer in, and answers the card's state with the next step of recovery.
    fn take_in(
        &mut self,
        release: Nanos,
        bytes: usize,
        status: &Status,
    ) -> Result<Snapshot, Failure> {
        if status.session != self.session {
            // A mark of 0 is that of power-up: the counts began anew, and where the robot stands is
            // not known. Any other one is that of a program that opened the card after this one.
            self.taken_over = status.session != 0;
            self.link.seen.takeovers += u64::from(self.taken_over);
            self.link.seen.restarts += u64::from(!self.taken_over);
            self.lost = true;
            return Err(Failure::whole(ErrorKind::Lost));
        }
        if self.written && status.write_number != self.write_number {
            self.link.seen.lost_writes += 1;
        }
        self.take_in_exchange(status);
        let words = self.cycle.encoder_words(&self.buffer[..bytes]);
        let believed =
            if self.has_encoders { self.bank.update(status.stamp, &words) } else { Ok(()) };
        self.act(release, status);
        if let Err(step) = believed {
            self.link.seen.bad_readings += 1;
            self.lost |= step.lasting;
            let kind = if step.lasting { ErrorKind::Lost } else { ErrorKind::Transient };
            return Err(Failure { kind, channel: step.channel });
        }
        Ok(Snapshot {
            counts: self.bank.counts(),
            lines: self.inputs.map(|lines| lines.lines(&status.levels)).unwrap_or_default(),
            lines_acquired: if self.reads_field { self.field_acquired } else { Some(release) },
        })
    }

    fn take_in_exchange(&mut self, status: &Status) {
        if status.command != 0 {
            return;
        }
        if let Some((began, channels)) = self.exchange.take() {
            let failed = status.failed & channels;
            self.link.seen.failed_exchanges += u64::from(failed != 0);
            if channels & self.field_mask != 0 && failed & self.field_mask == 0 {
                self.field_acquired = Some(began);
            }
        }
    }

    /// Sends what the card's state asks for: a step of recovery, or an exchange of inputs.
    fn act(&mut self, release: Nanos, status: &Status) {
        if let Some(channel) = self.bank.channel_to_rearm()
            && let Some(packet) = self.cycle.index.get(channel)
        {
            self.link.seen.send_failures += u64::from(self.port.send(packet.bytes()).is_err());
        }
        let waits = self.exchange.is_some();
        let masks = self.field_mask | self.analog_mask;
        let step = self.phase.next(status, masks, self.armed, waits, &mut self.link.seen);
        let packet = match step {
            Step::Nothing => None,
            Step::Rearm => Some(&self.cycle.rearm),
            Step::Feed => Some(&self.cycle.feed),
            Step::Stop => Some(&self.cycle.stop),
            Step::Start => Some(&self.cycle.start),
            Step::Zero => {
                self.clear_drive();
                self.write(release, masks, true);
                return;
            }
        };
        if let Some(packet) = packet {
            self.link.seen.send_failures += u64::from(self.port.send(packet.bytes()).is_err());
            if step != Step::Feed && self.armed {
                let feed = self.port.send(self.cycle.feed.bytes());
                self.link.seen.send_failures += u64::from(feed.is_err());
            }
        }
    }

    /// Whether a half asks for more than its safe values.
    fn is_active(&self) -> bool {
        self.analog.active || self.digital.active
    }

    /// What is due where nobody put anything out in the cycle before: a sign of life, and an
    /// exchange that reads the terminals. While lines are active either would keep them alive for a
    /// task that is dead.
    fn act_while_idle(&mut self, release: Nanos) {
        let wrote = core::mem::take(&mut self.wrote);
        if self.phase == Phase::Running && self.armed && !wrote && !self.is_active() {
            // Nothing but safe values is put out: no bite is needed to keep it so.
            let fed = self.port.send(self.cycle.feed.bytes());
            self.link.seen.send_failures += u64::from(fed.is_err());
        }
        let idle = !core::mem::take(&mut self.exchanged) && self.exchange.is_none();
        if self.reads_field && self.phase == Phase::Running && idle && !self.digital.active {
            let sent = self.port.send(self.cycle.poll.bytes());
            self.link.seen.send_failures += u64::from(sent.is_err());
            self.exchange = Some((release, self.field_mask));
        }
    }
}
