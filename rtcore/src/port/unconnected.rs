//! Cells of inputs that no producer feeds: what a test of one task puts its values into.

use std::borrow::Cow;

use super::{AnyCell, Cell};
use crate::payload::{Field, Payload};

/// An input's cell without a producer, and what its values consist of.
pub(crate) struct Unconnected {
    pub(crate) cell: Box<dyn AnyCell>,
    pub(crate) fields: Cow<'static, [Field]>,
    /// Bytes of an encoded value.
    pub(crate) size: usize,
}

/// Makes such a cell. Its argument gives the length of an array by the name of the field; `None`
/// when it gives none for an array whose length is known only at load.
pub(crate) type UnconnectedCell = fn(&dyn Fn(&str) -> Option<usize>) -> Option<Unconnected>;

/// A cell of a payload of fixed size.
pub(super) fn unconnected<T: Payload>(_: &dyn Fn(&str) -> Option<usize>) -> Option<Unconnected> {
    let cell = Box::new(Cell::<T>::new(None));
    Some(Unconnected { cell, fields: T::FIELDS.into(), size: T::SIZE })
}
