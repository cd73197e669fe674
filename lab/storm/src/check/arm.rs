//! The arm within its limits: codes that make no more torque than is allowed, by gears and
//! amplifiers retyped here; desired joints inside their limits and no faster than the joints can
//! be; measured joints where the arm is; numbers that are finite; a jog that ends when its keys
//! fall silent; no fault before the first fault of the plan.

use taktil_hal::Nanos;
use taktil_hal::fault::FaultKind;
use taktil_lab_world::WorldTruth;
use taktil_rtcore::Mode;
use taktil_signal::State;

use super::false_alarm::FalseAlarm;
use super::{Findings, Weather, mode_of, state_of};
use crate::evidence::Tick;

/// Faults that take the torque within the job that finds them, as in the lane's health: lost lines,
/// a runaway, a stuck encoder, a joint beyond its limits.
const TAKES_TORQUE: u64 = 1 << 4 | 1 << 36 | 1 << 37 | 1 << 38;

/// An encoder has jumped, among the latched faults.
const ENCODER_JUMP_BIT: u64 = 1 << 1;

/// Motor turns a joint turn, from the published data of the arm.
const GEAR_RATIO: [f64; 6] = [46.72, 69.9733, 42.9867, 43.5111, 39.3846, 31.7692];
/// Turns of motors 5 and 6 that joint 4 makes, and of motor 6 that joint 5 makes.
const COUPLING_TURNS: [f64; 3] = [-9.8462, 1.0, -5.6];
/// Counts a turn of each motor.
const TURN_COUNTS: [f64; 6] = [1000.0, 1000.0, 1000.0, 800.0, 800.0, 800.0];
/// Torque of each motor at full scale of its converter (N m).
const FULL_SCALE_NM: [f64; 6] = [0.275, 0.275, 0.275, 0.06, 0.06, 0.06];
/// Codes from zero to full scale.
const FULL_SCALE_CODES: f64 = 2048.0;
/// Joint limits of the arm (deg).
const LOW_DEG: [f64; 6] = [-159.0, -76.0, -214.0, -194.0, -122.0, -267.0];
const HIGH_DEG: [f64; 6] = [159.0, 256.0, 34.0, 384.0, 122.0, 267.0];
/// How far a measured joint may be beyond its limits (deg): the margin of the machine, and a doubt.
const LIMIT_MARGIN_DEG: f64 = 2.1;
/// Largest joint speeds of the arm (deg/s).
const SPEED_DEG_S: [f64; 6] = [190.0, 125.0, 205.0, 205.0, 225.0, 280.0];
/// Tolerance of a desired joint at its limit (rad), for rounding.
const LIMIT_TOLERANCE_RAD: f64 = 1e-6;
/// Largest difference between a measured and a true joint angle of a calibrated arm at rest (rad),
/// and its growth with speed (s): two ticks.
const PLACE_TOLERANCE_RAD: f64 = 0.008;
const PLACE_DELAY_S: f64 = 0.006;
/// When the keys of a jog count as silent, with the ramp to rest.
const SILENT_KEYS_TIME: Nanos = Nanos::from_millis(200);
/// Speed of a desired joint that counts as rest (rad/s).
const REST_SPEED_RAD_S: f64 = 1e-3;
/// How much faster than the arm's largest speed a desired joint may step in a tick.
const STEP_RATIO: f64 = 1.1;
/// How far desired joints are ahead of the arm when they are drawn along by it (rad).
const LEAD_RAD: f64 = 0.09;
/// How far a calibration may set the joints from the home pose (rad): what the arm moves in a tick.
const HOME_TOLERANCE_RAD: f64 = 0.002;

/// What is known of the arm beside this crate's tables.
#[derive(Clone, Debug)]
pub struct ArmLimits {
    /// Largest torque at each joint, as the scene's machine says (N m).
    pub torque_nm: [f64; 6],
    /// Largest joint speeds (rad/s).
    pub speed_max_rad_s: [f64; 6],
    /// Home pose, at which the scene's machine calibrates (rad).
    pub home_rad: Option<[f64; 6]>,
    /// Whether there is something that the operator may push the arm into.
    pub touches: bool,
    /// Pace of a jog of single joints while the arm is not calibrated.
    pub jog_uncalibrated: JogPace,
    /// The same while it is.
    pub jog_calibrated: JogPace,
}

