//! Ports of array payloads: a value stays in its cell and is read there by reference; between lanes
//! it travels in buffers that are made at load and go round.

use core::any::{Any, TypeId};
use core::marker::PhantomData;

use taktil_hal::Nanos;

use super::{AnyCell, CellCopy, Input, InputDeclaration, Io, Output, OutputDeclaration, Ports};
use super::{Sample, Unconnected, freshness};
use crate::array_payload::ArrayPayload;
use crate::buffer_link::{BufferReceiver, BufferSender, buffer_link};
use crate::fault::FaultCode;

/// The newest value of one signal as one lane sees it.
struct ArrayCell<T> {
    /// Absent only while a task works on it in [`Io::with_array`].
    value: Option<Box<T>>,
    stamp: Nanos,
    version: u64,
    written: bool,
    to: Vec<BufferSender<T>>,
    from: Option<BufferReceiver<T>>,
}

impl<T: ArrayPayload> ArrayCell<T> {
    fn new(value: T, from: Option<BufferReceiver<T>>) -> ArrayCell<T> {
        let value = Some(Box::new(value));
        ArrayCell { value, stamp: Nanos::ZERO, version: 0, written: false, to: Vec::new(), from }
    }

    fn mark_written(&mut self, release: Nanos) {
        self.stamp = release;
        self.version += 1;
        self.written = true;
    }
}

impl<T: ArrayPayload> AnyCell for ArrayCell<T> {
    fn receive(&mut self, release: Nanos) -> Option<Nanos> {
        let (from, value) = (self.from.as_mut()?, self.value.as_mut()?);
        let mut newest = None;
        while let Some(arrived) = from.next(release, value) {
            newest = Some(arrived.stamp);
        }
        self.stamp = newest?;
        self.version += 1;
        newest
    }

    fn inject(&mut self, body: &[u8], release: Nanos) -> bool {
        let taken = self.value.as_mut().is_some_and(|value| value.decode_into(body));
        if taken {
            self.mark_written(release);
        }
        taken
    }

    fn spoil(&mut self, _before: &mut CellCopy, _release: Nanos) -> Result<(), FaultCode> {
        // Images are integers and flags: none of their numbers is not finite.
        self.written = false;
        Ok(())
    }

    fn copy_to(&self, _copy: &mut CellCopy) {}

    fn publish(&mut self, visible: Nanos, scratch: Option<&mut [u8]>) -> Option<usize> {
        if !self.written {
            return None;
        }
        self.written = false;
        let value = self.value.as_deref()?;
        for ring in &mut self.to {
            ring.send(value, self.stamp, visible);
        }
        let size = value.size();
        value.encode(&mut scratch?[..size]);
        Some(size)
    }

    fn is_linked(&self) -> bool {
        !self.to.is_empty()
    }

    fn dropped(&self) -> u64 {
        self.to.iter().map(|ring| ring.dropped()).sum()
    }

    fn replace(&mut self, body: &[u8]) -> bool {
        self.value.as_mut().is_some_and(|value| value.decode_into(body))
    }
}

fn connect<T: ArrayPayload>(
    producer: &mut dyn AnyCell,
    capacity: usize,
) -> Option<Box<dyn AnyCell>> {
    let producer: &mut dyn Any = producer;
    let cell = producer.downcast_mut::<ArrayCell<T>>()?;
    let value = cell.value.as_deref()?;
    let (sender, receiver) = buffer_link(value, capacity);
    let zero = value.zeroed();
    cell.to.push(sender);
    Some(Box::new(ArrayCell::new(zero, Some(receiver))))
}

fn unconnected<T: ArrayPayload>(length: &dyn Fn(&str) -> Option<usize>) -> Option<Unconnected> {
    let value = T::with_lengths(length)?;
    let (fields, size) = (value.fields().into(), value.size());
    Some(Unconnected { fields, size, cell: Box::new(ArrayCell::new(value, None)) })
}

impl Ports {
    /// Declares an input of an array payload, whose lengths are those of the signal that it is
    /// bound to. Never called stale.
    pub fn array_input<T: ArrayPayload>(&mut self, name: &'static str) -> Input<T> {
        let index = self.first_input + self.inputs.len();
        self.inputs.push(InputDeclaration {
            name,
            type_id: TypeId::of::<T>(),
            type_name: T::NAME,
            delayed: false,
            stale_after: Nanos::MAX,
            connect: connect::<T>,
            unconnected: unconnected::<T>,
        });
        Input { index, of: PhantomData }
    }

    /// Declares an output of an array payload with the lengths of `like`; its signal is called
    /// `task.name`.
    pub fn array_output<T: ArrayPayload>(&mut self, name: &'static str, like: &T) -> Output<T> {
        let cell = self.first_cell + self.outputs.len();
        self.outputs.push(OutputDeclaration {
            name,
            type_id: TypeId::of::<T>(),
            type_name: like.type_name(),
            fields: like.fields().into(),
            size: like.size(),
            cell: Box::new(ArrayCell::new(like.zeroed(), None)),
        });
        Output { cell, of: PhantomData }
    }
}

impl Io<'_> {
    /// The newest visible value of an array input, where it lies; `None` before the first one.
    pub fn view<T: ArrayPayload>(&mut self, input: &Input<T>) -> Option<Sample<&T>> {
        let binding = self.inputs.get_mut(input.index)?;
        let cell: &dyn Any = self.cells.get(binding.cell)?.as_ref();
        let cell = cell.downcast_ref::<ArrayCell<T>>()?;
        let value = cell.value.as_deref().filter(|_| cell.version > 0)?;
        let age = self.release - cell.stamp;
        let freshness = freshness(binding, cell.version, age);
        Some(Sample { value, stamp: cell.stamp, age, freshness })
    }

    /// Calls `work` with a value of an array input that was not read before, and with the ports;
    /// `None` when there is no such value. Within `work` the same input reads as absent.
    pub fn with_fresh_array<T: ArrayPayload, R>(
        &mut self,
        input: &Input<T>,
        work: impl FnOnce(&T, &mut Self) -> R,
    ) -> Option<R> {
        self.view(input)?.fresh()?;
        let at = self.inputs.get(input.index)?.cell;
        let value = self.array_cell::<T>(at)?.value.take()?;
        let answer = work(&value, self);
        if let Some(cell) = self.array_cell::<T>(at) {
            cell.value = Some(value);
        }
        Some(answer)
    }

    fn array_cell<T: ArrayPayload>(&mut self, at: usize) -> Option<&mut ArrayCell<T>> {
        let cell: &mut dyn Any = self.cells.get_mut(at)?.as_mut();
        cell.downcast_mut::<ArrayCell<T>>()
    }

    /// Writes an array output by copying `value`; the last write of a job counts. A value that is
    /// not finite, or whose arrays have other lengths than those declared, is refused and raises a
    /// fault; the last good value stays.
    pub fn write_array<T: ArrayPayload>(&mut self, output: &Output<T>, value: &T) {
        if !value.is_finite() {
            self.refused = Some(FaultCode::NotFinite);
            return;
        }
        let release = self.release;
        let Some(cell) = self.array_cell::<T>(output.cell) else { return };
        let Some(own) = cell.value.as_deref_mut() else { return };
        if !own.has_lengths_of(value) {
            self.refused = Some(FaultCode::OutOfRange);
            return;
        }
        own.copy_from(value);
        cell.mark_written(release);
    }
}
