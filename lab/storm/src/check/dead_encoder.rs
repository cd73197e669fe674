//! The rule that an arm whose encoder does not count any more is not driven on: a joint that stands
//! by its encoder, although it is desired elsewhere and nothing can hold it, loses the drives. How
//! far it has truly turned by then no controller knows; a torque that friction may take says
//! nothing, so that only what is desired is judged.

use taktil_hal::Nanos;
use taktil_hal::fault::{Fault, FaultKind};
use taktil_lab_world::WorldTruth;

use super::{Findings, Weather, allows_torque, mode_of};
use crate::evidence::Tick;

/// Distance of desired from measured joint that asks for more torque than friction takes (rad), and
/// for how long.
const ASKED_RAD: f64 = 1.0 * core::f64::consts::PI / 180.0;
const ASKED_TIME: Nanos = Nanos::from_millis(50);
/// For how long after a contact the rule says nothing: what was touched may have held a joint that
/// friction holds from there on.
const TOUCH_AFTERMATH: Nanos = Nanos::from_millis(300);
/// For how long after another fault the rule says nothing: it may have left the arm in motion.
const OTHER_FAULT_AFTERMATH: Nanos = Nanos::from_millis(300);

/// What the rule remembers.
#[derive(Debug, Default)]
pub(super) struct DeadEncoderCheck {
    /// When the finger has touched something last.
    touched: Option<Nanos>,
    asked_since: Option<Nanos>,
}

/// Faults that let a controller not see, or not act, in time.
fn delays(target: &str, kind: FaultKind) -> bool {
    let is_dead = target == "encoders" && kind == FaultKind::Dead;
    !is_dead
        && (target == "clock"
            || ["encoders", "lane.", "task."].iter().any(|part| target.starts_with(part)))
}

/// The joint whose encoder is dead at `now`, the only one, where nothing delays what follows.
fn dead_joint(weather: &Weather, now: Nanos) -> Option<usize> {
    if weather.has(now, OTHER_FAULT_AFTERMATH, delays) {
        return None;
    }
    let is_dead = |fault: &&Fault| {
        fault.kind == FaultKind::Dead
            && fault.target == "encoders"
            && fault.at <= now
            && now < fault.end()
    };
    let mut dead = weather.faults.iter().filter(is_dead);
    let joint = usize::from(dead.next()?.channel?).checked_sub(1)?;
    (dead.next().is_none() && joint < 6).then_some(joint)
}

impl DeadEncoderCheck {
    pub(super) fn tick(
        &mut self,
        tick: &Tick,
        truth: &WorldTruth,
        weather: &Weather,
        findings: &mut Findings,
    ) {
        let now = tick.release;
        let is_driven = mode_of(tick).is_some_and(allows_torque) && truth.braked == 0;
        if truth.finger_normal_n > 0.0 {
            self.touched = Some(now);
        }
        let is_free = self.touched.is_none_or(|touched| now - touched > TOUCH_AFTERMATH);
        let joints = tick.joints;
        let desired = tick.desired.filter(|desired| desired.valid == 1);
        let apart_rad = match (dead_joint(weather, now), joints, desired) {
            (Some(i), Some(joints), Some(desired)) if is_driven && is_free => {
                (desired.q_rad[i] - joints.q_rad[i]).abs()
            }
            _ => 0.0,
        };
        if apart_rad <= ASKED_RAD {
            self.asked_since = None;
            return;
        }
        let since = *self.asked_since.get_or_insert(now);
        if weather.has_worked(since, now, ASKED_TIME) {
            findings.report("a joint that does not count is noticed", now, || {
                format!("desired {:.2} degrees away for {}", apart_rad.to_degrees(), now - since)
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::case::Campaign;
    use taktil_hal::fault::FaultPlan;
    use taktil_rtcore::{Mode, Payload};
    use taktil_signal::{ControlState, Desired, JointState};

    const DEAD: &str = "kind=dead target=encoders.2 at=0.5";

    /// Whether the rule is broken by a second joint that is desired so far (deg) from where it
    /// is measured, for so many jobs, in a mode and under a plan.
    fn is_found(
        check: DeadEncoderCheck,
        apart_deg: f64,
        jobs: i64,
        mode: Mode,
        plan: &str,
    ) -> bool {
        let faults = plan.split(';').filter(|text| !text.is_empty());
        let plan = FaultPlan::new(faults.map(|text| text.parse().unwrap()).collect());
        let weather = Weather::new(&plan, Campaign::Anything, Nanos::MAX);
        let (mut rule, mut findings) = (check, Findings::default());
        for job in 0..400 {
            let mut desired = Desired { valid: 1, ..Desired::ZERO };
            if (300..300 + jobs).contains(&job) {
                desired.q_rad[1] = apart_deg.to_radians();
            }
            let tick = Tick {
                tick: job as u64,
                release: Nanos::from_micros(2500) * job,
                control: Some(ControlState { mode: mode.code(), ..ControlState::ZERO }),
                joints: Some(JointState { calibrated: 1, ..JointState::ZERO }),
                desired: Some(desired),
                ..Tick::default()
            };
            let truth = WorldTruth::<6> { enabled: 1, ..WorldTruth::ZERO };
            rule.tick(&tick, &truth, &weather, &mut findings);
        }
        !findings.violations.is_empty()
    }

    #[test]
    fn a_joint_that_is_desired_away_and_does_not_count_has_to_be_noticed() {
        let free = DeadEncoderCheck::default;
        assert!(is_found(free(), 1.2, 40, Mode::Moving, DEAD));
        assert!(is_found(free(), -1.2, 40, Mode::Hold, DEAD));
        assert!(!is_found(free(), 0.9, 40, Mode::Moving, DEAD), "friction may take that torque");
        assert!(!is_found(free(), 1.2, 15, Mode::Moving, DEAD), "not for long");
        assert!(!is_found(free(), 1.2, 40, Mode::Fault, DEAD), "the drives are off");
        assert!(!is_found(free(), 1.2, 40, Mode::Moving, ""), "its encoder counts");
        let other = "kind=dead target=encoders.3 at=0.5";
        assert!(!is_found(free(), 1.2, 40, Mode::Moving, other), "another one");
        let both = format!("{DEAD};kind=jump target=encoders.2 at=0.6 for=0.1 value=500");
        assert!(!is_found(free(), 1.2, 40, Mode::Moving, &both), "something else, too");
        let held = DeadEncoderCheck { touched: Some(Nanos::from_millis(600)), ..free() };
        assert!(!is_found(held, 1.2, 40, Mode::Moving, DEAD), "it may be held");
    }
}
