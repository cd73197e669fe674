//! Storms: the production code on the simulated robot in virtual time, with an operator and faults
//! that a seed draws, and checkers beside it that know only the records. Two campaigns: faults
//! after which the machine has to come back, and anything, in which it has to be safe.
//!
//! ```
//! use taktil_lab_storm::case::{Campaign, Case, Scenes};
//! use taktil_lab_storm::run::run;
//!
//! let scenes = Scenes::built_in().unwrap();
//! let length = Some(taktil_hal::Nanos::from_millis(500));
//! let case = Case::draw(&scenes, 1, Campaign::Recoverable, None, length);
//! let outcome = run(&case).unwrap();
//! assert_eq!(outcome.digest.len(), 16);
//! ```

pub mod campaign;
pub mod case;
pub mod check;
pub mod command;
pub mod coverage;
pub mod evidence;
pub mod export;
pub mod log;
mod operator;
pub mod run;
pub mod shrink;
