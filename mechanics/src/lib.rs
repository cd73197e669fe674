//! Pure mathematics of the machine: frames, the PUMA 260, its dynamics and drives, trajectories,
//! tactile features and contact models. Refuses devices, time sources, files, text, allocation on
//! the lane path and the platform's elementary functions (all of them come from `libm`).
//!
//! Units are m, rad, s, kg, N, N m; exceptions are [`tactile`] (tactel numbers, counts) and
//! [`contact`] (mm, N, MPa). Functions of finite numbers return finite numbers; what a NaN does is
//! stated where it matters, and where nothing is stated it comes out as NaN and nothing panics.

pub mod arm;
pub mod chain;
pub mod contact;
pub mod dls;
pub mod dynamics;
pub mod lead;
pub mod limits;
pub mod paul;
pub mod preview;
pub mod puma260;
pub mod robot;
pub mod spatial;
pub mod tactile;
pub mod transmission;

pub use spatial::{Joints, Matrix6, Pose};
