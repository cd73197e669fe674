//! The rule that an undisturbed arm follows closely: what the servo feeds forward for weight,
//! inertia and friction has the right sign and size. An arm is undisturbed that is calibrated, gets
//! all the torque that is asked for, and to which nothing has happened. The rule holds for the
//! scenes without anything to touch: in the others the servo feeds forward no inertia and no
//! friction but what it has learned, and the arm lags more.

use taktil_hal::Nanos;
use taktil_lab_world::WorldTruth;

use super::{ArmLimits, Findings, SpeedChange, Weather, allows_torque, mode_of};
use crate::evidence::Tick;

/// For how long an arm must have been undisturbed.
const UNDISTURBED_TIME: Nanos = Nanos::from_millis(500);
/// Largest distance of measured from desired joints then (deg): 1.5 times what 4000 storms showed.
const LAG_MAX_DEG: [f64; 6] = [0.25, 0.15, 0.25, 0.3, 0.25, 0.42];
/// Change of a joint's true speed within a job (rad/s) that is twice what the ramps of jogs and
/// moves ask for: something was hit, and may be left again before the job is over.
const SPEED_CHANGE_MAX_RAD_S: f64 = 0.15;

/// What the rule remembers.
#[derive(Debug, Default)]
pub(super) struct TrackingCheck {
    /// Whether the scene has something to touch.
    touches: bool,
    speed_change: SpeedChange,
    undisturbed_since: Option<Nanos>,
}

impl TrackingCheck {
    pub(super) fn new(arm: &ArmLimits) -> TrackingCheck {
        TrackingCheck { touches: arm.touches, ..TrackingCheck::default() }
    }

    pub(super) fn tick(
        &mut self,
        tick: &Tick,
        truth: &WorldTruth,
        weather: &Weather,
        findings: &mut Findings,
    ) {
        let now = tick.release;
        let is_free = !self.touches && truth.finger_normal_n <= 0.0;
        let is_driven = mode_of(tick).is_some_and(allows_torque) && truth.braked == 0;
        let is_limited = tick.applied.is_none_or(|applied| applied.limited != 0);
        let change_rad_s = self.speed_change.update(truth);
        let is_befallen = weather.has(now, UNDISTURBED_TIME, |_, _| true)
            || change_rad_s.iter().any(|change| *change > SPEED_CHANGE_MAX_RAD_S);
        let joints = tick.joints.filter(|joints| joints.calibrated == 1);
        let (Some(joints), Some(desired), true, true, false, false) =
            (joints, tick.desired, is_free, is_driven, is_limited, is_befallen)
        else {
            self.undisturbed_since = None;
            return;
        };
        let since = *self.undisturbed_since.get_or_insert(now);
        if now - since < UNDISTURBED_TIME || desired.valid == 0 {
            return;
        }
        let lag_deg = |i: usize| (desired.q_rad[i] - joints.q_rad[i]).abs().to_degrees();
        if let Some(joint) = (0..6).find(|i| lag_deg(*i) > LAG_MAX_DEG[*i]) {
            findings.report("an undisturbed arm follows closely", now, || {
                format!("joint {} is off by {:.3} degrees", joint + 1, lag_deg(joint))
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
    use taktil_signal::{Applied, ControlState, Desired, JointState};

    /// Whether the rule is broken by a third joint that is off by so much (deg) from 0.8 s to
    /// 0.9 s, in records that something else has changed, under a plan.
    fn is_found(off_deg: f64, plan: &str, change: impl Fn(&mut Tick, &mut WorldTruth)) -> bool {
        let faults = plan.split(';').filter(|text| !text.is_empty());
        let plan = FaultPlan::new(faults.map(|text| text.parse().unwrap()).collect());
        let weather = Weather::new(&plan, Campaign::Anything, Nanos::MAX);
        let (mut rule, mut findings) = (TrackingCheck::default(), Findings::default());
        for job in 0..400 {
            let release = Nanos::from_micros(2500) * job;
            let mut joints = JointState { calibrated: 1, ..JointState::ZERO };
            if (320..360).contains(&job) {
                joints.q_rad[2] = off_deg.to_radians();
            }
            let mut tick = Tick {
                tick: job as u64,
                release,
                control: Some(ControlState { mode: Mode::Moving.code(), ..ControlState::ZERO }),
                joints: Some(joints),
                desired: Some(Desired { valid: 1, ..Desired::ZERO }),
                applied: Some(Applied { gate_open: 1, ..Applied::ZERO }),
                ..Tick::default()
            };
            let mut truth = WorldTruth::<6> { enabled: 1, ..WorldTruth::ZERO };
            change(&mut tick, &mut truth);
            rule.tick(&tick, &truth, &weather, &mut findings);
        }
        !findings.violations.is_empty()
    }

    #[test]
    fn a_free_arm_follows_within_fractions_of_a_degree() {
        let same = |_: &mut Tick, _: &mut WorldTruth| {};
        assert!(is_found(0.3, "", same) && is_found(-0.3, "", same));
        assert!(!is_found(0.2, "", same));
        let befallen = "kind=jump target=encoders.2 at=0.2 for=0.2 value=500";
        assert!(!is_found(0.3, befallen, same), "something has happened");
        let long_ago = "kind=jump target=encoders.2 at=0 for=0.1 value=500";
        assert!(!is_found(0.3, long_ago, same), "undisturbed for 0.2 s only");
        assert!(!is_found(0.3, "", |_, truth| truth.finger_normal_n = 1.0), "in contact");
        let hit = |tick: &mut Tick, truth: &mut WorldTruth| {
            truth.qd_rad_s[4] = if tick.tick < 300 { 0.0 } else { 0.3 };
        };
        assert!(!is_found(0.3, "", hit), "it was hit");
        let limited = |tick: &mut Tick, _: &mut WorldTruth| {
            tick.applied = Some(Applied { gate_open: 1, limited: 1, ..Applied::ZERO });
        };
        assert!(!is_found(0.3, "", limited), "its torque is cut off");
        let arm = ArmLimits::new(None);
        assert!(!TrackingCheck::new(&arm).touches);
        assert!(TrackingCheck::new(&arm.at_home(&[0.0; 6], true)).touches, "not judged");
        let unknown = |tick: &mut Tick, _: &mut WorldTruth| {
            tick.joints.iter_mut().for_each(|joints| joints.calibrated = 0);
        };
        assert!(!is_found(0.3, "", unknown), "its pose is unknown");
    }
}
