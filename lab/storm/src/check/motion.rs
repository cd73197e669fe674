//! How desired joints move: a jog within the speed and the ramp of its configuration, and away from
//! the limits by itself; a programmed move within its own speeds; what they are said to move at is
//! what they do; a motion begins where they are; they come to rest when nobody leads them, and
//! never hurry further ahead of the arm than they may.

use taktil_hal::Nanos;
use taktil_mechanics::Joints;
use taktil_mechanics::puma260::Puma260;
use taktil_mechanics::robot::Robot;
use taktil_rtcore::Mode;
use taktil_signal::State;

use super::{ArmLimits, Findings, Weather, mode_of, state_of};
use crate::evidence::Tick;

/// Tolerance of numbers that should be equal, for rounding (rad, rad/s).
const ROUNDING_TOLERANCE: f64 = 1e-6;
/// How much more of its ramp than one job of it a jog may take at once: at its limits it brakes by
/// the way that is left.
const RAMP_RATIO: f64 = 2.0;
/// Largest distance of desired from measured joints, as the machine file says (rad).
const LEAD_MAX_RAD: f64 = 0.104_719_755_2;
/// Longest time in which desired joints that nobody leads come to rest: 0.2 s as the machine file
/// says, and what a reaction takes.
const COAST_TIME: Nanos = Nanos::from_millis(220);
/// Speed of a desired joint that counts as rest (rad/s).
const REST_SPEED_RAD_S: f64 = 1e-3;
/// Farthest that a desired joint at rest goes in the first job of a motion (rad).
const FIRST_STEP_MAX_RAD: f64 = 5e-4;
/// Speed from which on a joint is said to move (rad/s).
const TOLD_SPEED_RAD_S: f64 = 0.05;
/// Share of the largest joint speeds, and speed of the tool on straight moves (m/s), at which
/// programmed moves go, as the machine file says.
const PROGRAM_SPEED: f64 = 0.3;
const LINE_SPEED_M_S: f64 = 0.05;
/// How much faster a move may be within its blends.
const SPEED_RATIO: f64 = 1.1;
/// A desired joint outside its limits, among the latched faults.
const SOFT_LIMIT_BIT: u64 = 1 << 9;

/// What the rules about desired joints remember.
#[derive(Debug)]
pub(super) struct MotionCheck {
    arm: ArmLimits,
    robot: Puma260,
    /// Since when nobody leads the desired joints.
    unled_since: Option<Nanos>,
}

/// Whether the operator's keys lead the arm in this state.
const fn is_manual(state: Option<State>) -> bool {
    matches!(state, Some(State::ManualUncalibrated | State::ManualJoint | State::ManualCartesian))
}

impl MotionCheck {
    pub(super) fn new(arm: ArmLimits) -> MotionCheck {
        MotionCheck { arm, robot: Robot::puma260().arm, unled_since: None }
    }

