//! Ports: how a task declares what it reads and writes, and how it does so in a job.
//!
//! Inside a lane a value is visible to the next task in order. Between lanes it becomes visible at
//! its producer's release plus the declared delivery time, never earlier, never later. Every read
//! says whether the value is new, held or stale. Values that are not finite, or out of the range
//! that their output was declared with, are refused at the port: the last good one stays and the
//! lane raises a fault.

mod array;
mod declaration;
mod spoilt;
mod unconnected;

use core::any::{Any, TypeId};
use core::marker::PhantomData;
use core::ops::RangeInclusive;

use taktil_hal::Nanos;
use taktil_hal::link::{Receiver, Sender, link};

use crate::array_payload::ArrayPayload;
use crate::fault::FaultCode;
use crate::parameter::{Declaration, Param};
use crate::payload::Payload;
pub(crate) use declaration::{InputDeclaration, OutputDeclaration};
pub(crate) use spoilt::CellCopy;
use spoilt::spoilt;
pub(crate) use unconnected::Unconnected;
use unconnected::unconnected;

use crate::tape::{ArrayTape, Tape, TapeDeclaration, array_tape, tape};

/// How fresh a value is that was read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Freshness {
    /// Nothing has arrived yet; the value is all zero.
    Absent,
    /// Arrived since this input was last read.
    New,
    /// Read before, and not older than the input's limit.
    Held,
    /// Older than the input's limit.
    Stale,
}

/// A value that was read, with its age in logical time.
#[derive(Clone, Copy, Debug)]
pub struct Sample<T> {
    /// The value; zero when absent.
    pub value: T,
    /// Release of the job that produced it.
    pub stamp: Nanos,
    /// Release of the reading job minus `stamp`.
    pub age: Nanos,
    /// New, held, stale or absent.
    pub freshness: Freshness,
}

impl<T> Sample<T> {
    /// The value, unless nothing has arrived yet or it is too old.
    pub fn usable(self) -> Option<T> {
        match self.freshness {
            Freshness::New | Freshness::Held => Some(self.value),
            Freshness::Absent | Freshness::Stale => None,
        }
    }

    /// The value, only when it was not read before.
    pub fn fresh(self) -> Option<T> {
        (self.freshness == Freshness::New).then_some(self.value)
    }
}

/// A task's handle on an input; valid in the lane that the task was built for.
#[derive(Debug)]
pub struct Input<T> {
    index: usize,
    of: PhantomData<fn() -> T>,
}

impl<T> Clone for Input<T> {
    fn clone(&self) -> Input<T> {
        *self
    }
}

impl<T> Copy for Input<T> {}

/// A task's handle on an output; valid in the lane that the task was built for.
#[derive(Debug)]
pub struct Output<T> {
    cell: usize,
    of: PhantomData<fn(T)>,
}

/// The newest value of one signal as one lane sees it, with the links that carry it to or from
/// other lanes.
struct Cell<T> {
    value: T,
    stamp: Nanos,
    version: u64,
    written: bool,
    within: Option<fn(&T) -> bool>,
    to: Vec<Sender<T>>,
    from: Option<Receiver<T>>,
    /// The value that was refused last, for whoever tests the task.
    refused: Option<T>,
}

/// What a lane does with its cells without knowing their types.
pub(crate) trait AnyCell: Any + Send {
    /// Takes what has become visible at `release`; says from when it is.
    fn receive(&mut self, release: Nanos) -> Option<Nanos>;
    /// Writes an encoded value as if a task had; false when the length is wrong.
    fn inject(&mut self, body: &[u8], release: Nanos) -> bool;
    /// In place of what was written in this job, writes the value of `before` with a number in it
    /// that is not finite, as a task would; what it refuses is returned. Nothing was written then.
    /// A value without such numbers stays as it was written.
    fn spoil(&mut self, before: &mut CellCopy, release: Nanos) -> Result<(), FaultCode>;
    /// Copies the value, for [`AnyCell::spoil`] in a later job.
    fn copy_to(&self, copy: &mut CellCopy);
    /// If written in this job: sends it to the other lanes and encodes it; returns the body's
    /// length. With nowhere to encode it only sends.
    fn publish(&mut self, visible: Nanos, scratch: Option<&mut [u8]>) -> Option<usize>;
    /// Whether other lanes read it.
    fn is_linked(&self) -> bool;
    /// Values lost to full rings.
    fn dropped(&self) -> u64;
    /// Puts another value in the place of the present one, whose stamp and freshness stay; false
    /// when the length is wrong.
    fn replace(&mut self, body: &[u8]) -> bool;
    /// Encodes the value that was refused since this was asked last; false when there is none.
    fn take_refused(&mut self, _body: &mut [u8]) -> bool {
        false
    }
}

