//! The half of a Net F/T sensor: takes what has arrived, hands out the newest record, and asks a
//! silent box to start again.

use core::fmt;

use taktil_hal::{
    AdcCode, Error, ErrorKind, FORCE_TORQUE_CHANNELS, ForceTorque, GaugeCodes, Nanos, Reading,
};

use crate::config::Config;
use crate::monitor::StreamMonitor;
use crate::port::{Arrival, BUFFER_BYTES, Port};
use crate::rdt::{Command, Record, request};
use crate::stream::{Stream, StreamCounts, Verdict};

const DEVICE_NAME: &str = "netft.force_torque";
/// Datagrams that one job takes at most.
const DATAGRAMS_MAX: usize = 1_024;
/// When more records than these have piled up, their age is unknown: a socket of the kernel's usual
/// size holds about 270 and discards those that come later.
pub const BACKLOG_RECORDS_MAX: usize = 128;

/// What arrived since the job before.
#[derive(Clone, Copy, Debug, Default)]
struct Arrivals {
    /// The newest record that is valid.
    newest: Option<Record>,
    records: usize,
    is_invalid: bool,
}

/// The force/torque half of a box.
pub struct NetFt {
    port: Box<dyn Port>,
    config: Config,
    stream: Stream,
    monitor: StreamMonitor,
    /// The newest record that was handed out.
    last: Option<Reading<GaugeCodes>>,
    /// The answer of the newest release.
    answer: Option<(Nanos, Result<Reading<GaugeCodes>, Error>)>,
    /// The newest release at which a record arrived, and at which the box was asked.
    heard: Option<Nanos>,
    asked: Option<Nanos>,
    lost: bool,
}

impl fmt::Debug for NetFt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("NetFt").field("seen", &self.stream.seen).finish_non_exhaustive()
    }
}

impl NetFt {
    /// The half of a box that streams behind `port` already, such as a model of it in this process.
    #[must_use]
    pub fn new(port: Box<dyn Port>, config: &Config) -> NetFt {
        NetFt {
            port,
            config: config.clone(),
            stream: Stream::default(),
            monitor: StreamMonitor::default(),
            last: None,
            answer: None,
            heard: None,
            asked: None,
            lost: false,
        }
    }

    /// What was counted, for whoever looks from outside.
    #[must_use]
    pub fn monitor(&self) -> StreamMonitor {
        self.monitor.clone()
    }

    /// What was counted.
    #[must_use]
    pub fn counts(&self) -> StreamCounts {
        self.stream.seen
    }

    fn drain(&mut self) -> Arrivals {
        let mut buffer = [0; BUFFER_BYTES];
        let mut arrivals = Arrivals::default();
        for _ in 0..DATAGRAMS_MAX {
            let bytes = match self.port.receive(&mut buffer) {
                Arrival::Datagram(bytes) => bytes,
                Arrival::Refusal => {
                    self.stream.seen.refusals += 1;
                    continue;
                }
                Arrival::Nothing => break,
            };
            let Some(record) = buffer.get(..bytes).and_then(Record::parse) else {
                self.stream.seen.strange += 1;
                continue;
            };
            arrivals.records += 1;
            match self.stream.take(record) {
                Verdict::New => (arrivals.newest, arrivals.is_invalid) = (Some(record), false),
                Verdict::Invalid => (arrivals.newest, arrivals.is_invalid) = (None, true),
                Verdict::Old => {}
            }
        }
        arrivals
    }

    /// Asks a box that has been silent for long to start again.
    fn ask_again(&mut self, release: Nanos) {
        let pause = Nanos::from_millis(i64::from(self.config.ask_again_ms));
        let heard = *self.heard.get_or_insert(release);
        let newest = self.asked.map_or(heard, |asked| asked.max(heard));
        if release - newest >= pause {
            self.asked = Some(release);
            self.stream.seen.requests += 1;
            self.stream.expect_new_stream();
            // Whether it arrived is seen by what comes.
            let _ = self.port.send(&request(Command::Start, 0));
        }
    }

    fn gauges(&self, record: &Record) -> GaugeCodes {
        let limits = [self.config.force_range_counts, self.config.torque_range_counts];
        let over_range = core::array::from_fn(|axis| {
            let limit = limits[usize::from(axis >= FORCE_TORQUE_CHANNELS / 2)];
            limit > 0 && record.counts[axis].unsigned_abs() >= limit
        });
        GaugeCodes { codes: record.counts.map(AdcCode), over_range }
    }

    fn answer(&mut self, release: Nanos) -> Result<Reading<GaugeCodes>, Error> {
        let restarts = self.stream.seen.restarts;
        let arrivals = self.drain();
        if arrivals.records > 0 {
            self.heard = Some(release);
        }
        self.ask_again(release);
        let is_backlog = arrivals.records > BACKLOG_RECORDS_MAX;
        self.stream.seen.backlogs += u64::from(is_backlog);
        self.lost |= self.config.bias && self.stream.seen.restarts > restarts;
        self.monitor.publish(&self.stream.seen);
        let error = |kind| Err(Error::whole(kind, DEVICE_NAME));
        if self.lost {
            return error(ErrorKind::Lost);
        }
        if let Some(record) = arrivals.newest.filter(|_| !is_backlog) {
            let before = self.last.map_or(Nanos(i64::MIN), |last| last.acquired);
            let acquired = Nanos(release.0.saturating_sub(self.config.record_period().0));
            let reading = Reading { value: self.gauges(&record), acquired: acquired.max(before) };
            self.last = Some(reading);
            return Ok(reading);
        }
        let stale_after = i64::from(self.config.stale_ms) * 1_000_000;
        let since = self.last.map(|last| last.acquired).or(self.heard).unwrap_or(release);
        match self.last {
            _ if release.0.saturating_sub(since.0) > stale_after => error(ErrorKind::Stale),
            Some(held) if !arrivals.is_invalid && !is_backlog => Ok(held),
            _ => error(ErrorKind::Transient),
        }
    }
}

impl ForceTorque for NetFt {
    fn sample(&mut self, release: Nanos) -> Result<Reading<GaugeCodes>, Error> {
        if let Some((at, answer)) = self.answer
            && at == release
        {
            return answer;
        }
        let answer = self.answer(release);
        self.answer = Some((release, answer));
        answer
    }
}
