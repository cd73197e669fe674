//! A lane while the machine is put together: its tasks and what they declare, the catalogue that
//! follows, and the lane that is made of it.

use core::any::TypeId;
use std::collections::BTreeMap;
use std::sync::Arc;

use taktil_hal::Nanos;

use crate::fault_latch::FaultLatch;
use crate::figures::{Figures, TaskFigures};
use crate::lane::{Lane, LaneAccount, LanePlan, LanePorts, TaskSlot};
use crate::parameter::{Declaration, LaneEdit, LaneParameters};
use crate::port::{InputDeclaration, OutputDeclaration, Ports, empty_cell};
use crate::record::{Catalog, HEADER_BYTES, LaneInfo, Recording, Signal};
use crate::record_ring::{RecordReader, record_ring};
use crate::schedule::{LaneSpec, Reservation};
use crate::status::LaneHealth;
use crate::tape::TapeDeclaration;
use crate::trace::{self, Trace};

/// A lane that is not yet joined to others. Inputs and outputs stand with the position of their
/// task in the lane; [`NO_TASK`] stands for the lane itself.
pub(super) struct LaneDraft {
    pub(super) spec: LaneSpec,
    pub(super) tasks: Vec<TaskSlot>,
    pub(super) inputs: Vec<(usize, InputDeclaration)>,
    pub(super) outputs: Vec<(usize, OutputDeclaration)>,
    pub(super) tapes: Vec<TapeDeclaration>,
    /// By the name of the task.
    pub(super) parameters: Vec<(String, Declaration)>,
}

/// The position of an output that belongs to the lane and to no task of it.
pub(super) const NO_TASK: usize = usize::MAX;

impl LaneDraft {
    /// A lane without tasks. The lane's own health is its first output.
    pub(super) fn new(spec: LaneSpec) -> LaneDraft {
        let mut own = Ports::new(0, 0);
        let _ = own.output::<LaneHealth>("health");
        LaneDraft {
            spec,
            tasks: Vec::new(),
            inputs: Vec::new(),
            outputs: own.outputs.into_iter().map(|output| (NO_TASK, output)).collect(),
            tapes: Vec::new(),
            parameters: Vec::new(),
        }
    }

    /// The full name of the signal of an output: that of its task or of the lane, and the port's.
    pub(super) fn signal_name(&self, task: usize, port: &str) -> String {
        let owner = self.tasks.get(task).map_or(&self.spec.name, |task| &task.name);
        format!("{owner}.{port}")
    }
}

/// Where a signal is produced.
pub(super) struct SignalOrigin {
    pub(super) lane: usize,
    pub(super) cell: usize,
    /// Position of the task in the lane, or [`NO_TASK`].
    pub(super) task: usize,
    pub(super) type_id: TypeId,
    pub(super) type_name: std::borrow::Cow<'static, str>,
}

impl SignalOrigin {
    /// Whether the signal is the health of its lane, which was declared first.
    pub(super) fn is_health(&self) -> bool {
        self.cell == 0
    }
}

/// Every signal and lane of the machine that these lanes will be.
pub(super) fn catalog(drafts: &[LaneDraft], recording: Recording) -> Catalog {
    let mut catalog = Catalog::default();
    for (lane, draft) in drafts.iter().enumerate() {
        catalog.lanes.push(LaneInfo {
            name: draft.spec.name.clone(),
            period: draft.spec.period,
            phase: draft.spec.phase,
            tasks: draft.tasks.iter().map(|task| task.name.clone()).collect(),
            reads: Vec::new(),
        });
        catalog.signals.extend(draft.tapes.iter().map(|tape| Signal {
            name: tape.name.clone(),
            lane,
            type_name: tape.type_name.clone(),
            fields: tape.fields.clone(),
            size: tape.size,
        }));
        for (task, output) in &draft.outputs {
            catalog.signals.push(Signal {
                name: draft.signal_name(*task, output.name),
                lane,
                type_name: output.type_name.clone(),
                fields: output.fields.clone(),
                size: output.size,
            });
        }
        let traced = trace::signals(lane, &draft.spec, draft.tasks.len(), recording);
        catalog.signals.extend(traced);
    }
    catalog
}

/// Where each signal of the machine is produced, by its name.
pub(super) fn signal_origins(drafts: &[LaneDraft]) -> BTreeMap<String, SignalOrigin> {
    let mut origins = BTreeMap::new();
    for (lane, draft) in drafts.iter().enumerate() {
        for (cell, (task, output)) in draft.outputs.iter().enumerate() {
            let origin = SignalOrigin {
                lane,
                cell,
                task: *task,
                type_id: output.type_id,
                type_name: output.type_name.clone(),
            };
            origins.insert(draft.signal_name(*task, output.name), origin);
        }
    }
    origins
}