impl<T: Payload> Cell<T> {
    fn new(from: Option<Receiver<T>>) -> Cell<T> {
        Cell {
            value: T::ZERO,
            stamp: Nanos::ZERO,
            version: 0,
            written: false,
            within: None,
            to: Vec::new(),
            from,
            refused: None,
        }
    }

    /// Takes a value that a task wrote, unless it is not what may leave the task.
    #[inline]
    fn take(&mut self, value: T, release: Nanos) -> Result<(), FaultCode> {
        if !value.is_finite() {
            return Err(self.refuse(value, FaultCode::NotFinite));
        }
        if self.within.is_some_and(|within| !within(&value)) {
            return Err(self.refuse(value, FaultCode::OutOfRange));
        }
        self.value = value;
        self.stamp = release;
        self.version += 1;
        self.written = true;
        Ok(())
    }

    #[cold]
    #[inline(never)]
    fn refuse(&mut self, value: T, fault: FaultCode) -> FaultCode {
        self.refused = Some(value);
        fault
    }
}

impl<T: Payload> AnyCell for Cell<T> {
    fn receive(&mut self, release: Nanos) -> Option<Nanos> {
        let arrived = self.from.as_mut()?.newest(release)?;
        self.value = arrived.value;
        self.stamp = arrived.stamp;
        self.version += 1;
        Some(arrived.stamp)
    }

    fn inject(&mut self, body: &[u8], release: Nanos) -> bool {
        let Some(value) = T::decode(body) else { return false };
        self.value = value;
        self.stamp = release;
        self.version += 1;
        self.written = true;
        true
    }

    fn spoil(&mut self, before: &mut CellCopy, release: Nanos) -> Result<(), FaultCode> {
        let held = before.body.get(..T::SIZE).and_then(T::decode);
        let (true, Some(held)) = (self.written, held) else { return Ok(()) };
        let Some(spoilt) = spoilt(self.value, &mut before.body) else { return Ok(()) };
        held.encode(&mut before.body[..T::SIZE]);
        (self.value, self.stamp, self.version) = (held, before.stamp, before.version);
        self.written = false;
        self.take(spoilt, release)
    }

    fn copy_to(&self, copy: &mut CellCopy) {
        if let Some(body) = copy.body.get_mut(..T::SIZE) {
            self.value.encode(body);
        }
        (copy.stamp, copy.version) = (self.stamp, self.version);
    }

    fn publish(&mut self, visible: Nanos, scratch: Option<&mut [u8]>) -> Option<usize> {
        if !self.written {
            return None;
        }
        self.written = false;
        for ring in &mut self.to {
            // A full ring is counted by the sender and reported with the lane's figures.
            let _ = ring.send(self.value, self.stamp, visible);
        }
        self.value.encode(&mut scratch?[..T::SIZE]);
        Some(T::SIZE)
    }

    fn is_linked(&self) -> bool {
        !self.to.is_empty()
    }

    fn dropped(&self) -> u64 {
        self.to.iter().map(Sender::dropped).sum()
    }

    fn replace(&mut self, body: &[u8]) -> bool {
        let Some(value) = T::decode(body) else { return false };
        self.value = value;
        true
    }

    fn take_refused(&mut self, body: &mut [u8]) -> bool {
        let Some(value) = self.refused.take() else { return false };
        value.encode(&mut body[..T::SIZE]);
        true
    }
}

/// Where an input finds its value in the lane, and what it has seen.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Binding {
    pub(crate) cell: usize,
    pub(crate) seen: u64,
    pub(crate) stale_after: Nanos,
}

/// How fresh the value of this version and age is; from now on it was read.
#[inline]
fn freshness(binding: &mut Binding, version: u64, age: Nanos) -> Freshness {
    let freshness = if age > binding.stale_after {
        Freshness::Stale
    } else if binding.seen == version {
        Freshness::Held
    } else {
        Freshness::New
    };
    binding.seen = version;
    freshness
}

fn connect<T: Payload>(producer: &mut dyn AnyCell, capacity: usize) -> Option<Box<dyn AnyCell>> {
    let producer: &mut dyn Any = producer;
    let cell = producer.downcast_mut::<Cell<T>>()?;
    let (sender, receiver) = link(capacity);
    cell.to.push(sender);
    Some(Box::new(Cell::<T>::new(Some(receiver))))
}

