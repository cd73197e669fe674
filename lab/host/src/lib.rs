//! Real-time properties of a host: [`doctor`] compares the host with the expectations, [`jitter`]
//! measures how late it releases jobs.

pub mod doctor;
pub mod jitter;