/// How fast a jog of single joints may be.
#[derive(Clone, Copy, Debug)]
pub struct JogPace {
    /// Share of each joint's largest speed.
    pub speed: f64,
    /// Time from rest to that speed (s).
    pub ramp_s: f64,
}

impl ArmLimits {
    /// The arm with these torque limits (N m); its motors' own where the machine names none.
    #[must_use]
    pub fn new(torque_nm: Option<&[f64]>) -> ArmLimits {
        let motors: [f64; 6] =
            core::array::from_fn(|joint| GEAR_RATIO[joint] * FULL_SCALE_NM[joint]);
        let torque_nm = torque_nm.and_then(|list| list.try_into().ok()).unwrap_or(motors);
        let speed_max_rad_s = SPEED_DEG_S.map(f64::to_radians);
        let slow = JogPace { speed: 0.05, ramp_s: 0.05 };
        let fast = JogPace { speed: 0.15, ramp_s: 0.05 };
        ArmLimits {
            torque_nm,
            speed_max_rad_s,
            home_rad: None,
            touches: false,
            jog_uncalibrated: slow,
            jog_calibrated: fast,
        }
    }

    /// The same arm with its home pose (deg), and whether it can touch something.
    #[must_use]
    pub fn at_home(self, home_deg: &[f64], touches: bool) -> ArmLimits {
        let home: Option<[f64; 6]> = home_deg.try_into().ok();
        ArmLimits { home_rad: home.map(|home| home.map(f64::to_radians)), touches, ..self }
    }

    /// The same arm whose calibrated joints are jogged with this share of their largest speeds; the
    /// usual one where the machine names none.
    #[must_use]
    pub fn jogged_at(mut self, share: Option<f64>) -> ArmLimits {
        self.jog_calibrated.speed = share.unwrap_or(self.jog_calibrated.speed);
        self
    }

    /// Joint angles of motor counts (rad), by forward substitution.
    pub(super) fn joints(&self, counts: &[i32; 8]) -> [f64; 6] {
        let turns: [f64; 6] = core::array::from_fn(|i| {
            f64::from(counts[i]) / TURN_COUNTS[i] * core::f64::consts::TAU
        });
        let mut q: [f64; 6] = core::array::from_fn(|i| turns[i] / GEAR_RATIO[i]);
        q[4] = (turns[4] - COUPLING_TURNS[0] * q[3]) / GEAR_RATIO[4];
        q[5] = (turns[5] - COUPLING_TURNS[1] * q[3] - COUPLING_TURNS[2] * q[4]) / GEAR_RATIO[5];
        q
    }

    /// Joint torques of converter codes (N m): each motor acts on its own joint, the last two on
    /// those before them too.
    fn torques(codes: &[i32; 8]) -> [f64; 6] {
        let motor: [f64; 6] =
            core::array::from_fn(|i| f64::from(codes[i]) / FULL_SCALE_CODES * FULL_SCALE_NM[i]);
        let mut tau: [f64; 6] = core::array::from_fn(|i| motor[i] * GEAR_RATIO[i]);
        tau[3] += COUPLING_TURNS[0] * motor[4] + COUPLING_TURNS[1] * motor[5];
        tau[4] += COUPLING_TURNS[2] * motor[5];
        tau
    }

    /// Whether these codes give joint number `joint`, 0 the first, all the torque to this side that
    /// its limit or its motor has.
    pub(super) fn is_at_torque_limit(&self, codes: &[i32; 8], joint: usize, side: f64) -> bool {
        let least_nm = self.torque_nm[joint] - 2.0 * ArmLimits::rounding_nm(joint);
        let motor = side * f64::from(codes[joint]);
        side * ArmLimits::torques(codes)[joint] >= least_nm || motor >= FULL_SCALE_CODES - 1.0
    }

    /// Whether a joint is further beyond its limits than is borne.
    pub(super) fn is_beyond_limits(&self, q_rad: &[f64; 6]) -> bool {
        (0..6).any(|joint| {
            q_rad[joint] < (LOW_DEG[joint] - LIMIT_MARGIN_DEG).to_radians()
                || q_rad[joint] > (HIGH_DEG[joint] + LIMIT_MARGIN_DEG).to_radians()
        })
    }