    pub(super) fn tick(
        &mut self,
        before: &Tick,
        tick: &Tick,
        weather: &Weather,
        findings: &mut Findings,
    ) {
        let now = tick.release;
        let faults = |tick: &Tick| tick.control.map_or(0, |control| control.faults);
        let manual = is_manual(state_of(before));
        // Without a calibration of its own a jog knows no limits, and leaves them to the setpoint.
        let knows = matches!(state_of(before), Some(State::ManualJoint | State::ManualCartesian));
        if knows && faults(tick) & !faults(before) & SOFT_LIMIT_BIT != 0 {
            findings.report("a jog keeps off the limits by itself", now, || {
                let desired = before.desired.map_or([0.0; 6], |desired| desired.q_rad);
                format!("in {:?} from {:?} deg", state_of(before), desired.map(f64::to_degrees))
            });
        }
        let (Some(old), Some(new)) = (before.desired, tick.desired) else { return };
        let (Some(was), Some(joints)) = (before.joints, tick.joints) else { return };
        let next = before.tick + 1 == tick.tick;
        let both = old.valid == 1 && new.valid == 1 && was.datum == joints.datum;
        if !next || !both || weather.is_late(now) || weather.has_panicked(now) {
            self.unled_since = None;
            return;
        }
        self.coast(tick, new.qd_rad_s, weather, findings);
        let dt_s = (now - before.release).as_secs_f64();
        let step_rad: [f64; 6] = core::array::from_fn(|i| new.q_rad[i] - old.q_rad[i]);
        let lead_rad: [f64; 6] = core::array::from_fn(|i| (new.q_rad[i] - joints.q_rad[i]).abs());
        let powered = |mode| matches!(mode, Some(Mode::Hold | Mode::Moving | Mode::Stopping));
        if !powered(mode_of(before)) || !powered(mode_of(tick)) {
            return;
        }
        let runs_ahead =
            |i: &usize| step_rad[*i] != 0.0 && lead_rad[*i] > LEAD_MAX_RAD + ROUNDING_TOLERANCE;
        if let Some(joint) = (0..6).find(runs_ahead) {
            findings.report("desired joints wait for the arm", now, || {
                format!("joint {} {:.3} deg ahead", joint + 1, lead_rad[joint].to_degrees())
            });
        }
        // Desired joints at the end of their lead are drawn along by the arm.
        let is_free = lead_rad.iter().all(|lead| *lead < LEAD_MAX_RAD - 0.01)
            && (0..6).all(|i| (old.q_rad[i] - was.q_rad[i]).abs() < LEAD_MAX_RAD - 0.01);
        let moves = |tick: &Tick| mode_of(tick) == Some(Mode::Moving);
        let entered = |tick: &Tick| tick.control.map(|control| control.entered_ns);
        if !is_free || !moves(tick) {
            return;
        }
        let begins = entered(before) != entered(tick);
        if begins && old.qd_rad_s == [0.0; 6] {
            // A law of touch approaches at its speed from the first job on; others ramp up.
            let by_touch = state_of(tick) == Some(State::TactileServo);
            let led_s = if by_touch { dt_s } else { 0.0 };
            let off_rad = |i: usize| step_rad[i] - new.qd_rad_s[i] * led_s;
            if let Some(joint) = (0..6).find(|i| off_rad(*i).abs() > FIRST_STEP_MAX_RAD) {
                findings.report("a motion begins where the desired joints are", now, || {
                    format!("joint {} off by {:.4} deg", joint + 1, off_rad(joint).to_degrees())
                });
            }
        }
        let is_programmed =
            |tick: &Tick| matches!(state_of(tick), Some(State::Trajectory | State::TrajectoryUser));
        if !begins && moves(before) && is_programmed(tick) {
            self.programmed(tick, old.q_rad, dt_s, findings);
        }
        if !begins && moves(before) && manual && is_manual(state_of(tick)) {
            self.jog(tick, old.qd_rad_s, step_rad, dt_s, findings);
        }
    }

    /// Desired joints that nobody leads come to rest.
    fn coast(
        &mut self,
        tick: &Tick,
        qd_rad_s: [f64; 6],
        weather: &Weather,
        findings: &mut Findings,
    ) {
        let now = tick.release;
        if !matches!(mode_of(tick), Some(Mode::Stopping | Mode::Hold)) {
            self.unled_since = None;
            return;
        }
        let since = *self.unled_since.get_or_insert(now);
        let fast = |i: &usize| qd_rad_s[*i].abs() > REST_SPEED_RAD_S;
        let is_due = weather.has_worked(since, now, COAST_TIME);
        if let (true, Some(joint)) = (is_due, (0..6).find(fast)) {
            findings.report("desired joints that nobody leads come to rest", now, || {
                format!("joint {} at {:.4} rad/s", joint + 1, qd_rad_s[joint])
            });
        }
    }

    /// A programmed move keeps to the speed of its joints, or is straight and keeps to that of the
    /// tool.
    fn programmed(&self, tick: &Tick, old_rad: [f64; 6], dt_s: f64, findings: &mut Findings) {
        let Some(new) = tick.desired else { return };
        let most_rad_s = |i: usize| PROGRAM_SPEED * self.arm.speed_max_rad_s[i];
        let fast = |i: &usize| new.qd_rad_s[*i].abs() > SPEED_RATIO * most_rad_s(*i);
        let Some(joint) = (0..6).find(fast) else { return };
        let tool = |q_rad: [f64; 6]| self.robot.tool_pose(&Joints::from(q_rad)).translation;
        let tool_m_s = (tool(new.q_rad) - tool(old_rad)).length() / dt_s;
        if tool_m_s > SPEED_RATIO * LINE_SPEED_M_S {
            findings.report("a programmed move keeps to its speed", tick.release, || {
                let (is, most) = (new.qd_rad_s[joint], most_rad_s(joint));
                format!(
                    "joint {} {is:.3} rad/s, {most:.3} at most, tool {tool_m_s:.3} m/s",
                    joint + 1
                )
            });
        }
    }

