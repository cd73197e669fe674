//! A test harness around one task: no lane, no wiring, no clock of its own. Whoever drives it puts
//! encoded values into the task's inputs, with any stamp, and looks at what a step wrote, folded,
//! raised and cost. A step runs in the code that lanes run it in: counted heap calls, a panic
//! caught, values that are not finite or out of range refused at the port.
//!
//! ```
//! use taktil_rtcore::harness::Harness;
//! use taktil_rtcore::{Cycle, FaultCode, Input, Io, Mode, Nanos, Output, Payload, Task, payload};
//!
//! payload! {
//!     /// A length.
//!     pub struct Length {
//!         /// The length.
//!         pub length_m: f64,
//!     }
//! }
//!
//! struct Root(Input<Length>, Output<Length>);
//!
//! impl Task for Root {
//!     fn step(&mut self, _: &Cycle, io: &mut Io<'_>) -> Result<(), FaultCode> {
//!         let area = io.read(&self.0).value.length_m;
//!         io.write(&self.1, Length { length_m: area.sqrt() });
//!         Ok(())
//!     }
//! }
//!
//! let mut harness = Harness::new(&|_, _| None, |ports| {
//!     Ok(Box::new(Root(ports.input("area"), ports.output("root"))))
//! })?;
//! harness.start().unwrap();
//! let mut body = vec![0; harness.inputs()[0].size];
//! Length { length_m: -4.0 }.encode(&mut body);
//! harness.give(0, &body, Nanos::ZERO);
//! let (dt, mode) = (Nanos::from_millis(1), Mode::Moving);
//! let report = harness.step(&Cycle { tick: 0, release: Nanos::ZERO, dt, mode });
//! assert_eq!(report.refused, Some(FaultCode::NotFinite), "the root of -4");
//! # Ok::<(), taktil_rtcore::Invalid>(())
//! ```

use core::ops::RangeInclusive;
use std::borrow::Cow;
use std::panic::{AssertUnwindSafe, catch_unwind};

use taktil_hal::{Invalid, Nanos};

use crate::fault::FaultCode;
use crate::guard;
use crate::lane::TaskSlot;
use crate::linux::monotonic;
use crate::panic_hook;
use crate::payload::Field;
use crate::port::{AnyCell, Binding, InputDeclaration, Io, Ports, Unconnected};
use crate::task::{Cycle, Task};

/// An input of the task.
#[derive(Clone, Debug, PartialEq)]
pub struct InputPort {
    /// Name as the task declared it.
    pub name: &'static str,
    /// Type name of its payload.
    pub type_name: &'static str,
    /// Fields of the payload.
    pub fields: Cow<'static, [Field]>,
    /// Bytes of an encoded value.
    pub size: usize,
    /// Whether the producer may stand behind the task, so that values are a tick old.
    pub delayed: bool,
    /// A value older than this is stale; [`Nanos::MAX`] where none ever is.
    pub stale_after: Nanos,
}

/// An output of the task.
#[derive(Clone, Debug, PartialEq)]
pub struct OutputPort {
    /// Name as the task declared it.
    pub name: &'static str,
    /// Type name of its payload.
    pub type_name: Cow<'static, str>,
    /// Fields of the payload.
    pub fields: Cow<'static, [Field]>,
    /// Bytes of an encoded value.
    pub size: usize,
}

/// A parameter of the task.
#[derive(Clone, Debug, PartialEq)]
pub struct ParameterPort {
    /// Name as the task declared it.
    pub name: String,
    /// Value before the first edit.
    pub initial: f64,
    /// Smallest and largest value.
    pub range: RangeInclusive<f64>,
}

/// What one step did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepReport {
    /// The fault that the step returned; [`FaultCode::TaskPanicked`] when it panicked.
    pub fault: Option<FaultCode>,
    /// Why a value was refused at a port; the last one when several were.
    pub refused: Option<FaultCode>,
    /// Heap calls; meaningful when [`guard::installed`].
    pub heap_calls: u64,
    /// Step and fold on the clock, as lanes time them.
    pub took: Nanos,
    /// Hash of the state that the task folded; 0 after a panic.
    pub state: u64,
}

