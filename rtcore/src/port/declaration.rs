//! What a task's constructor declares of its ports, before they are bound.

use core::any::TypeId;
use std::borrow::Cow;

use taktil_hal::Nanos;

use super::AnyCell;
use super::unconnected::UnconnectedCell;

/// An input as declared by a task, before it is bound.
pub(crate) struct InputDeclaration {
    pub(crate) name: &'static str,
    pub(crate) type_id: TypeId,
    pub(crate) type_name: &'static str,
    pub(crate) delayed: bool,
    pub(crate) stale_after: Nanos,
    /// Adds a link from the producer's cell; returns the consumer's.
    pub(crate) connect: fn(&mut dyn AnyCell, usize) -> Option<Box<dyn AnyCell>>,
    /// Makes a cell that no producer feeds.
    pub(crate) unconnected: UnconnectedCell,
}

/// An output as declared by a task.
pub(crate) struct OutputDeclaration {
    pub(crate) name: &'static str,
    pub(crate) type_id: TypeId,
    pub(crate) type_name: Cow<'static, str>,
    pub(crate) fields: Cow<'static, [crate::payload::Field]>,
    pub(crate) size: usize,
    pub(crate) cell: Box<dyn AnyCell>,
}
