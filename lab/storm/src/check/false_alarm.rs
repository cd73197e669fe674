//! The rule that nothing is wrong before the first fault of a plan. What an operator brings about
//! by what it asks for is no false alarm; nor is a fault of the arm's motion while the finger is
//! pressed far harder than any law presses it, because then the arm is held or thrown back by what
//! it hit.

use taktil_lab_scene::world::WorldTruth;
use taktil_rtcore::{FaultCode, FaultSet, Nanos};

use super::{Findings, Weather};
use crate::evidence::Tick;

/// Force from which on the finger has hit something (N): nearly three times what the rolling law
/// presses with.
const COLLISION_FORCE_N: f64 = 40.0;
/// For how long after such a force the arm may be thrown back.
const COLLISION_AFTERMATH: Nanos = Nanos::from_millis(100);

/// Faults that an operator may bring about by what it asks for: a goal that cannot be reached, a
/// singularity, a move that is refused, a finger that is pressed too hard, touch that it asks for
/// without a baseline.
const OPERATOR_FAULTS: [FaultCode; 8] = [
    FaultCode::TactileLost,
    FaultCode::TactileStale,
    FaultCode::SoftLimit,
    FaultCode::Unreachable,
    FaultCode::Singular,
    FaultCode::MoveRefused,
    FaultCode::Overload,
    FaultCode::ForceUnknown,
];

/// What pushing the arm into something brings about.
const COLLISION_FAULTS: [FaultCode; 3] =
    [FaultCode::FollowingError, FaultCode::Runaway, FaultCode::StuckEncoder];

fn set_of(faults: &[FaultCode]) -> u64 {
    let mut set = FaultSet::NONE;
    faults.iter().for_each(|fault| set.insert(*fault));
    set.0
}

/// What the rule remembers.
#[derive(Debug, Default)]
pub(super) struct FalseAlarm {
    /// When the finger was last pressed so hard.
    collided: Option<Nanos>,
    /// Faults that came with a collision, as long as they are latched.
    excused: u64,
}

impl FalseAlarm {
    pub(super) fn tick(
        &mut self,
        tick: &Tick,
        truth: Option<&WorldTruth>,
        weather: &Weather,
        findings: &mut Findings,
    ) {
        let now = tick.release;
        if truth.is_some_and(|truth| truth.finger_normal_n > COLLISION_FORCE_N) {
            self.collided = Some(now);
        }
        let faults = tick.control.map_or(0, |control| control.faults);
        self.excused &= faults;
        if self.collided.is_some_and(|at| now - at <= COLLISION_AFTERMATH) {
            self.excused |= faults & set_of(&COLLISION_FAULTS);
        }
        let unexplained = faults & !set_of(&OPERATOR_FAULTS) & !self.excused;
        if now < weather.first_begin() && unexplained != 0 {
            findings.report("no fault without a fault", now, || format!("{unexplained:#x}"));
        }
    }
}