impl StepReport {
    /// Whether the step panicked.
    #[must_use]
    pub fn is_panic(&self) -> bool {
        self.fault == Some(FaultCode::TaskPanicked)
    }
}

/// The length of an array in an input's payload: of the input and the field of these names.
pub type ArrayLength<'a> = &'a dyn Fn(&str, &str) -> Option<usize>;

/// One task alone.
pub struct Harness {
    slot: TaskSlot,
    /// Cells of the outputs, then of the inputs.
    cells: Vec<Box<dyn AnyCell>>,
    bindings: Vec<Binding>,
    values: Box<[f64]>,
    declared: Vec<InputDeclaration>,
    inputs: Vec<InputPort>,
    outputs: Vec<OutputPort>,
    parameters: Vec<ParameterPort>,
    /// Room for one encoded output.
    scratch: Box<[u8]>,
}

impl core::fmt::Debug for Harness {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Harness").field("inputs", &self.inputs).finish_non_exhaustive()
    }
}

impl Harness {
    /// Builds a task and joins its ports to nothing. `length` gives the lengths of arrays in
    /// inputs whose payloads know them only at load.
    ///
    /// # Errors
    /// Whatever `make` refuses; a parameter outside its range; an array input whose length nobody
    /// gives, with the input as place.
    pub fn new(
        length: ArrayLength<'_>,
        make: impl FnOnce(&mut Ports) -> Result<Box<dyn Task>, Invalid>,
    ) -> Result<Harness, Invalid> {
        panic_hook::install();
        let mut ports = Ports::new(0, 0);
        let task = make(&mut ports)?;
        let mut cells = Vec::new();
        let mut outputs = Vec::new();
        for output in ports.outputs {
            let (name, size) = (output.name, output.size);
            let (type_name, fields) = (output.type_name, output.fields);
            outputs.push(OutputPort { name, type_name, fields, size });
            cells.push(output.cell);
        }
        let (mut inputs, mut bindings) = (Vec::new(), Vec::new());
        for input in &ports.inputs {
            let Unconnected { cell, fields, size } = unconnected(input, length)?;
            bindings.push(Binding { cell: cells.len(), seen: 0, stale_after: input.stale_after });
            inputs.push(InputPort {
                name: input.name,
                type_name: input.type_name,
                fields,
                size,
                delayed: input.delayed,
                stale_after: input.stale_after,
            });
            cells.push(cell);
        }
        let mut parameters = Vec::new();
        for declared in ports.parameters {
            declared.check()?;
            let range = declared.low..=declared.high;
            parameters.push(ParameterPort {
                name: declared.name,
                initial: declared.initial,
                range,
            });
        }
        let mut slot = TaskSlot::new("task", task);
        slot.parameters = 0..parameters.len();
        let largest = outputs.iter().map(|output| output.size).max().unwrap_or(0);
        let values = parameters.iter().map(|parameter| parameter.initial).collect();
        let (declared, scratch) = (ports.inputs, vec![0; largest].into());
        Ok(Harness {
            slot,
            cells,
            bindings,
            values,
            declared,
            inputs,
            outputs,
            parameters,
            scratch,
        })
    }

    /// The inputs in the order in which they were declared.
    #[must_use]
    pub fn inputs(&self) -> &[InputPort] {
        &self.inputs
    }

    /// The outputs in the order in which they were declared.
    #[must_use]
    pub fn outputs(&self) -> &[OutputPort] {
        &self.outputs
    }

    /// The parameters in the order in which they were declared.
    #[must_use]
    pub fn parameters(&self) -> &[ParameterPort] {
        &self.parameters
    }

    /// Starts the task, as an executor does before the first job.
    ///
    /// # Errors
    /// The fault by which it refused; [`FaultCode::TaskPanicked`] when it panicked.
    pub fn start(&mut self) -> Result<(), FaultCode> {
        let task = &mut self.slot.task;
        catch_unwind(AssertUnwindSafe(|| task.start())).unwrap_or(Err(FaultCode::TaskPanicked))
    }

    /// Puts a value into an input as one that was produced at `stamp`; false without such an input
    /// or with a body of another length. Values that are not finite are taken, too.
    pub fn give(&mut self, input: usize, body: &[u8], stamp: Nanos) -> bool {
        self.cell_of(input).is_some_and(|cell| cell.inject(body, stamp))
    }