/// A placeholder that carries nothing, left where a cell was moved out.
pub(crate) fn empty_cell() -> Box<dyn AnyCell> {
    Box::new(Cell::<crate::status::LaneHealth>::new(None))
}

/// What a task's constructor declares its ports on.
pub struct Ports {
    first_input: usize,
    first_cell: usize,
    pub(crate) inputs: Vec<InputDeclaration>,
    pub(crate) outputs: Vec<OutputDeclaration>,
    pub(crate) tapes: Vec<TapeDeclaration>,
    pub(crate) first_parameter: usize,
    pub(crate) parameters: Vec<Declaration>,
}

impl Ports {
    pub(crate) fn new(first_input: usize, first_cell: usize) -> Ports {
        let (inputs, outputs, tapes) = (Vec::new(), Vec::new(), Vec::new());
        let (first_parameter, parameters) = (0, Vec::new());
        Ports { first_input, first_cell, inputs, outputs, tapes, first_parameter, parameters }
    }

    /// Declares a tape: what a device half of this task answers is recorded as the signal `name`,
    /// such as `hal.encoders`. No task can read it.
    pub fn tape<T: Payload>(&mut self, name: &str) -> Tape<T> {
        let (tape, declaration) = tape(name);
        self.tapes.push(declaration);
        tape
    }

    /// As [`Ports::tape`], of entries with the lengths of `like`.
    pub fn array_tape<T: ArrayPayload>(&mut self, name: &str, like: &T) -> ArrayTape<T> {
        let (tape, declaration) = array_tape(name, like);
        self.tapes.push(declaration);
        tape
    }

    /// Declares an input; the configuration binds its name to a signal. Never called stale.
    pub fn input<T: Payload>(&mut self, name: &'static str) -> Input<T> {
        self.declare(name, false, Nanos::MAX)
    }

    /// Declares an input whose value is called stale when it is older than `limit`.
    pub fn input_within<T: Payload>(&mut self, name: &'static str, limit: Nanos) -> Input<T> {
        self.declare(name, false, limit)
    }

    /// Declares a feedback input: its producer may stand later in the lane, so the value may be one
    /// tick old.
    pub fn input_delayed<T: Payload>(&mut self, name: &'static str) -> Input<T> {
        self.declare(name, true, Nanos::MAX)
    }

    fn declare<T: Payload>(
        &mut self,
        name: &'static str,
        delayed: bool,
        stale_after: Nanos,
    ) -> Input<T> {
        let index = self.first_input + self.inputs.len();
        self.inputs.push(InputDeclaration {
            name,
            type_id: TypeId::of::<T>(),
            type_name: T::NAME,
            delayed,
            stale_after,
            connect: connect::<T>,
            unconnected: unconnected::<T>,
        });
        Input { index, of: PhantomData }
    }

    /// Declares a number that may be edited while the machine runs, called `task.name`, with its
    /// first value and its range. A first value outside the range refuses the machine at load.
    pub fn parameter(&mut self, name: &str, initial: f64, range: RangeInclusive<f64>) -> Param {
        let index = self.first_parameter + self.parameters.len();
        let (low, high) = (*range.start(), *range.end());
        self.parameters.push(Declaration { name: name.to_owned(), initial, low, high });
        Param(index)
    }

    /// As [`Ports::parameter`], with a range from a tenth of the first value to four times it: what
    /// may be tuned on a machine that runs, and no other order of magnitude.
    pub fn tunable(&mut self, name: &str, initial: f64) -> Param {
        let ends = (initial * 0.1, initial * 4.0);
        self.parameter(name, initial, ends.0.min(ends.1)..=ends.0.max(ends.1))
    }

    /// As [`Ports::tunable`], several of one kind.
    pub fn tunables<const N: usize>(&mut self, name: &str, initial: [f64; N]) -> [Param; N] {
        core::array::from_fn(|i| self.tunable(&format!("{name}[{i}]"), initial[i]))
    }

    /// Declares several of one kind, called `task.name[i]`; `task.name` edits all of them.
    pub fn parameters<const N: usize>(
        &mut self,
        name: &str,
        initial: [f64; N],
        range: RangeInclusive<f64>,
    ) -> [Param; N] {
        core::array::from_fn(|i| self.parameter(&format!("{name}[{i}]"), initial[i], range.clone()))
    }

