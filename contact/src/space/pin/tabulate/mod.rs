//! Solves the contacts of a pin's tables, when the pin is made.

pub(super) mod end;
pub(super) mod end_correction;
pub(super) mod full_length;
