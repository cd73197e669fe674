//! Pure mathematics of the machine: frames, the PUMA 260, its dynamics and drives, trajectories and
//! tactile features. Refuses devices, time sources, files, text, allocation on
//! the lane path and the platform's elementary functions (all of them come from `libm`).
//!
//! Units are m, rad, s, kg, N, N m; the exception is [`tactile`] (tactel numbers, counts).
//! Functions of finite numbers return finite numbers; what a NaN does is stated where it matters,
//! and where nothing is stated it comes out as NaN and nothing panics.

pub mod arm;
pub mod chain;
mod cholesky;
pub mod dls;
pub mod feasibility;
pub mod friction;
pub mod limits;
pub mod paul;
pub mod puma260;
pub mod rigid_body;
pub mod robot;
pub mod spatial;
pub mod tactile;
pub mod tracking;
pub mod transmission;

pub use spatial::{Joints, Matrix6, Pose};
