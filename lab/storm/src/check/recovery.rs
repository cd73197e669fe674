//! After recoverable faults have ended the machine comes back: within two seconds of a reset it is
//! ready, and it then moves where the operator pushes it, without a fault.

use taktil_hal::Nanos;
use taktil_mechanics::robot::Robot;
use taktil_rtcore::Mode;
use taktil_signal::Verb;

use super::{ArmLimits, Findings, Weather, allows_torque, mode_of};
use crate::case::Campaign;
use crate::evidence::Tick;

/// Time from a reset without faults about to READY.
const READY_TIME: Nanos = Nanos::from_secs(2);
/// Natural frequency of the servo of each joint, as the scenes have it (rad/s).
const SERVO_BANDWIDTH_RAD_S: f64 = 60.0;
/// A joint lags without a cause when its servo, stiff as it is, asks for so many times the torque
/// limit: once for the limit, once for whatever is fed forward against the error.
const LAG_TORQUE_FACTOR: f64 = 2.0;
/// For how many jobs such a joint may get less torque than it could without catching up.
const IDLE_LAG_JOBS: u32 = 8;
/// Largest difference between desired and measured joints (rad) where the operator may push the arm
/// into something: the window of the following error, and
/// what the arm does until it stops.
const TOUCHING_RAD: f64 = 0.13;
/// Time in MOVING before the end that is judged.
const JUDGED_TIME: Nanos = Nanos::from_millis(500);

/// What the rule about recovery remembers.
#[derive(Debug)]
pub(super) struct Recovery {
    arm: ArmLimits,
    /// Lag of each joint beyond which its torque must be at its limit (rad).
    lag_rad: [f64; 6],
    /// For how many jobs each joint has lagged with less torque than it could get, and its lag when
    /// that began (rad).
    idle_lag: [(u32, f64); 6],
    sequence: Option<u32>,
    /// The newest request to reset since the calm began that has not led to READY yet.
    reset: Option<Nanos>,
    /// Since when the machine has moved without a break.
    moving_since: Option<Nanos>,
    /// When a motion in the calm last ended that had lasted long enough to be judged.
    moved_until: Option<Nanos>,
    last: Option<(Nanos, Mode, u64)>,
}

impl Recovery {
    /// For an arm with these limits.
    pub(super) fn new(arm: ArmLimits) -> Recovery {
        let robot = Robot::puma260();
        let inertia = robot.dynamics.mass_matrix(&robot.nominal_rad);
        let stiffness_nm_rad =
            |i: usize| inertia[(i, i)] * SERVO_BANDWIDTH_RAD_S * SERVO_BANDWIDTH_RAD_S;
        let lag_rad =
            core::array::from_fn(|i| LAG_TORQUE_FACTOR * arm.torque_nm[i] / stiffness_nm_rad(i));
        Recovery {
            arm,
            lag_rad,
            idle_lag: [(0, 0.0); 6],
            sequence: None,
            reset: None,
            moving_since: None,
            moved_until: None,
            last: None,
        }
    }

    /// A joint that lags has all the torque that its limit leaves, or catches up: the first one
    /// that does neither, with its lag (rad).
    fn idle_lag(&mut self, tick: &Tick, settled: bool) -> Option<(usize, f64)> {
        let (Some(desired), Some(joints), Some(word), true) =
            (tick.desired, tick.joints, tick.analog, settled)
        else {
            self.idle_lag = [(0, 0.0); 6];
            return None;
        };
        let mut found = None;
        for joint in 0..6 {
            let error = desired.q_rad[joint] - joints.q_rad[joint];
            let is_driven = self.arm.is_at_torque_limit(&word.codes, joint, error.signum());
            if error.abs() <= self.lag_rad[joint] || is_driven {
                self.idle_lag[joint] = (0, 0.0);
                continue;
            }
            let (jobs, first) = &mut self.idle_lag[joint];
            if *jobs == 0 || error.abs() < *first {
                (*jobs, *first) = (0, error.abs());
            }
            *jobs += 1;
            if *jobs > IDLE_LAG_JOBS {
                found = found.or(Some((joint, error.abs())));
            }
        }
        found
    }