    /// Declares an output; its signal is called `task.name`.
    pub fn output<T: Payload>(&mut self, name: &'static str) -> Output<T> {
        self.declare_output(name, None)
    }

    /// As [`Ports::output`], for values that can be told to be wrong: what is not `within` never
    /// leaves the task.
    pub fn output_within<T: Payload>(
        &mut self,
        name: &'static str,
        within: fn(&T) -> bool,
    ) -> Output<T> {
        self.declare_output(name, Some(within))
    }

    fn declare_output<T: Payload>(
        &mut self,
        name: &'static str,
        within: Option<fn(&T) -> bool>,
    ) -> Output<T> {
        let cell = self.first_cell + self.outputs.len();
        self.outputs.push(OutputDeclaration {
            name,
            type_id: TypeId::of::<T>(),
            type_name: T::NAME.into(),
            fields: T::FIELDS.into(),
            size: T::SIZE,
            cell: Box::new(Cell { within, ..Cell::<T>::new(None) }),
        });
        Output { cell, of: PhantomData }
    }
}

/// A task's access to its ports during one job.
pub struct Io<'a> {
    pub(crate) cells: &'a mut [Box<dyn AnyCell>],
    pub(crate) inputs: &'a mut [Binding],
    pub(crate) parameters: &'a [f64],
    pub(crate) release: Nanos,
    /// Why a value was not taken since this was looked at last.
    pub(crate) refused: Option<FaultCode>,
}

impl Io<'_> {
    /// The newest visible value of an input.
    #[inline]
    pub fn read<T: Payload>(&mut self, input: &Input<T>) -> Sample<T> {
        let release = self.release;
        let absent = Sample {
            value: T::ZERO,
            stamp: release,
            age: Nanos::ZERO,
            freshness: Freshness::Absent,
        };
        let Some(binding) = self.inputs.get_mut(input.index) else { return absent };
        let Some(cell) = self.cells.get(binding.cell) else { return absent };
        let cell: &dyn Any = cell.as_ref();
        let Some(cell) = cell.downcast_ref::<Cell<T>>() else { return absent };
        if cell.version == 0 {
            return absent;
        }
        let age = release - cell.stamp;
        let freshness = freshness(binding, cell.version, age);
        Sample { value: cell.value, stamp: cell.stamp, age, freshness }
    }

    /// Writes an encoded value to a cell of this lane; a body of another length is refused.
    pub(crate) fn inject(&mut self, cell: usize, body: &[u8]) {
        let written = self.cells.get_mut(cell).map(|cell| cell.inject(body, self.release));
        if written != Some(true) {
            self.refused = Some(FaultCode::NotFinite);
        }
    }

    /// A fault by plan: see [`AnyCell::spoil`].
    pub(crate) fn spoil(&mut self, cell: usize, before: &mut CellCopy) {
        let spoilt = self.cells.get_mut(cell).map(|cell| cell.spoil(before, self.release));
        if let Some(Err(fault)) = spoilt {
            self.refused = Some(fault);
        }
    }

    /// Copies the value of a cell, for [`Io::spoil`] in a later job.
    pub(crate) fn copy(&self, cell: usize, copy: &mut CellCopy) {
        if let Some(cell) = self.cells.get(cell) {
            cell.copy_to(copy);
        }
    }

    /// The value of a parameter in this job: the first one, or that of the last edit.
    #[inline]
    #[must_use]
    pub fn parameter(&self, parameter: Param) -> f64 {
        self.parameters.get(parameter.0).copied().unwrap_or(f64::NAN)
    }

    /// The values of several parameters in this job.
    #[must_use]
    pub fn parameters<const N: usize>(&self, parameters: &[Param; N]) -> [f64; N] {
        parameters.map(|parameter| self.parameter(parameter))
    }

    /// Writes an output; the last write of a job counts. A value that is not finite, or out of the
    /// range that the output was declared with, is refused and raises a fault; the last good value
    /// stays.
    #[inline]
    pub fn write<T: Payload>(&mut self, output: &Output<T>, value: T) {
        let release = self.release;
        let Some(cell) = self.cells.get_mut(output.cell) else { return };
        let cell: &mut dyn Any = cell.as_mut();
        if let Some(cell) = cell.downcast_mut::<Cell<T>>()
            && let Err(fault) = cell.take(value, release)
        {
            self.refused = Some(fault);
        }
    }
}
