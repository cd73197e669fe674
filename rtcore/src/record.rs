//! The data that leave a lane for observers: the catalogue of the signals of a machine, one record
//! for each value written, and the trait of whatever takes records.

use std::borrow::Cow;

use taktil_hal::Nanos;

use crate::payload::Field;

/// What leaves the lanes for observers, each level with all of the ones before.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Recording {
    /// Nothing: values reach other lanes only.
    Off,
    /// Every value that is written, and what stands on tapes.
    Values,
    /// How each job came about: enough to replay the run.
    Decisions,
    /// The hash of each task's state after each job.
    #[default]
    Full,
}

/// One signal of a machine: an output port of a task, a tape, or one of a lane's own.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Signal {
    /// `task.port`, the name of a tape, or `lane.health`, `lane.state`, `lane.decision`.
    pub name: String,
    /// Index into [`Catalog::lanes`] of the lane that writes it.
    pub lane: usize,
    /// Payload type name.
    pub type_name: Cow<'static, str>,
    /// Fields of the payload.
    pub fields: Cow<'static, [Field]>,
    /// Bytes of an encoded body.
    pub size: usize,
}

/// One lane as seen by an observer.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LaneInfo {
    /// Name.
    pub name: String,
    /// Period.
    pub period: Nanos,
    /// Phase of job 0.
    pub phase: Nanos,
    /// Its tasks in order, as the elements of `lane.state`.
    pub tasks: Vec<String>,
    /// The signals of other lanes that it reads, as the lags of `lane.decision`.
    pub reads: Vec<String>,
}

/// Everything that a machine can record. A record's `signal` is an index into `signals`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Catalog {
    /// Signals in a fixed order: by lane; there its tapes, its health, the ports by task and as
    /// declared, its states, its decisions.
    pub signals: Vec<Signal>,
    /// Lanes in order.
    pub lanes: Vec<LaneInfo>,
}

impl Catalog {
    /// The index of a signal by its name.
    #[must_use]
    pub fn find(&self, name: &str) -> Option<usize> {
        self.signals.iter().position(|signal| signal.name == name)
    }
}

/// One value as it left a lane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Record<'a> {
    /// Index into [`Catalog::signals`].
    pub signal: usize,
    /// Job that wrote it.
    pub tick: u64,
    /// Logical time of that job.
    pub release: Nanos,
    /// Encoded payload.
    pub body: &'a [u8],
}

/// Something that sees every record, off the lanes' threads.
pub trait Observer {
    /// Called for each record; within one signal in order of time.
    fn record(&mut self, record: &Record<'_>);
}

/// Bytes in front of an encoded body: signal, length, tick, release.
pub(crate) const HEADER_BYTES: usize = 24;
