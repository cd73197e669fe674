//! The trace of each job: which value it took of every signal of another lane, how many jobs were
//! left out before it, the notice of the schedule, and the state of each task after it. With the
//! tapes of the devices this is all that a run depends on, so that [`crate::replay`] repeats it bit
//! for bit. The lateness of a job is not part of the trace but of the figures, because the same
//! decisions must give the same record.

use taktil_hal::Nanos;

use crate::fault::FaultSet;
use crate::misses::Notice;
use crate::payload;
use crate::payload::Payload;
use crate::port::AnyCell;
use crate::record::{HEADER_BYTES, Recording, Signal};
use crate::record_ring::RecordWriter;
use crate::schedule::LaneSpec;
use crate::tape::AnyTape;

/// Most signals of other lanes that one lane may read: what a decision has room for.
pub const REMOTE_MAX: usize = 32;

payload! {
    /// What was decided about one job: the signal `lane.decision`, the last record of each job.
    pub struct Decision {
        /// Faults that the schedule raised since the job before, a [`crate::FaultSet`].
        pub faults: u64,
        /// Jobs that the schedule says were missed or left out since the job before.
        pub missed: u32,
        /// Other lanes that the schedule says stand still, one bit each.
        pub silent: u32,
        /// Jobs left out just before this one.
        pub skipped: u32,
        /// Records and tape entries of this lane that were lost so far.
        pub lost: u32,
        /// For each signal of another lane that this lane reads, in the order in which they were
        /// bound: the newest tick of its producer that was due, minus the tick that the job had. 0
        /// when everything due had come.
        pub lags: [u16; 32],
    }
}

impl Decision {
    /// The notice of the schedule to the job.
    fn notice(&self) -> Notice {
        Notice { faults: FaultSet(self.faults), missed: self.missed, silent: self.silent }
    }
}

payload! {
    /// The state of each task after a job, by its place in the lane: `lane.state`. 0 where no task
    /// stands, and where one panicked.
    pub struct LaneState8 {
        /// [`crate::StateHash`] of each task.
        pub task: [u64; 8],
    }
}

payload! {
    /// As [`LaneState8`], for lanes with more tasks.
    pub struct LaneState16 {
        /// [`crate::StateHash`] of each task.
        pub task: [u64; 16],
    }
}

payload! {
    /// As [`LaneState8`], for lanes with still more tasks.
    pub struct LaneState32 {
        /// [`crate::StateHash`] of each task.
        pub task: [u64; 32],
    }
}

/// The signals of a lane's own that carry its trace.
pub(crate) fn signals(lane: usize, spec: &LaneSpec, seats: usize, of: Recording) -> Vec<Signal> {
    fn signal<T: Payload>(lane: usize, name: String) -> Signal {
        let (type_name, fields) = (T::NAME.into(), T::FIELDS.into());
        Signal { name, lane, type_name, fields, size: T::SIZE }
    }
    let name = |port: &str| format!("{}.{port}", spec.name);
    let state = (of >= Recording::Full).then(|| match seats {
        0..=8 => signal::<LaneState8>(lane, name("state")),
        9..=16 => signal::<LaneState16>(lane, name("state")),
        _ => signal::<LaneState32>(lane, name("state")),
    });
    let decision = (of >= Recording::Decisions).then(|| signal::<Decision>(lane, name("decision")));
    state.into_iter().chain(decision).collect()
}

/// A cell that another lane feeds, and when that lane's values are due.
pub(crate) struct RemoteInput {
    cell: usize,
    period: i64,
    /// Phase plus delivery: when the value of job 0 is due.
    first_due: i64,
    phase: i64,
    /// The tick whose value is held; -1 before the first.
    held: i64,
}

impl RemoteInput {
    pub(crate) fn new(cell: usize, producer: &LaneSpec) -> RemoteInput {
        RemoteInput {
            cell,
            period: producer.period.0,
            first_due: (producer.phase + producer.delivery).0,
            phase: producer.phase.0,
            held: -1,
        }
    }