/// What is decided about a lane besides its draft.
pub(super) struct LaneSettings {
    pub(super) reservation: Option<Reservation>,
    pub(super) release_jitter: Nanos,
    /// Whether each task is timed.
    pub(super) timed: bool,
    /// How long an observer may stand still before records are lost.
    pub(super) stall: Nanos,
}

/// A lane and what is kept outside it: the reading end of its records and the sending end of its
/// edits.
pub(super) struct BuiltLane {
    pub(super) lane: Lane,
    pub(super) records: RecordReader,
    pub(super) edits: rtrb::Producer<LaneEdit>,
}

/// Makes lane `index` of its draft, whose tasks, cells and tapes it takes; its inputs are not
/// joined yet.
pub(super) fn build_lane(
    draft: &mut LaneDraft,
    index: usize,
    catalog: &Catalog,
    origins: &BTreeMap<String, SignalOrigin>,
    settings: &LaneSettings,
) -> BuiltLane {
    let mine =
        || catalog.signals.iter().enumerate().filter(move |(_, signal)| signal.lane == index);
    let (capacity, body) = ring_bytes(draft, mine().map(|(_, signal)| signal.size), settings.stall);
    let (writer, records) = record_ring(capacity, body);
    let signals = mine()
        .filter_map(|(number, signal)| {
            let cell = origins.get(&signal.name)?.cell;
            Some((cell, u16::try_from(number).ok()?))
        })
        .collect();
    let take_cell =
        |output: &mut OutputDeclaration| std::mem::replace(&mut output.cell, empty_cell());
    let cells = draft.outputs.iter_mut().map(|(_, output)| take_cell(output)).collect();
    let (parameters, edits) = LaneParameters::new(
        draft.parameters.iter().map(|(_, declared)| declared.initial).collect(),
    );
    let plan = LanePlan {
        spec: draft.spec.clone(),
        reservation: settings.reservation,
        release_jitter: settings.release_jitter,
        recording: Recording::Full,
    };
    let ports = LanePorts {
        cells,
        inputs: Vec::new(),
        signals,
        mode: None,
        pace: None,
        // The lane's own health was declared first: it is output cell 0.
        health: Ports::new(0, 0).output::<LaneHealth>("health"),
        edit: None,
        trace: lane_trace(draft, catalog),
        records: writer,
        scratch: vec![0; HEADER_BYTES + body].into_boxed_slice(),
    };
    let account = LaneAccount {
        next_tick: 0,
        missed: 0,
        latch: FaultLatch::new(Nanos::ZERO),
        figures: figures(draft, settings.timed),
        panicked: None,
        stopped: false,
        pace: Nanos::ZERO,
    };
    let tasks = std::mem::take(&mut draft.tasks);
    let (activity, lateness) = (Arc::default(), Arc::default());
    let lane = Lane { plan, tasks, parameters, ports, account, activity, lateness };
    BuiltLane { lane, records, edits }
}

/// Bytes of a lane's record ring, which holds the records of `stall`, and of its largest body.
fn ring_bytes(
    draft: &LaneDraft,
    sizes: impl Iterator<Item = usize> + Clone,
    stall: Nanos,
) -> (usize, usize) {
    let body = sizes.clone().max().unwrap_or(0);
    // A device may be asked twice in a job, so tapes are counted once more.
    let tapes: usize = draft.tapes.iter().map(|tape| HEADER_BYTES + tape.size).sum();
    let job_bytes: usize = sizes.map(|size| HEADER_BYTES + size).sum::<usize>() + tapes;
    let jobs = usize::try_from((stall.0 / draft.spec.period.0).max(4)).unwrap_or(4);
    (job_bytes * jobs, body)
}

fn figures(draft: &LaneDraft, timed: bool) -> Figures {
    let mut figures = Figures::new();
    if timed {
        let task = |slot: &TaskSlot| {
            TaskFigures::new(&slot.name, draft.spec.budgets.get(&slot.name).copied())
        };
        figures.tasks = draft.tasks.iter().map(task).collect();
    }
    figures
}

/// The trace of a lane, with the numbers of its own signals; takes the tapes of the draft.
fn lane_trace(draft: &mut LaneDraft, catalog: &Catalog) -> Trace {
    let number = |name: &str| catalog.find(name).and_then(|number| u16::try_from(number).ok());
    let mut trace = Trace::default();
    for tape in std::mem::take(&mut draft.tapes) {
        trace.tapes.extend(number(&tape.name).map(|number| (tape.reader, number)));
    }
    trace.decisions = number(&format!("{}.decision", draft.spec.name));
    trace.state = number(&format!("{}.state", draft.spec.name))
        .map(|number| (number, catalog.signals[usize::from(number)].size / 8));
    trace
}