    /// A jog keeps to its speed and its ramp, and its speed is what its joints do.
    fn jog(
        &self,
        tick: &Tick,
        old_rad_s: [f64; 6],
        step_rad: [f64; 6],
        dt_s: f64,
        findings: &mut Findings,
    ) {
        let (now, Some(new)) = (tick.release, tick.desired) else { return };
        // A setpoint that brakes beside a goal says the speed at the end of the job.
        let off = |i: &usize| {
            let did = step_rad[*i] / dt_s;
            did.abs() > TOLD_SPEED_RAD_S && new.qd_rad_s[*i] * did.signum() < 0.2 * did.abs()
        };
        if let Some(joint) = (0..6).find(off) {
            findings.report("a jog moves at the speed that it says", now, || {
                let did = step_rad[joint] / dt_s;
                format!("joint {} {did:.4} rad/s, {:.4} said", joint + 1, new.qd_rad_s[joint])
            });
        }
        let share = match state_of(tick) {
            Some(State::ManualUncalibrated) => self.arm.jog_uncalibrated,
            Some(State::ManualJoint) => self.arm.jog_calibrated,
            _ => return,
        };
        let most_rad_s: [f64; 6] =
            core::array::from_fn(|i| share.speed * self.arm.speed_max_rad_s[i]);
        let fast = |i: &usize| new.qd_rad_s[*i].abs() > most_rad_s[*i] + ROUNDING_TOLERANCE;
        if let Some(joint) = (0..6).find(fast) {
            findings.report("a jog keeps to its speed", now, || {
                let most = most_rad_s[joint];
                format!("joint {} {:.4} rad/s, {most:.4} at most", joint + 1, new.qd_rad_s[joint])
            });
        }
        let hasty = |i: &usize| {
            let most = RAMP_RATIO * most_rad_s[*i] / share.ramp_s * dt_s;
            (new.qd_rad_s[*i] - old_rad_s[*i]).abs() > most + ROUNDING_TOLERANCE
        };
        if let Some(joint) = (0..6).find(hasty) {
            findings.report("a jog keeps to its ramp", now, || {
                let (from, to) = (old_rad_s[joint], new.qd_rad_s[joint]);
                format!("joint {} from {from:.4} to {to:.4} rad/s in a job", joint + 1)
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
    use taktil_signal::{ControlState, Desired, JointState};

    const JOB_S: f64 = 0.0025;

    /// The rules that a machine in this state breaks whose desired and measured joint 1 go through
    /// these places (rad), at the speeds that the former make.
    fn broken(
        state: State,
        mode: Mode,
        desired_rad: impl Fn(u64) -> f64,
        measured_rad: impl Fn(u64) -> f64,
        change: impl Fn(&mut Tick),
    ) -> Vec<&'static str> {
        let weather = Weather::new(&FaultPlan::default(), Campaign::Anything, Nanos::MAX);
        let mut check = MotionCheck::new(ArmLimits::new(None));
        let mut findings = Findings::default();
        let mut before = None;
        for job in 1..200 {
            let mut desired = Desired { valid: 1, ..Desired::ZERO };
            desired.q_rad[0] = desired_rad(job);
            desired.qd_rad_s[0] = (desired_rad(job) - desired_rad(job - 1)) / JOB_S;
            let mut joints = JointState { calibrated: 1, ..JointState::ZERO };
            joints.q_rad[0] = measured_rad(job);
            let control =
                ControlState { mode: mode.code(), state: state as u32, ..ControlState::ZERO };
            let mut tick = Tick {
                tick: job,
                release: Nanos(2_500_000 * job.cast_signed()),
                control: Some(control),
                joints: Some(joints),
                desired: Some(desired),
                ..Tick::default()
            };
            if job > 100 {
                change(&mut tick);
            }
            if let Some(before) = before.replace(tick) {
                check.tick(&before, &tick, &weather, &mut findings);
            }
        }
        findings.violations.iter().map(|violation| violation.rule).collect()
    }

    /// Way after so many jobs of a speed that is reached within `ramp` jobs (rad).
    fn ramped_rad(job: u64, speed_rad_s: f64, ramp: u64) -> f64 {
        (1..=job).map(|job| speed_rad_s * job.min(ramp) as f64 / ramp as f64 * JOB_S).sum()
    }

    #[test]
    fn a_jog_keeps_to_speed_and_ramp() {
        let jog = |state, speed: f64, ramp| {
            let way = |job| ramped_rad(job, speed, ramp);
            broken(state, Mode::Moving, way, way, |_| {})
        };
        let full = 190_f64.to_radians();
        assert!(jog(State::ManualJoint, 0.15 * full, 20).is_empty());
        assert_eq!(jog(State::ManualJoint, 0.16 * full, 22), ["a jog keeps to its speed"]);
        assert_eq!(jog(State::ManualJoint, 0.15 * full, 8), ["a jog keeps to its ramp"]);
        assert!(jog(State::ManualUncalibrated, 0.05 * full, 20).is_empty());
        assert_eq!(jog(State::ManualUncalibrated, 0.15 * full, 60), ["a jog keeps to its speed"]);
    }

    #[test]
    fn a_jog_says_its_speed_and_needs_no_fault_at_its_limits() {
        let way = |job| ramped_rad(job, 0.2, 20);
        let jog =
            |change: fn(&mut Tick)| broken(State::ManualJoint, Mode::Moving, way, way, change);
        let silent = |tick: &mut Tick| {
            if let Some(desired) = &mut tick.desired {
                desired.qd_rad_s = [0.0; 6];
            }
        };
        let faulty = |tick: &mut Tick| {
            if let Some(control) = &mut tick.control {
                control.faults = SOFT_LIMIT_BIT;
            }
        };
        assert!(jog(silent).contains(&"a jog moves at the speed that it says"));
        assert_eq!(jog(faulty), ["a jog keeps off the limits by itself"]);
    }

    #[test]
    fn a_motion_begins_where_the_desired_joints_are() {
        let enter = |tick: &mut Tick| {
            if let Some(control) = &mut tick.control {
                control.entered_ns = 1;
            }
        };
        let from = |step_rad: f64| {
            let way = move |job| if job > 100 { step_rad } else { 0.0 };
            broken(State::Trajectory, Mode::Moving, way, way, enter)
        };
        assert!(from(1e-4).is_empty());
        assert_eq!(from(1e-3), ["a motion begins where the desired joints are"]);
        // The speed of a law of touch is there in its first job.
        let by_touch = |told: bool| {
            let way = |job: u64| 6e-4 * job.saturating_sub(100) as f64;
            broken(State::TactileServo, Mode::Moving, way, way, move |tick| {
                enter(tick);
                if let Some(desired) = &mut tick.desired {
                    desired.qd_rad_s[0] *= f64::from(u8::from(told));
                }
            })
        };
        assert!(by_touch(true).is_empty(), "{:?}", by_touch(true));
        assert_eq!(by_touch(false), ["a motion begins where the desired joints are"]);
    }

    #[test]
    fn a_programmed_move_keeps_to_the_speed_of_its_joints_or_of_the_tool() {
        let turn = |speed: f64| {
            let way = |job| ramped_rad(job, speed * 190_f64.to_radians(), 20);
            broken(State::Trajectory, Mode::Moving, way, way, |_| {})
        };
        assert!(turn(0.3).is_empty());
        assert_eq!(turn(0.4), ["a programmed move keeps to its speed"]);
    }

    /// Jobs until number `jobs`.
    fn left(job: u64, jobs: u64) -> f64 {
        jobs.saturating_sub(job) as f64
    }

    #[test]
    fn desired_joints_come_to_rest_and_wait_for_the_arm() {
        let stop =
            |way: fn(u64) -> f64| broken(State::ManualJoint, Mode::Stopping, way, way, |_| {});
        // Parabolas to rest within 80 and within 120 jobs.
        assert!(stop(|job| -2.5e-6 * left(job, 80) * left(job, 80)).is_empty());
        let long = stop(|job| -2.5e-6 * left(job, 120) * left(job, 120));
        assert_eq!(long, ["desired joints that nobody leads come to rest"]);
        let way = |job| ramped_rad(job, 0.4, 20);
        let lead = |most: f64| {
            broken(State::Trajectory, Mode::Moving, way, |job| way(job).min(most), |_| {})
        };
        assert!(lead(0.12).is_empty());
        assert_eq!(lead(0.05), ["desired joints wait for the arm"]);
    }
}
