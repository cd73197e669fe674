//! What a fault by plan needs of a port: the value before a write, and a value with a number in it
//! that is not finite.

use taktil_hal::Nanos;

use crate::payload::{Payload, Primitive};

/// The value of a cell as it was, with room to encode it.
#[derive(Clone, Debug)]
pub(crate) struct CellCopy {
    pub(super) body: Box<[u8]>,
    pub(super) stamp: Nanos,
    pub(super) version: u64,
}

impl CellCopy {
    /// Room for a body of so many bytes.
    pub(crate) fn new(size: usize) -> CellCopy {
        CellCopy { body: vec![0; size].into(), stamp: Nanos::ZERO, version: 0 }
    }
}

/// The value with its first floating-point number not finite, made in `scratch`; none when it has
/// no such number, or does not fit.
pub(super) fn spoilt<T: Payload>(value: T, scratch: &mut [u8]) -> Option<T> {
    let body = scratch.get_mut(..T::SIZE)?;
    let mut offset = 0_usize;
    for field in T::FIELDS {
        if field.kind == Primitive::F64 {
            let begin = offset.next_multiple_of(field.kind.size());
            value.encode(body);
            body[begin..begin + 8].copy_from_slice(&f64::NAN.to_le_bytes());
            return T::decode(body);
        }
        offset = field.end_after(offset);
    }
    None
}
