//! Pure mathematics of the robot: frames, kinematics and dynamics of the PUMA 260 and of any serial
//! chain, transmission and amplifiers, Paul's paths, and features of tactile images.
//!
//! Units are m, rad, s, kg, N and N m, except in [`tactile`] (tactel numbers and counts). The crate
//! has no devices, clocks, files or text, and nothing that a lane calls allocates. Elementary
//! functions come from `libm` only, so that every machine computes the same bits. Functions of
//! finite numbers return finite numbers. What a NaN does is stated where it matters; elsewhere it
//! comes out as NaN, and nothing panics.
//!
//! # Forward kinematics
//!
//! At zero the upper arm of the PUMA 260 lies along x and its forearm stands along z, so that the
//! tool point is at `(a2, -d3, d4 + tool)` of the base frame.
//!
//! ```
//! use glam::DVec3;
//! use taktil_mechanics::{Joints, puma260::Puma260};
//!
//! let arm = Puma260::reference();
//! let tool = arm.tool_pose(&Joints::zeros());
//! let expected = DVec3::new(arm.a2_m, -arm.d3_m, arm.d4_m + arm.tool_z_m);
//! assert!((tool.translation - expected).length() < 1e-15);
//! ```
//!
//! # Inverse kinematics
//!
//! Up to eight branches reach a pose; [`nearest_branch`](puma260::Puma260::nearest_branch) chooses
//! the one nearest to given joints inside the limits.
//!
//! ```
//! use taktil_mechanics::{Joints, puma260::Puma260};
//!
//! let arm = Puma260::reference();
//! let q = Joints::new(0.3, 0.6, -2.4, 0.2, 0.9, -0.5);
//! let branches = arm.inverse_kinematics(&arm.wrist_pose(&q), None);
//! assert_eq!(branches.len(), 8);
//! let (_, nearest) = arm.nearest_branch(&branches, &q).unwrap();
//! assert!((nearest - q).amax() < 1e-12);
//! ```
//!
//! # Inverse dynamics
//!
//! The recursive Newton-Euler algorithm gives the torques of a motion. Without motion they are the
//! torques that hold the arm against gravity.
//!
//! ```
//! use taktil_mechanics::{Joints, puma260::dynamics::Dynamics};
//!
//! let dynamics = Dynamics::reference();
//! let (q, rest) = (Joints::new(0.0, 0.7, -2.6, 0.0, 1.2, 0.0), Joints::zeros());
//! let torque_nm = dynamics.inverse_dynamics(&q, &rest, &rest);
//! assert!((torque_nm - dynamics.gravity_torque(&q)).amax() < 1e-12);
//! ```

pub mod arm;
pub mod chain;
mod cholesky;
pub mod dls;
pub mod feasibility;
pub mod friction;
pub mod hand;
pub mod limits;
pub mod paul;
pub mod puma260;
pub mod rigid_body;
pub mod robot;
pub mod slip;
pub mod spatial;
pub mod tactile;
pub mod tracking;
pub mod transmission;

pub use spatial::{Joints, Matrix6, Pose};
