//! `[[fault]]`: the faults of the bench and their instants, and those of a plan, which befall
//! device halves, lanes and tasks whatever the bench does. A joint that does not exist and an
//! interval that ends before it begins are errors. Whether a target exists is found by whoever
//! carries a plan out.

use serde::Deserialize;
use taktil_hal::fault::{Fault as PlannedFault, FaultKind as Planned};

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
        /// What passes the `target` is lost, with the probability `value`.
        Loss,
        /// A frame arrives twice, with the probability `value`.
        Duplication,
        /// A message is overtaken by the next one, with the probability `value`.
        Reordering,
        /// What passes the `target` comes later, by `value` seconds.
        Delay,
        /// One bit is inverted, with the probability `value`.
        Corruption,
        /// A message ends early, with the probability `value`.
        Truncation,
        /// The `target` neither hears nor says anything.
        Silence,
        /// The cable is pulled; at the end of the fault it is plugged in again.
        Unplugged,
        /// The board restarts at the begin of the fault; counters begin at zero.
        Restart,
        /// Inputs keep their last value, outputs the word that they had.
        Frozen,
        /// A reading is displaced by `value` counts.
        Jump,
        /// The sign of a channel is turned.
        Inversion,
        /// The part `value` of a movement is not counted.
        LostCounts,
        /// A channel reads or puts out zero; a line is false.
        Dead,
        /// A channel reads or puts out its largest value; a line is true.
        Hot,
        /// Readings end at the part `value` of their range.
        Clipped,
        /// A call fails for this time, with the probability `value`.
        Failing,
        /// A reading is put together from an old and a new one, with the probability `value`.
        Torn,
        /// A line changes every `value` seconds.
        Bounce,
        /// The jobs of a lane begin `value` seconds after their release.
        Lateness,
        /// The jobs of a lane take `value` seconds longer.
        Overrun,
        /// No lane but the world's runs for `value` seconds.
        ClockGap,
        /// A task panics.
        Panic,
        /// A task writes numbers that are not finite.
        NotFinite,
        /// An operator makes `value` requests at each opportunity.
        Flood,
    }
}

impl FaultKind {
    /// The kind of a plan that this is; `None` for those that the bench itself carries out.
    #[must_use]
    pub const fn planned(self) -> Option<Planned> {
        Some(match self {
            FaultKind::DropFrames
            | FaultKind::DeadEncoder
            | FaultKind::PowerLoss
            | FaultKind::EmergencyStop
            | FaultKind::FrozenWrist => return None,
            FaultKind::Loss => Planned::Loss,
            FaultKind::Duplication => Planned::Duplication,
            FaultKind::Reordering => Planned::Reordering,
            FaultKind::Delay => Planned::Delay,
            FaultKind::Corruption => Planned::Corruption,
            FaultKind::Truncation => Planned::Truncation,
            FaultKind::Silence => Planned::Silence,
            FaultKind::Unplugged => Planned::Unplugged,
            FaultKind::Restart => Planned::Restart,
            FaultKind::Frozen => Planned::Frozen,
            FaultKind::Jump => Planned::Jump,
            FaultKind::Inversion => Planned::Inversion,
            FaultKind::LostCounts => Planned::LostCounts,
            FaultKind::Dead => Planned::Dead,
            FaultKind::Hot => Planned::Hot,
            FaultKind::Clipped => Planned::Clipped,
            FaultKind::Failing => Planned::Failing,
            FaultKind::Torn => Planned::Torn,
            FaultKind::Bounce => Planned::Bounce,
            FaultKind::Lateness => Planned::Lateness,
            FaultKind::Overrun => Planned::Overrun,
            FaultKind::ClockGap => Planned::ClockGap,
            FaultKind::Panic => Planned::Panic,
            FaultKind::NotFinite => Planned::NotFinite,
            FaultKind::Flood => Planned::Flood,
        })
    }
}

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
