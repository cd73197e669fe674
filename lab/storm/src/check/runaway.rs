//! The rule that a motor or an encoder whose sign is turned loses the drives before its joint has
//! turned by a degree. It is judged by the simulated arm alone: by where the joint truly is, and
//! what drives and brakes truly do, whatever the controller has noticed.

use taktil_hal::Nanos;
use taktil_hal::fault::FaultKind;
use taktil_lab_world::WorldTruth;

use super::{Findings, Weather};
use crate::evidence::Tick;

/// How far a joint may turn from where it rested while its drive is on (rad).
const TURN_MAX_RAD: f64 = 1.0 * core::f64::consts::PI / 180.0;
/// Speed up to which a joint counts as at rest, true and desired (rad/s).
const REST_RAD_S: f64 = 0.02;
/// For how long after another fault the rule says nothing: it may have left the arm in motion.
const OTHER_FAULT_AFTERMATH: Nanos = Nanos::from_millis(300);

/// A joint that rested with its drive on and one sign turned.
#[derive(Clone, Copy, Debug)]
struct Rest {
    joint: usize,
    q_rad: f64,
}

/// What the rule remembers.
#[derive(Debug, Default)]
pub(super) struct RunawayCheck {
    rest: Option<Rest>,
}

/// The joint one of whose signs is turned at `now`, where no other fault is about.
fn turned_joint(weather: &Weather, now: Nanos) -> Option<usize> {
    let only = weather.only_fault_about(now, OTHER_FAULT_AFTERMATH)?;
    let is_sign = only.kind == FaultKind::Inversion
        && ["encoders", "analog_out"].contains(&only.target.as_str());
    let joint = usize::from(only.channel?).checked_sub(1)?;
    (is_sign && joint < 6 && now < only.end()).then_some(joint)
}

impl RunawayCheck {
    pub(super) fn tick(
        &mut self,
        tick: &Tick,
        truth: &WorldTruth,
        weather: &Weather,
        findings: &mut Findings,
    ) {
        let now = tick.release;
        let is_driven = truth.enabled == 1 && truth.braked == 0;
        // What the finger meets, or an operator asks for, turns a joint, too.
        let is_free = truth.finger_normal_n <= 0.0;
        let (Some(joint), Some(desired), true, true) =
            (turned_joint(weather, now), tick.desired, is_driven, is_free)
        else {
            self.rest = None;
            return;
        };
        if desired.qd_rad_s[joint].abs() > REST_RAD_S {
            self.rest = None;
            return;
        }
        let q_rad = truth.q_rad[joint];
        let rest = self.rest.filter(|rest| rest.joint == joint);
        self.rest = rest.or_else(|| {
            let is_at_rest = truth.qd_rad_s[joint].abs() <= REST_RAD_S;
            is_at_rest.then_some(Rest { joint, q_rad })
        });
        let Some(rest) = self.rest else { return };
        let turn = (q_rad - rest.q_rad).abs();
        if turn > TURN_MAX_RAD {
            findings.report("a turned sign takes the drives", now, || {
                format!("joint {} has turned by {:.2} degrees", joint + 1, turn.to_degrees())
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::case::Campaign;
    use taktil_hal::fault::FaultPlan;
    use taktil_rtcore::Payload;
    use taktil_signal::Desired;

    /// Whether the rule is broken by a second joint that turns by so much (degrees) in 100 ms while
    /// it is desired to rest, under a plan.
    fn is_found(turn_deg: f64, plan: &str) -> bool {
        let faults = plan.split(';').filter(|text| !text.is_empty());
        let plan = FaultPlan::new(faults.map(|text| text.parse().unwrap()).collect());
        let weather = Weather::new(&plan, Campaign::Anything, Nanos::MAX);
        let (mut rule, mut findings) = (RunawayCheck::default(), Findings::default());
        for job in 0..40 {
            let mut tick = Tick { tick: job, ..Tick::default() };
            tick.release = Nanos::from_millis(900) + Nanos::from_micros(2500) * job as i64;
            tick.desired = Some(Desired { valid: 1, ..Desired::ZERO });
            let mut truth = WorldTruth::<6> { enabled: 1, ..WorldTruth::ZERO };
            truth.q_rad[1] = turn_deg.to_radians() * job as f64 / 40.0;
            rule.tick(&tick, &truth, &weather, &mut findings);
        }
        !findings.violations.is_empty()
    }

    #[test]
    fn a_joint_that_turns_under_a_turned_sign_breaks_the_rule_and_no_other_does() {
        let turned = "kind=inversion target=analog_out.2 at=0.8 for=1";
        assert!(is_found(1.5, turned));
        assert!(is_found(1.5, "kind=inversion target=encoders.2 at=0.8 for=1"));
        assert!(!is_found(0.9, turned));
        assert!(!is_found(1.5, ""), "nothing is turned");
        assert!(!is_found(1.5, "kind=inversion target=analog_out.3 at=0.8 for=1"), "another one");
        let gone = "kind=frozen target=encoders at=0.7 for=0.1";
        assert!(!is_found(1.5, &format!("{turned};{gone}")), "something else, too");
    }
}