    /// Torque of rounding the codes (N m): half a step of each motor that acts on a joint.
    fn rounding_nm(joint: usize) -> f64 {
        let step = |motor: usize| FULL_SCALE_NM[motor] / FULL_SCALE_CODES;
        let own = GEAR_RATIO[joint] * step(joint);
        match joint {
            3 => own + COUPLING_TURNS[0].abs() * step(4) + step(5),
            4 => own + COUPLING_TURNS[2].abs() * step(5),
            _ => own,
        }
    }
}

/// What the rules about the arm remember.
#[derive(Debug)]
pub(super) struct ArmCheck {
    arm: ArmLimits,
    keys: Option<(u32, Nanos)>,
    /// Number of the zero of the joints, and how far it was off the truth when it was set: whoever
    /// calibrates an arm that has sagged is wrong by that.
    zero: Option<(u32, [f64; 6])>,
    /// The zero of the last job with one.
    last_zero: Option<u32>,
    false_alarm: FalseAlarm,
}

impl ArmCheck {
    pub(super) fn new(arm: ArmLimits) -> ArmCheck {
        ArmCheck {
            arm,
            keys: None,
            zero: None,
            last_zero: None,
            false_alarm: FalseAlarm::default(),
        }
    }

    pub(super) fn tick(
        &mut self,
        tick: &Tick,
        before: Option<&Tick>,
        truth: Option<&WorldTruth>,
        weather: &Weather,
        findings: &mut Findings,
    ) {
        let now = tick.release;
        self.torque(tick, findings);
        check_finite(tick, findings);
        self.false_alarm.tick(tick, truth, weather, findings);
        self.desired(tick, before, weather, findings);
        self.keys(tick, weather, findings);
        let jumped = tick.control.is_some_and(|control| control.faults & ENCODER_JUMP_BIT != 0);
        if jumped && tick.joints.is_some_and(|joints| joints.calibrated == 1) {
            findings.report("a jump costs the zero", now, String::new);
        }
        if let Some(truth) = truth {
            self.place(tick, truth, weather, findings);
        }
        // What the lane's health says of a task's number that was refused has a reason in the plan.
        let refused =
            tick.health.is_some_and(|health| health.faults & ((1 << 11) | (1 << 24)) != 0);
        let spoilt = |name: &str, kind| name.starts_with("task.") && kind == FaultKind::NotFinite;
        // Measured joints that are torn or corrupted may lie anywhere, and desired ones follow
        // them.
        let wild = weather.is_on("encoders", now, Nanos::from_millis(50));
        if refused && !wild && !weather.has(now, Nanos::from_millis(50), spoilt) {
            findings.report("no task writes what it may not", now, || {
                format!("faults {:#x}", tick.health.map_or(0, |health| health.faults))
            });
        }
    }

    /// Torque at the joints that the codes make.
    fn torque(&self, tick: &Tick, findings: &mut Findings) {
        let Some(word) = &tick.analog else { return };
        let tau = ArmLimits::torques(&word.codes);
        for (joint, tau) in tau.iter().enumerate() {
            let most = self.arm.torque_nm[joint] + ArmLimits::rounding_nm(joint);
            if tau.abs() > most {
                findings.report("torque within its limits", tick.release, || {
                    format!("{tau:.3} N m at joint {}, {most:.3} is allowed", joint + 1)
                });
            }
        }
        if word.codes.iter().any(|code| !(-2048..=2047).contains(code)) {
            findings
                .report("codes within the converter", tick.release, || format!("{:?}", word.codes));
        }
        // What the servo asked for is what leaves, where nothing is cut off.
        let (Some(torque), Some(applied)) = (&tick.torque, &tick.applied) else { return };
        // A motor that runs away, an encoder that is stuck and a joint beyond its limits take the
        // torque in the job that finds them.
        let takes = tick.health.is_some_and(|health| health.faults & TAKES_TORQUE != 0);
        let open = applied.gate_open == 1 && applied.limited == 0;
        let off = |joint: usize| {
            let rounding_nm = 2.0 * ArmLimits::rounding_nm(joint);
            let is_taken = takes && tau[joint].abs() <= rounding_nm;
            !is_taken && (torque.tau_nm[joint] - tau[joint]).abs() > rounding_nm
        };
        if let (true, Some(joint)) = (open && word.outcome == 0, (0..6).find(|joint| off(*joint))) {
            findings.report("the torque asked for is put out", tick.release, || {
                format!(
                    "{:.3} asked, {:.3} out, joint {}",
                    torque.tau_nm[joint],
                    tau[joint],
                    joint + 1
                )
            });
        }
    }

