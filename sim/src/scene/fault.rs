//! `[[fault]]`: the faults of the bench and their instants. A joint that does not exist and an
//! interval that ends before it begins are errors.

use serde::Deserialize;

use super::section::{Consistency, inside, names, section};
use super::{Invalid, invalid};

taktil_hal::explained! {
    /// The kind of a fault.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
    #[serde(rename_all = "snake_case")]
    pub enum FaultKind {
        /// Tactile frames are lost: all of them, or a `fraction`.
        DropFrames,
        /// The encoder of a `joint` stops counting; the count stays.
        DeadEncoder,
        /// The drives' supply fails: no current, brakes on, and the line says so.
        PowerLoss,
        /// The emergency stop is pressed: both its lines open.
        EmergencyStop,
        /// The wrist's gauges keep their reading.
        FrozenWrist,
    }
}

names!(FaultKind);

section! {
    /// `[[fault]]`: one fault of the bench.
    #[derive(Copy)]
    pub struct Fault {
        /// `drop_frames`, `dead_encoder`, `power_loss`, `emergency_stop` or `frozen_wrist`.
        kind: FaultKind,
        /// Begin of the fault (s).
        at_s: f64 [0.0, 1e6],
        /// Duration of the fault (s). Default: until the end of the run.
        for_s: Option<f64> [1e-4, 1e6],
        /// Dead encoder: which joint, 1 to 6.
        joint: Option<u32> [1.0, 6.0],
        /// Lost frames: the part of them that is lost, drawn from the seed. Default 1.
        fraction: Option<f64> [0.0, 1.0],
        /// Lost frames: those of the opposed fingertip's array instead of the finger's. Default
        /// false.
        opposed: Option<bool>,
    }
}

/// Largest number of faults in a scene.
pub const FAULTS_MAX: usize = 32;

impl Consistency for Fault {
    fn check_consistency(&self, place: &str) -> Result<(), Invalid> {
        let foreign = [
            ("joint", self.joint.is_some(), FaultKind::DeadEncoder),
            ("fraction", self.fraction.is_some(), FaultKind::DropFrames),
            ("opposed", self.opposed.is_some(), FaultKind::DropFrames),
        ];
        for (key, given, kind) in foreign {
            if given && self.kind != kind {
                let what = "does not belong to this kind of fault".to_owned();
                return Err(invalid(&inside(place, key), what, "leave it out"));
            }
        }
        if self.kind == FaultKind::DeadEncoder && self.joint.is_none() {
            return Err(invalid(place, "has no joint".to_owned(), "say which: joint = 1 to 6"));
        }
        Ok(())
    }
}
