//! A deterministic simulation of the bench: a PUMA 260 with its motors, a fingertip with a
//! tactile array of any size, a pin between the rubbers of fingertip and table, objects on the
//! table, and a table that pans, tilts, slides and rises. Only [`World::advance`] moves it,
//! independently of any scheduling. A controller sees it only through the [`taktil_hal::Devices`]
//! halves, and one seed always gives the same run.
//!
//! ```
//! use taktil_hal::Nanos;
//! use taktil_sim::{Timing, WorldConfig, build};
//!
//! let (mut world, mut devices) = build(&WorldConfig::default(), &Timing::default(), 1).unwrap();
//! world.advance(Nanos::from_millis(10));
//! let counts = devices.encoders.as_mut().unwrap().sample(world.now()).unwrap();
//! assert_eq!(counts.acquired, Nanos::from_millis(10));
//! assert!(!world.truth().in_contact);
//! ```
//!
//! A scene pays for what it names ([`fidelity`]): an arm with or without friction, rows of tactels
//! that do or do not influence each other, an explicit or an implicit integrator. The simulation
//! leaves out finite strain, free edges of the pad, viscoelastic memory of the rubber, contact of
//! the finger with the table itself, edges of the table, inertial loads on the gauges, and objects
//! that move, save the one that a hand holds ([`build_with_hand`]).

mod any_plant;
mod arm;
mod assembly;
mod carriage;
mod chain_arm;
mod contact;
mod devices;
mod drives;
mod electronics;
mod end_stop;
mod faults;
mod fixture;
mod friction;
mod geometry;
mod hand;
mod hash;
mod index_pulses;
mod last_sent;
mod manipulator;
mod motion;
mod motors;
mod object;
mod opposed;
mod pin;
mod prng;
mod rolling;
mod rubber;
mod scan_link;
pub mod scene;
mod snapshot;
mod spatial;
mod square_cells;
mod step;
mod surroundings;
mod table;
mod truth;
mod world;

pub use assembly::{
    RATED_LOAD_N, SimulatedChain, build, build_with_carriage, build_with_chain, build_with_hand,
};
pub use carriage::{Carriage, FloatingGuide};
pub use contact::Surface;
pub use devices::{ADC_MAX, LONGEST_SILENCE};
pub use electronics::tactel_gains;
pub use geometry::ArrayGeometry;
pub use hand::grasp::{FingerContact, HandTruth};
pub use index_pulses::IndexPulsePlaces;
pub use scene::fidelity;
pub use scene::{GAUGE_CODES_PER_N, GAUGE_CODES_PER_NM, Invalid, Timing, WorldConfig};
pub use snapshot::{OutputRecord, Snapshot, WorldHistory};
pub use step::StepStatistics;
pub use table::TablePose;
pub use truth::{ObjectContact, OpposedFingertip, Truth};
pub use world::World;