    /// The newest tick whose value is due at `release`; -1 before the first.
    fn due(&self, release: Nanos) -> i64 {
        let since = release.0 - self.first_due;
        if since < 0 { -1 } else { since / self.period }
    }

    /// Takes what is visible, or exactly what lay `replayed` ticks back; returns how far back.
    fn take(
        &mut self,
        release: Nanos,
        replayed: Option<u16>,
        cells: &mut [Box<dyn AnyCell>],
    ) -> u16 {
        let due = self.due(release);
        let visible = match replayed {
            None => release,
            Some(lag) => Nanos(self.first_due + (due - i64::from(lag)) * self.period),
        };
        if let Some(stamp) = cells[self.cell].receive(visible) {
            self.held = (stamp.0 - self.phase) / self.period;
        }
        u16::try_from((due - self.held).max(0)).unwrap_or(u16::MAX)
    }
}

/// A lane's trace.
#[derive(Default)]
pub(crate) struct Trace {
    pub(crate) remote: Vec<RemoteInput>,
    pub(crate) tapes: Vec<(Box<dyn AnyTape>, u16)>,
    /// Number of the signal `lane.decision`.
    pub(crate) decisions: Option<u16>,
    /// Number of the signal `lane.state`, and places in it.
    pub(crate) state: Option<(u16, usize)>,
    /// In a replay: what was decided about the next job.
    pub(crate) replayed: Option<Decision>,
    /// The tick after that of the job before.
    next: u64,
    tape_lost: u64,
    decision: Decision,
}

impl Trace {
    /// Takes the inputs of a job and notes what was taken; what the schedule has to say to it is
    /// `notice`, or in a replay what it said then.
    pub(crate) fn take_inputs(
        &mut self,
        (tick, release): (u64, Nanos),
        notice: Notice,
        cells: &mut [Box<dyn AnyCell>],
    ) -> Notice {
        let skipped = u32::try_from(tick - self.next.min(tick)).unwrap_or(u32::MAX);
        self.next = tick + 1;
        let notice = self.replayed.as_ref().map_or(notice, Decision::notice);
        let Notice { faults: FaultSet(faults), missed, silent } = notice;
        self.decision = Decision { skipped, faults, missed, silent, ..Decision::ZERO };
        for (index, remote) in self.remote.iter_mut().enumerate() {
            let replayed = self.replayed.map(|decision| decision.lags[index]);
            self.decision.lags[index] = remote.take(release, replayed, cells);
        }
        notice
    }

    /// Writes what the devices answered in this job.
    pub(crate) fn publish_tapes(
        &mut self,
        tick: u64,
        records: &mut RecordWriter,
        scratch: &mut [u8],
    ) {
        for (tape, signal) in &mut self.tapes {
            while let Some((release, length, lost)) = tape.next(&mut scratch[HEADER_BYTES..]) {
                self.tape_lost += lost;
                records.append(*signal, tick, release, &mut scratch[..HEADER_BYTES + length]);
            }
        }
    }

    /// Writes the state of the tasks, then the decision: the last record of the job.
    pub(crate) fn publish(
        &mut self,
        (tick, release): (u64, Nanos),
        states: impl Iterator<Item = u64>,
        records: &mut RecordWriter,
        scratch: &mut [u8],
    ) {
        if let Some((signal, places)) = self.state {
            let length = HEADER_BYTES + places * 8;
            let words = scratch[HEADER_BYTES..length].chunks_exact_mut(8);
            for (word, state) in words.zip(states.chain(core::iter::repeat(0))) {
                word.copy_from_slice(&state.to_le_bytes());
            }
            records.append(signal, tick, release, &mut scratch[..length]);
        }
        if let Some(signal) = self.decisions {
            self.decision.lost =
                u32::try_from(records.dropped() + self.tape_lost).unwrap_or(u32::MAX);
            let length = HEADER_BYTES + Decision::SIZE;
            self.decision.encode(&mut scratch[HEADER_BYTES..length]);
            records.append(signal, tick, release, &mut scratch[..length]);
        }
    }

    /// Tape entries lost so far.
    pub(crate) fn tape_lost(&self) -> u64 {
        self.tape_lost
    }
}
