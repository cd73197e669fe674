//! A start knows nothing of what was before: as long as an arm that was just enabled stands exactly
//! where it is desired, the servo has no error to act on and no motion to support. What is left is
//! the torque that holds the arm against gravity in its pose, whatever the servo did or learned
//! before the stop.

use taktil_mechanics::Joints;
use taktil_mechanics::puma260::dynamics::Dynamics;
use taktil_mechanics::robot::Robot;

use super::{ArmLimits, Findings, Weather, allows_torque, mode_of};
use crate::evidence::Tick;

/// Tolerance of the torque of a start (N m): rounding of numbers only.
const START_TOLERANCE_NM: f64 = 1e-6;

/// What the rule remembers.
#[derive(Debug)]
pub(super) struct StartCheck {
    dynamics: Dynamics,
    /// The pose in which the arm was when its counters began (rad).
    power_up_rad: Option<[f64; 6]>,
    /// The zero of the joints in a start in which the arm has stood as desired from the first job
    /// with torque on; none otherwise.
    start: Option<u32>,
    was_allowed: bool,
}

impl StartCheck {
    pub(super) fn new(arm: &ArmLimits) -> StartCheck {
        let dynamics = Robot::puma260().dynamics;
        StartCheck { dynamics, power_up_rad: arm.home_rad, start: None, was_allowed: true }
    }

    pub(super) fn tick(&mut self, tick: &Tick, weather: &Weather, findings: &mut Findings) {
        let now = tick.release;
        let allowed = mode_of(tick).is_some_and(allows_torque);
        let was_allowed = core::mem::replace(&mut self.was_allowed, allowed);
        let (Some(joints), Some(desired), Some(torque)) = (tick.joints, tick.desired, tick.torque)
        else {
            self.start = None;
            return;
        };
        if !was_allowed {
            self.start = Some(joints.datum);
        }
        let stands = desired.q_rad == joints.q_rad && desired.qd_rad_s == [0.0; 6];
        let spoilt = weather.is_late(now)
            || weather.has_panicked(now)
            || weather.is_on("task.joint_servo", now, super::LATE_AFTERMATH);
        if !allowed || !stands || spoilt || self.start != Some(joints.datum) {
            self.start = None;
            return;
        }
        let q_rad = match (joints.calibrated, self.power_up_rad) {
            (1, _) => joints.q_rad,
            // Counts that were never given another zero begin at power-up.
            (_, Some(power_up)) if joints.datum == 0 => {
                core::array::from_fn(|i| power_up[i] + joints.q_rad[i])
            }
            _ => return,
        };
        let gravity_nm = self.dynamics.gravity_torque(&Joints::from(q_rad));
        let off =
            |joint: &usize| (torque.tau_nm[*joint] - gravity_nm[*joint]).abs() > START_TOLERANCE_NM;
        if let Some(joint) = (0..6).find(off) {
            findings.report("a start knows nothing of the past", now, || {
                let (given, due) = (torque.tau_nm[joint], gravity_nm[joint]);
                format!("{given:.4} N m at joint {} at rest, {due:.4} of gravity", joint + 1)
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::case::Campaign;
    use taktil_hal::Nanos;
    use taktil_hal::fault::FaultPlan;
    use taktil_rtcore::{Mode, Payload};
    use taktil_signal::{ControlState, Desired, JointState, Torque};

    const POSE_RAD: [f64; 6] = [0.3, 0.7, -2.6, 1.7, 1.2, 2.8];

    /// Whether the rule is broken by a calibrated arm that is enabled in job 10 and given so much
    /// torque (N m) beside that of gravity, while it is off by `error_rad` from job 20 on.
    fn is_found(beside_nm: impl Fn(u64) -> f64, error_rad: f64) -> bool {
        let weather = Weather::new(&FaultPlan::default(), Campaign::Anything, Nanos::MAX);
        let mut check = StartCheck::new(&ArmLimits::new(None));
        let mut findings = Findings::default();
        let gravity_nm = Robot::puma260().dynamics.gravity_torque(&Joints::from(POSE_RAD));
        for job in 0..40 {
            let mode = if job < 10 { Mode::Ready } else { Mode::Enabling };
            let mut torque = Torque { tau_nm: [0.0; 6], ..Torque::ZERO };
            if job >= 10 {
                torque.tau_nm = gravity_nm.into();
                torque.tau_nm[1] += beside_nm(job);
            }
            let mut desired = Desired { q_rad: POSE_RAD, valid: 1, ..Desired::ZERO };
            desired.q_rad[1] += if job < 20 { 0.0 } else { error_rad };
            let tick = Tick {
                tick: job,
                control: Some(ControlState { mode: mode.code(), ..ControlState::ZERO }),
                joints: Some(JointState { q_rad: POSE_RAD, calibrated: 1, ..JointState::ZERO }),
                desired: Some(desired),
                torque: Some(torque),
                ..Tick::default()
            };
            check.tick(&tick, &weather, &mut findings);
        }
        !findings.violations.is_empty()
    }

    #[test]
    fn a_start_at_rest_takes_the_torque_of_gravity_and_no_other() {
        assert!(!is_found(|_| 0.0, 0.0));
        assert!(is_found(|_| 0.1, 0.0), "friction of before");
        assert!(is_found(|job| if job == 19 { -0.1 } else { 0.0 }, 0.0), "it comes later");
        assert!(!is_found(|job| if job < 20 { 0.0 } else { 0.1 }, 1e-4), "there is an error");
    }
}
