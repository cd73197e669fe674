//! `[[fault]]`: the faults of the bench and their instants, and those of a plan, which befall
//! device halves, lanes and tasks whatever the bench does. A joint that does not exist and an
//! interval that ends before it begins are errors. Whether a target exists is found by whoever
//! carries a plan out.

use serde::Deserialize;
use taktil_hal::fault::{Fault as PlannedFault, FaultKind as Planned};

use super::section::{Consistency, inside, names, section};
use super::{Invalid, invalid};

/// Declares the kinds of the bench, and behind them those of a plan.
macro_rules! declare_kinds {
    (
        { $($(#[doc = $own_about:literal])* $Own:ident,)* }
        $($(#[doc = $about:literal])* $Planned:ident = $word:literal,)*
    ) => {
        taktil_hal::explained! {
            /// The kind of a fault.
            #[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
            #[serde(rename_all = "snake_case")]
            pub enum FaultKind {
                $($(#[doc = $own_about])* $Own,)*
                $($(#[doc = $about])* $Planned,)*
            }
        }

        impl FaultKind {
            /// The kind of a plan that this is; `None` for those that the bench itself carries out.
            #[must_use]
            pub const fn planned(self) -> Option<Planned> {
                Some(match self {
                    $(FaultKind::$Own)|* => return None,
                    $(FaultKind::$Planned => Planned::$Planned,)*
                })
            }
        }
    };
}

taktil_hal::planned_fault_kinds!(declare_kinds {
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
});

names!(FaultKind);

section! {
    /// `[[fault]]`: one fault of the bench.
    pub struct Fault {
        /// What goes wrong: of the bench itself (`drop_frames`, `dead_encoder`, `power_loss`,
        /// `emergency_stop`, `frozen_wrist`), or a kind of a plan, with a `target`.
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
        /// Kinds of a plan: a device half (`encoders`, `analog_out`, `digital_in` ...) or one
        /// channel of it (`encoders.3`), `lane.NAME`, `task.NAME` or `clock`.
        target: Option<String>,
        /// Kinds of a plan: how strong it is, as the kind says.
        value: Option<f64>,
    }
}

impl Fault {
    /// A fault of this kind from `at_s` (s) for good.
    #[must_use]
    pub fn at(kind: FaultKind, at_s: f64) -> Fault {
        Fault {
            kind,
            at_s,
            for_s: None,
            joint: None,
            fraction: None,
            opposed: None,
            target: None,
            value: None,
        }
    }

    /// The fault of a plan that this is, if it is one.
    ///
    /// # Errors
    /// A target or value that the kind cannot have; the place is the key.
    pub fn planned(&self) -> Result<Option<PlannedFault>, Invalid> {
        let Some(kind) = self.kind.planned() else { return Ok(None) };
        let target = self.target.as_deref().unwrap_or_default();
        PlannedFault::new(kind, target, self.at_s, self.for_s, self.value).map(Some)
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
        if self.kind.planned().is_none() {
            let foreign = [("target", self.target.is_some()), ("value", self.value.is_some())];
            if let Some((key, _)) = foreign.into_iter().find(|(_, given)| *given) {
                let what = "does not belong to this kind of fault".to_owned();
                return Err(invalid(&inside(place, key), what, "leave it out"));
            }
        } else if self.target.is_none() {
            let what = "has no target".to_owned();
            return Err(invalid(place, what, "say which, for example target = \"encoders.3\""));
        }
        self.planned().map_err(|bad| bad.within(place))?;
        if self.kind == FaultKind::DeadEncoder && self.joint.is_none() {
            return Err(invalid(place, "has no joint".to_owned(), "say which: joint = 1 to 6"));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Deserialize)]
    struct Words {
        kinds: Vec<FaultKind>,
    }

    #[test]
    fn a_scene_names_each_kind_of_a_plan_by_the_word_of_the_plan() {
        let words: Vec<String> =
            Planned::ALL.iter().map(|kind| format!("\"{}\"", kind.name())).collect();
        let read: Words = toml::from_str(&format!("kinds = [{}]", words.join(", "))).unwrap();
        let planned: Vec<Planned> = read.kinds.iter().filter_map(|kind| kind.planned()).collect();
        assert_eq!(planned, Planned::ALL);
        let own: Words = toml::from_str("kinds = ['dead_encoder', 'frozen_wrist']").unwrap();
        assert!(own.kinds.iter().all(|kind| kind.planned().is_none()));
    }
}