    /// Puts another value into the place of an input's present one, whose stamp and freshness stay;
    /// false as in [`Harness::give`].
    pub fn replace(&mut self, input: usize, body: &[u8]) -> bool {
        self.cell_of(input).is_some_and(|cell| cell.replace(body))
    }

    fn cell_of(&mut self, input: usize) -> Option<&mut Box<dyn AnyCell>> {
        self.cells.get_mut(self.bindings.get(input)?.cell)
    }

    /// Gives a parameter a value; without such a parameter nothing.
    pub fn set_parameter(&mut self, parameter: usize, value: f64) {
        if let Some(place) = self.values.get_mut(parameter) {
            *place = value;
        }
    }

    /// Runs one step. After one that panicked the task is stopped and no step does anything.
    pub fn step(&mut self, cycle: &Cycle) -> StepReport {
        if self.slot.disabled {
            let fault = Some(FaultCode::TaskPanicked);
            return StepReport { fault, refused: None, heap_calls: 0, took: Nanos::ZERO, state: 0 };
        }
        let mut io = Io {
            cells: &mut self.cells,
            inputs: &mut self.bindings,
            parameters: &self.values,
            release: cycle.release,
            refused: None,
        };
        let slot = &mut self.slot;
        let ((fault, took), heap_calls) = guard::count_heap_calls(|| {
            let begin = monotonic();
            let fault = slot.step_contained(cycle, &mut io, true);
            (fault, monotonic() - begin)
        });
        let refused = io.refused;
        StepReport { fault, refused, heap_calls, took, state: slot.state }
    }

    /// Calls `look` with the number and the encoded value of each output that was written since
    /// this was called last.
    pub fn take_written(&mut self, mut look: impl FnMut(usize, &[u8])) {
        for (index, cell) in self.cells.iter_mut().take(self.outputs.len()).enumerate() {
            if let Some(length) = cell.publish(Nanos::ZERO, Some(&mut self.scratch)) {
                look(index, &self.scratch[..length]);
            }
        }
    }

    /// Calls `look` as [`Harness::take_written`] does with the values that ports refused. A
    /// refused value of an array payload is not kept.
    pub fn take_refused(&mut self, mut look: impl FnMut(usize, &[u8])) {
        for (index, output) in self.outputs.iter().enumerate() {
            let body = &mut self.scratch[..output.size];
            if self.cells[index].take_refused(body) {
                look(index, body);
            }
        }
    }

    /// Where a step panicked on this thread first since this was asked last, as `file:line`.
    #[must_use]
    pub fn take_panic_place(&self) -> Option<String> {
        panic_hook::take_first_site().map(|site| site.to_string())
    }

    /// Stops the task, as an executor does after the last job.
    ///
    /// # Errors
    /// [`FaultCode::TaskPanicked`] when it panicked.
    pub fn stop(&mut self) -> Result<(), FaultCode> {
        let task = &mut self.slot.task;
        catch_unwind(AssertUnwindSafe(|| task.stop())).map_err(|_| FaultCode::TaskPanicked)
    }

    /// Leaves the task as it is, and takes back what was given to it: all inputs are absent and
    /// parameters have their first values.
    ///
    /// # Errors
    /// As [`Harness::new`] for array inputs.
    pub fn clear_inputs(&mut self, length: ArrayLength<'_>) -> Result<(), Invalid> {
        for (input, binding) in self.declared.iter().zip(&mut self.bindings) {
            self.cells[binding.cell] = unconnected(input, length)?.cell;
            binding.seen = 0;
        }
        for (value, parameter) in self.values.iter_mut().zip(&self.parameters) {
            *value = parameter.initial;
        }
        Ok(())
    }
}

/// The cell of an input that no producer feeds.
fn unconnected(input: &InputDeclaration, length: ArrayLength<'_>) -> Result<Unconnected, Invalid> {
    (input.unconnected)(&|field| length(input.name, field)).ok_or_else(|| {
        let what = format!("`{}` has arrays whose lengths are not known", input.type_name);
        Invalid::new(input.name, what, "name the signal that it reads")
    })
}

#[cfg(test)]
mod tests;