    /// Desired joints: inside the limits of a calibrated arm, and no faster than the joints can be.
    fn desired(
        &self,
        tick: &Tick,
        before: Option<&Tick>,
        weather: &Weather,
        findings: &mut Findings,
    ) {
        let (Some(desired), Some(mode)) = (&tick.desired, mode_of(tick)) else { return };
        if mode != Mode::Moving || desired.valid == 0 {
            return;
        }
        let calibrated = !matches!(
            state_of(tick),
            Some(State::ManualUncalibrated | State::IdleUncalibrated | State::Start)
        );
        let datum = |tick: &Tick| tick.joints.map(|joints| joints.datum);
        let outside = |joint: usize| {
            let q = desired.q_rad[joint];
            q < LOW_DEG[joint].to_radians() - LIMIT_TOLERANCE_RAD
                || q > HIGH_DEG[joint].to_radians() + LIMIT_TOLERANCE_RAD
        };
        if let (true, Some(joint)) = (calibrated, (0..6).find(|joint| outside(*joint))) {
            findings.report("desired joints inside their limits", tick.release, || {
                format!("joint {} at {:.3} deg", joint + 1, desired.q_rad[joint].to_degrees())
            });
        }
        let Some(before) = before.filter(|before| before.tick + 1 == tick.tick) else { return };
        let Some(old) = before.desired.filter(|old| old.valid == 1) else { return };
        if mode_of(before) != Some(Mode::Moving) || datum(before) != datum(tick) {
            return;
        }
        let span_s = (tick.release - before.release).as_secs_f64();
        let lead = |joint: usize| {
            let measured = tick.joints.map_or(0.0, |joints| joints.q_rad[joint]);
            (desired.q_rad[joint] - measured).abs()
        };
        // Desired joints that are as far ahead as they may be are drawn along by the arm.
        let jumps = |joint: usize| {
            let step = (desired.q_rad[joint] - old.q_rad[joint]).abs();
            step > STEP_RATIO * self.arm.speed_max_rad_s[joint] * span_s && lead(joint) < LEAD_RAD
        };
        if let (false, Some(joint)) = (weather.is_late(tick.release), (0..6).find(|j| jumps(*j))) {
            findings.report("desired joints do not jump", tick.release, || {
                let step = desired.q_rad[joint] - old.q_rad[joint];
                format!("joint {} by {:.3} deg in a tick", joint + 1, step.to_degrees())
            });
        }
    }

    /// A jog whose keys are not confirmed any more comes to rest.
    fn keys(&mut self, tick: &Tick, weather: &Weather, findings: &mut Findings) {
        let now = tick.release;
        let Some(jog) = &tick.jog else { return };
        let since = match self.keys {
            Some((sequence, since)) if sequence == jog.sequence => since,
            _ => now,
        };
        self.keys = Some((jog.sequence, since));
        let manual = matches!(
            state_of(tick),
            Some(State::ManualUncalibrated | State::ManualJoint | State::ManualCartesian)
        );
        let moving = mode_of(tick) == Some(Mode::Moving);
        let Some(desired) = tick.desired.filter(|_| manual && moving) else { return };
        let fast = desired.qd_rad_s.iter().any(|qd| qd.abs() > REST_SPEED_RAD_S);
        if fast && now - since > SILENT_KEYS_TIME && !weather.is_late(now) {
            findings.report("a jog ends with its keys", now, || {
                format!("silent for {}, {:?} rad/s", now - since, desired.qd_rad_s)
            });
        }
    }