    pub(super) fn tick(&mut self, tick: &Tick, weather: &Weather, findings: &mut Findings) {
        let now = tick.release;
        let request = tick.request.filter(|new| self.sequence != Some(new.sequence));
        self.sequence = tick.request.map(|request| request.sequence).or(self.sequence);
        let Some(mode) = mode_of(tick) else { return };
        self.last = Some((now, mode, tick.control.map_or(0, |control| control.faults)));
        if mode == Mode::Moving {
            self.moving_since.get_or_insert(now);
        } else if let Some(since) = self.moving_since.take()
            && now - since.max(weather.calm_from) > JUDGED_TIME
        {
            self.moved_until = Some(now);
        }
        if weather.campaign != Campaign::Recoverable || now < weather.calm_from {
            return;
        }
        if request.is_some_and(|request| request.verb == Verb::Reset as u32) {
            self.reset.get_or_insert(now);
        }
        if mode == Mode::Ready || allows_torque(mode) {
            self.reset = None;
        }
        if let Some(reset) = self.reset.filter(|reset| now - *reset > READY_TIME) {
            findings.report("ready after a reset", now, || {
                format!("{mode:?} {} after the reset", now - reset)
            });
        }
        let settled = self.moving_since.is_some_and(|since| now - since > JUDGED_TIME);
        let lag = if self.arm.touches {
            pushed_away(tick).filter(|_| settled)
        } else {
            self.idle_lag(tick, settled)
        };
        if let Some((joint, lag)) = lag {
            findings.report("the arm follows after the faults", now, || {
                format!("joint {} is {:.3} deg off", joint + 1, lag.to_degrees())
            });
        }
    }

    pub(super) fn finish(&mut self, weather: &Weather, findings: &mut Findings) {
        let Some((now, mode, faults)) = self.last else { return };
        if weather.campaign != Campaign::Recoverable || now < weather.calm_from {
            return;
        }
        // Whoever pushes the arm into something is stopped again, and begins anew.
        let moved = self.moved_until.is_some_and(|until| now - until <= READY_TIME);
        let stopped_again = self.arm.touches && (faults != 0 || mode == Mode::Moving || moved);
        if !stopped_again && self.moving_since.is_none_or(|since| now - since < JUDGED_TIME) {
            findings.report("back at work after the faults", now, || {
                format!("{mode:?} with faults {faults:#x} at the end")
            });
        }
    }
}

/// The first joint that is further off than any that is pushed into something may be, with its
/// error (rad).
fn pushed_away(tick: &Tick) -> Option<(usize, f64)> {
    let (desired, joints) = (tick.desired?, tick.joints?);
    let error = |joint: usize| (desired.q_rad[joint] - joints.q_rad[joint]).abs();
    let joint = (0..6).find(|joint| error(*joint) > TOUCHING_RAD)?;
    Some((joint, error(joint)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_hal::fault::FaultPlan;
    use taktil_machine::tape::AnalogWord;
    use taktil_rtcore::Payload;
    use taktil_signal::{ControlState, Desired, JointState};

    /// What is found of a joint 1 that is behind by `lag_rad` and has these codes, in each of 400
    /// jobs in MOVING.
    fn found(lag_rad: impl Fn(u64) -> f64, code: impl Fn(u64) -> i32) -> bool {
        let weather = Weather::new(&FaultPlan::default(), Campaign::Recoverable, Nanos::ZERO);
        let torque_nm = [8.0, 12.0, 7.0, 2.0, 1.5, 1.2];
        let mut recovery = Recovery::new(ArmLimits::new(Some(&torque_nm)));
        let mut findings = Findings::default();
        for job in 0..400 {
            let mut tick = Tick { tick: job, ..Tick::default() };
            tick.release = Nanos::from_micros(2500) * job as i64;
            tick.control =
                Some(ControlState { mode: Mode::Moving.code(), ..ControlState::default() });
            tick.joints = Some(JointState::ZERO);
            tick.desired = Some(Desired { valid: 1, ..Desired::ZERO });
            if let Some(desired) = &mut tick.desired {
                desired.q_rad[0] = lag_rad(job);
            }
            let codes = [code(job), 0, 0, 0, 0, 0, 0, 0];
            tick.analog = Some(AnalogWord { codes, ..AnalogWord::ZERO });
            recovery.tick(&tick, &weather, &mut findings);
        }
        !findings.violations.is_empty()
    }

    /// Codes of motor 1 that make the 8 N m of its limit.
    const FULL_CODE: i32 = 1275;

    #[test]
    fn a_joint_lags_only_with_all_its_torque_or_while_it_catches_up() {
        let two_deg = 0.035;
        assert!(!found(|_| two_deg, |_| FULL_CODE), "all that the limit leaves");
        assert!(found(|_| two_deg, |_| FULL_CODE / 2), "half of it");
        assert!(found(|_| two_deg, |_| -FULL_CODE), "away from where it should be");
        assert!(found(|_| -two_deg, |_| FULL_CODE), "the same on the other side");
        let catching_up = |job: u64| two_deg * (1.0 - (job % 100) as f64 / 120.0);
        let full_at_first = |job: u64| if job % 100 < 9 { FULL_CODE } else { 0 };
        assert!(!found(catching_up, full_at_first));
        assert!(!found(|_| 0.004, |_| 0), "what friction holds");
    }
}
