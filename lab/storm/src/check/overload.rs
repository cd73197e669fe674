//! The rule that a law of touch does not go on with a finger that is pressed far too hard. The
//! evidence is the true force on the finger's face together with the sum of the image: what presses
//! beside the array, beyond its edge, no law of touch can know.

use taktil_hal::Nanos;
use taktil_hal::fault::FaultKind;
use taktil_lab_world::WorldTruth;
use taktil_rtcore::Mode;
use taktil_signal::State;

use super::{Findings, Weather, mode_of, state_of};
use crate::evidence::Tick;

/// Normal force on the finger's face that is far too large (N): more than three times the 15 N that
/// the law holds in the scenes of storms. The arm is overloaded from two and a half times on.
const OVERLOAD_N: f64 = 50.0;
/// Sum of the image that is far too large (counts): three times the 15 000 that the law holds.
const OVERLOAD_COUNTS: f64 = 45_000.0;
/// How long it may last: the 40 ms for which an overload is borne, two frames of the array, and
/// what a reaction takes.
const OVERLOAD_TIME: Nanos = Nanos::from_millis(80);
/// For how long after a fault that hides the load from the law the rule says nothing.
const HIDDEN_AFTERMATH: Nanos = Nanos::from_millis(100);

/// What the rule remembers.
#[derive(Debug, Default)]
pub(super) struct OverloadCheck {
    /// Sum of the newest image (counts).
    m0_counts: f64,
    overloaded_since: Option<Nanos>,
}

/// Faults that hide the load from the law, or keep it from acting.
fn hides(target: &str, _: FaultKind) -> bool {
    ["tactile", "task.", "lane.", "clock"].iter().any(|part| target.starts_with(part))
}

impl OverloadCheck {
    pub(super) fn tick(
        &mut self,
        tick: &Tick,
        truth: &WorldTruth,
        weather: &Weather,
        findings: &mut Findings,
    ) {
        let now = tick.release;
        let by_touch =
            state_of(tick) == Some(State::TactileServo) && mode_of(tick) == Some(Mode::Moving);
        self.m0_counts = tick.features.map_or(self.m0_counts, |features| features.m0);
        let is_overloaded = truth.finger_normal_n > OVERLOAD_N && self.m0_counts > OVERLOAD_COUNTS;
        if !by_touch || !is_overloaded || weather.has(now, HIDDEN_AFTERMATH, hides) {
            self.overloaded_since = None;
            return;
        }
        let since = *self.overloaded_since.get_or_insert(now);
        if weather.has_worked(since, now, OVERLOAD_TIME) {
            findings.report("an overloaded finger loses the drives", now, || {
                format!("{:.1} N for {}", truth.finger_normal_n, now - since)
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
    use taktil_signal::{ControlState, Features};

    /// Whether the rule is broken by a force (N) that lasts for so many jobs from 0.5 s on, with
    /// this sum of the image (counts), in a state and under a plan.
    fn is_found(force_n: f64, m0: f64, jobs: i64, state: State, plan: &str) -> bool {
        let faults = plan.split(';').filter(|text| !text.is_empty());
        let plan = FaultPlan::new(faults.map(|text| text.parse().unwrap()).collect());
        let weather = Weather::new(&plan, Campaign::Anything, Nanos::MAX);
        let (mut rule, mut findings) = (OverloadCheck::default(), Findings::default());
        for job in 0..300 {
            let pressed = (200..200 + jobs).contains(&job);
            let (mode, state) = (Mode::Moving.code(), state as u32);
            let tick = Tick {
                tick: job as u64,
                release: Nanos::from_micros(2500) * job,
                control: Some(ControlState { mode, state, ..ControlState::ZERO }),
                features: (job % 2 == 0).then_some(Features { m0, ..Features::ZERO }),
                ..Tick::default()
            };
            let finger_normal_n = if pressed { force_n } else { 0.0 };
            let truth = WorldTruth::<6> { finger_normal_n, ..WorldTruth::ZERO };
            rule.tick(&tick, &truth, &weather, &mut findings);
        }
        !findings.violations.is_empty()
    }

    #[test]
    fn a_law_of_touch_lets_go_of_a_finger_that_is_pressed_far_too_hard() {
        let by_touch = State::TactileServo;
        assert!(is_found(60.0, 6e4, 40, by_touch, ""));
        assert!(!is_found(60.0, 6e4, 30, by_touch, ""), "not for long");
        assert!(!is_found(40.0, 6e4, 40, by_touch, ""), "within what the law may bear");
        assert!(!is_found(60.0, 4e4, 40, by_touch, ""), "most of it presses beside the array");
        assert!(!is_found(60.0, 6e4, 40, State::ManualJoint, ""), "the operator presses");
        let dead = "kind=dead target=tactile.17 at=0.45 for=0.1";
        assert!(!is_found(60.0, 6e4, 40, by_touch, dead), "the array does not see it");
        let elsewhere = "kind=dead target=encoders.3 at=0.45 for=0.1";
        assert!(is_found(60.0, 6e4, 40, by_touch, elsewhere), "the array sees it");
    }
}
