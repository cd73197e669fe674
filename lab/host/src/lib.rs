//! What a host grants to real time: [`doctor`] compares it with what is expected, [`jitter`]
//! measures how late it releases jobs.

pub mod doctor;
pub mod jitter;