    /// A calibrated arm is where it is said to be, unless its encoders have had a fault; a
    /// calibration says that it is at home.
    fn place(
        &mut self,
        tick: &Tick,
        truth: &WorldTruth,
        weather: &Weather,
        findings: &mut Findings,
    ) {
        let now = tick.release;
        let Some(joints) = tick.joints.filter(|joints| joints.calibrated == 1) else { return };
        // An arm that was calibrated while jobs were late has moved since.
        let is_new = self.last_zero.replace(joints.datum) != Some(joints.datum);
        if weather.has_begun("encoders", now) || weather.is_late(now) {
            return;
        }
        let off: [f64; 6] = core::array::from_fn(|i| joints.q_rad[i] - truth.q_rad[i]);
        let tolerance = |i: usize| PLACE_TOLERANCE_RAD + PLACE_DELAY_S * truth.qd_rad_s[i].abs();
        let Some((_, zero)) = self.zero.filter(|(datum, _)| *datum == joints.datum) else {
            self.zero = Some((joints.datum, off));
            let Some(home) = self.arm.home_rad else { return };
            let far = |i: &usize| (joints.q_rad[*i] - home[*i]).abs() > HOME_TOLERANCE_RAD;
            if let Some(joint) = (0..6).find(far).filter(|_| is_new) {
                findings.report("a calibration is at home", now, || {
                    let (said, home) = (joints.q_rad[joint].to_degrees(), home[joint].to_degrees());
                    format!("joint {} at {said:.3} deg, {home:.3} at home", joint + 1)
                });
            }
            return;
        };
        if let Some(joint) = (0..6).find(|i| (off[*i] - zero[*i]).abs() > tolerance(*i)) {
            findings.report("the arm is where it says", now, || {
                let (said, is) =
                    (joints.q_rad[joint].to_degrees(), truth.q_rad[joint].to_degrees());
                format!("joint {} at {is:.3} deg, {said:.3} measured", joint + 1)
            });
        }
    }
}

/// Numbers in the records are finite.
fn check_finite(tick: &Tick, findings: &mut Findings) {
    let mut bad = "";
    let mut look = |name: &'static str, numbers: &[f64]| {
        if numbers.iter().any(|number| !number.is_finite()) {
            bad = name;
        }
    };
    if let Some(torque) = &tick.torque {
        look("joint_servo.torque", &torque.tau_nm);
    }
    if let Some(desired) = &tick.desired {
        look("setpoint.desired", &desired.q_rad);
        look("setpoint.desired", &desired.qd_rad_s);
    }
    if let Some(joints) = &tick.joints {
        look("sense.joints", &joints.q_rad);
        look("sense.joints", &joints.qd_rad_s);
    }
    if let Some(applied) = &tick.applied {
        look("actuate.applied", &applied.tau_nm);
    }
    if !bad.is_empty() {
        findings.report("numbers are finite", tick.release, || bad.to_owned());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use taktil_mechanics::Joints;
    use taktil_mechanics::robot::Robot;

    #[test]
    fn the_retyped_tables_are_those_of_the_arm() {
        let robot = Robot::puma260();
        let arm = ArmLimits::new(None);
        let q = Joints::new(0.3, -0.5, 1.0, 0.7, -0.4, 1.1);
        let counts = robot.gears.counts(&q);
        let mut eight = [0; 8];
        eight[..6].copy_from_slice(&counts);
        let own = arm.joints(&eight);
        assert!((Joints::from(own) - robot.gears.joints(&counts)).amax() < 1e-12);
        let codes = [100, -200, 300, -400, 500, -600, 0, 0];
        let motor = Joints::from_fn(|i, _| robot.drive.motor_torque_nm(codes[i], i));
        let theirs = robot.gears.joint_torque(&motor);
        assert!((Joints::from(ArmLimits::torques(&codes)) - theirs).amax() < 1e-12);
        let limits = |degrees: [f64; 6]| Joints::from(degrees.map(f64::to_radians));
        assert!((limits(LOW_DEG) - robot.arm.q_min_rad).amax() < 1e-12);
        assert!((limits(HIGH_DEG) - robot.arm.q_max_rad).amax() < 1e-12);
        assert!((limits(SPEED_DEG_S) - robot.arm.speed_max_rad_s).amax() < 1e-12);
    }

    #[test]
    fn a_joint_is_beyond_its_limits_by_more_than_the_margin() {
        let arm = ArmLimits::new(None);
        let at = |degrees: f64| {
            arm.is_beyond_limits(&[degrees, 0.0, 0.0, 0.0, 0.0, 0.0].map(f64::to_radians))
        };
        assert!(!at(0.0) && !at(161.0) && !at(-161.0));
        assert!(at(161.2) && at(-161.2));
    }
}
