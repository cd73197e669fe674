//! The rule that nothing is wrong before the first fault of a plan. What an operator brings about
//! by what it asks for is no false alarm; nor is a fault of the arm's motion after the arm was run
//! into something: pressed far harder than any law presses, within a few jobs, or at all while not
//! a law but an operator leads it. Then it is held or thrown back by what it hit, which may also be
//! plain from its speed alone.

use taktil_lab_world::WorldTruth;
use taktil_rtcore::{FaultCode, FaultSet, Nanos};
use taktil_signal::State;

use super::{Findings, SpeedChange, Weather, below_crown_m, state_of};
use crate::evidence::Tick;

/// Force from which on the finger, or the pin under it, has hit something (N): nearly three times
/// what the rolling law presses with.
const COLLISION_FORCE_N: f64 = 40.0;
/// A force that grows so far, within such a time after nothing was touched (N), is a hit, too: laws
/// approach at some millimetres a second, and reach it after twenty times as long.
const HIT_FORCE_N: f64 = 10.0;
const HIT_TIME: Nanos = Nanos::from_millis(10);
/// Force at which an arm that is not led by touch is held by what it was pushed against (N).
const HELD_FORCE_N: f64 = 0.5;
/// How far below the pin's crown the finger's face is inside the pin (m): further than its rubber
/// is thick. It was led there from the side, and is thrown out as soon as its face meets the pin.
const INSIDE_DEPTH_M: f64 = 5e-3;
/// Change of the true speed of one of the first five joints within a job that no motor brings about
/// (rad/s): the arm was hit, by a pin in flight for example, and may be free again.
const BLOW_RAD_S: f64 = 0.3;
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

/// What pushing the arm into something brings about. An arm that is stopped while it presses may
/// slip off and be thrown: then its speed does not fall.
const COLLISION_FAULTS: [FaultCode; 5] = [
    FaultCode::FollowingError,
    FaultCode::Runaway,
    FaultCode::StuckEncoder,
    FaultCode::EncoderJump,
    FaultCode::StopFailed,
];

fn set_of(faults: &[FaultCode]) -> u64 {
    let mut set = FaultSet::NONE;
    faults.iter().for_each(|fault| set.insert(*fault));
    set.0
}

/// What the rule remembers.
#[derive(Debug, Default)]
pub(super) struct FalseAlarm {
    /// When the finger last hit something, or was pressed so hard.
    collided: Option<Nanos>,
    /// When the finger last touched nothing.
    free: Option<Nanos>,
    speed_change: SpeedChange,
    /// Faults that came with a collision, as long as they are latched.
    excused: u64,
}

impl FalseAlarm {
    /// Whether the finger hits something, or is pressed too hard for who leads it.
    fn is_collision(&mut self, truth: &WorldTruth, by_touch: bool, now: Nanos) -> bool {
        if truth.finger_normal_n <= 0.0 {
            self.free = Some(now);
        }
        let is_hit = self.free.is_some_and(|free| now - free <= HIT_TIME);
        let change_rad_s = self.speed_change.update(truth);
        let is_blow = change_rad_s[..5].iter().any(|change| *change > BLOW_RAD_S);
        truth.finger_normal_n.max(truth.table_normal_n) > COLLISION_FORCE_N
            || is_blow
            || below_crown_m(truth).is_some_and(|depth_m| depth_m > INSIDE_DEPTH_M)
            || is_hit && truth.finger_normal_n > HIT_FORCE_N
            || !by_touch && truth.finger_normal_n > HELD_FORCE_N
    }

    pub(super) fn tick(
        &mut self,
        tick: &Tick,
        truth: Option<&WorldTruth>,
        weather: &Weather,
        findings: &mut Findings,
    ) {
        let now = tick.release;
        let by_touch = state_of(tick) == Some(State::TactileServo);
        if truth.is_some_and(|truth| self.is_collision(truth, by_touch, now)) {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::case::Campaign;
    use taktil_hal::fault::FaultPlan;
    use taktil_mechanics::robot::Robot;
    use taktil_rtcore::{Mode, Payload};
    use taktil_signal::ControlState;

    /// Whether the rule is broken by a stop that fails 50 ms after the finger was pressed with a
    /// force (N), or a joint got a speed (rad/s) from one job to the next, while nobody leads the
    /// arm by touch, without any fault in the plan.
    fn is_found(force_n: f64, speed_rad_s: f64) -> bool {
        let weather = Weather::new(&FaultPlan::default(), Campaign::Anything, Nanos::MAX);
        let (mut rule, mut findings) = (FalseAlarm::default(), Findings::default());
        for job in 0..40 {
            let mut tick = Tick { tick: job, ..Tick::default() };
            tick.release = Nanos::from_micros(2500) * job as i64;
            let faults = if job < 20 { 0 } else { set_of(&[FaultCode::StopFailed]) };
            let mode = Mode::Stopping.code();
            tick.control = Some(ControlState { mode, faults, ..ControlState::default() });
            let finger_normal_n = if job == 0 { force_n } else { 0.0 };
            let mut truth = WorldTruth::<6> { finger_normal_n, ..WorldTruth::ZERO };
            truth.qd_rad_s[2] = if job == 0 { 0.0 } else { speed_rad_s };
            rule.tick(&tick, Some(&truth), &weather, &mut findings);
        }
        !findings.violations.is_empty()
    }

    #[test]
    fn no_motor_brings_a_blow_about() {
        let robot = Robot::puma260();
        // Torque limits of the scenes of storms (N m), against what a joint takes while all others
        // are free.
        let limit_nm = [8.0, 12.0, 7.0, 2.0, 1.5];
        for elbow in 0..12 {
            let mut pose = robot.nominal_rad;
            pose[2] += f64::from(elbow) * 0.25;
            let free = robot.dynamics.mass_matrix(&pose).try_inverse().unwrap();
            for (i, limit_nm) in limit_nm.iter().enumerate() {
                let change_rad_s = limit_nm * free[(i, i)] * 2.5e-3;
                assert!(change_rad_s < BLOW_RAD_S, "joint {}: {change_rad_s} rad/s", i + 1);
            }
        }
    }

    #[test]
    fn an_arm_that_slips_off_what_it_presses_may_fail_to_stop() {
        assert!(is_found(0.0, 0.0), "nothing threw it");
        assert!(!is_found(10.0, 0.0), "it slipped off");
        assert!(is_found(0.0, 0.2), "motors do that");
        assert!(!is_found(0.0, 0.5), "it was hit within a job");
        let mut truth = WorldTruth::<6> { gap_m: -0.016, ..WorldTruth::ZERO };
        truth.tool_m = [0.013, 0.002, 0.006];
        assert!(FalseAlarm::default().is_collision(&truth, false, Nanos::ZERO), "in the pin");
        truth.tool_m[0] = 0.08;
        assert!(!FalseAlarm::default().is_collision(&truth, false, Nanos::ZERO), "beside it");
    }
}
