//! What a task finds around itself at a tick: time, the state and the mode of the machine, and how
//! the joints move. Values of several inputs that belong together are taken from here.

use core::f64::consts::TAU;

use taktil_hal::fault::SplitMix;
use taktil_machine::robot::AnyRobot;
use taktil_machine::with_robot;
use taktil_rtcore::{Cycle, LaneSpec, Mode, Nanos};
use taktil_signal::State;

/// Longest stay in a state, in jobs.
const STAY_JOBS_MAX: usize = 3000;
/// One job in so many comes after a gap.
const JOBS_BETWEEN_GAPS: usize = 400;
/// One gap in so many is a long one.
const GAPS_BETWEEN_LONG_ONES: usize = 50;
/// Jobs left out in a gap, and in a long one, at most.
const GAP_JOBS_MAX: (usize, usize) = (4, 400);
/// Share of a joint's range, and of its speed, that it moves in and with.
const JOINT_SHARE: f64 = 0.5;
/// Fastest oscillation of a joint (rad/s of the sine's angle).
const OSCILLATION_RATE_MAX_RAD_S: f64 = 2.0;

/// How a joint oscillations.
#[derive(Clone, Copy, Debug)]
struct Oscillation {
    centre_rad: f64,
    amplitude_rad: f64,
    rate_rad_s: f64,
    phase_rad: f64,
}

/// The surroundings of a task at a tick.
#[derive(Clone, Debug)]
pub(crate) struct Scenario {
    lane: LaneSpec,
    pub(crate) tick: u64,
    pub(crate) release: Nanos,
    pub(crate) state: State,
    pub(crate) mode: Mode,
    /// Release at which the state was entered.
    pub(crate) entered: Nanos,
    leave_at: u64,
    oscillations: Vec<Oscillation>,
    /// Angles and speeds of the joints (rad, rad/s).
    pub(crate) q_rad: Vec<f64>,
    pub(crate) qd_rad_s: Vec<f64>,
    /// Torques that the joints bear (N m).
    pub(crate) torque_max_nm: Vec<f64>,
    began: bool,
}

/// Largest speed of each joint (rad/s).
pub(crate) fn speed_max_rad_s(robot: &AnyRobot) -> Vec<f64> {
    use taktil_mechanics::arm::Arm;
    with_robot!(robot, robot => robot.arm.speed_max().as_slice().to_vec())
}

impl Scenario {
    /// Before the first job.
    pub(crate) fn new(lane: &LaneSpec, robot: &AnyRobot, random: &mut SplitMix) -> Scenario {
        let speeds = speed_max_rad_s(robot);
        let oscillation = |((low, high), speed): ((f64, f64), f64)| {
            let amplitude_rad = 0.5 * (high - low) * JOINT_SHARE * random.unit();
            let fastest = JOINT_SHARE * speed / amplitude_rad.max(1e-6);
            Oscillation {
                centre_rad: 0.5 * (low + high),
                amplitude_rad,
                rate_rad_s: fastest.min(OSCILLATION_RATE_MAX_RAD_S),
                phase_rad: TAU * random.unit(),
            }
        };
        let oscillations: Vec<Oscillation> =
            robot.limits_rad().into_iter().zip(speeds).map(oscillation).collect();
        Scenario {
            lane: lane.clone(),
            tick: 0,
            release: lane.release(0),
            state: State::Start,
            mode: Mode::Off,
            entered: Nanos::ZERO,
            leave_at: 0,
            q_rad: vec![0.0; oscillations.len()],
            qd_rad_s: vec![0.0; oscillations.len()],
            torque_max_nm: robot.torque_max_nm(),
            oscillations,
            began: false,
        }
    }

    /// The next job.
    pub(crate) fn advance(&mut self, random: &mut SplitMix) {
        if core::mem::replace(&mut self.began, true) {
            self.tick += 1;
        }
        if random.below(JOBS_BETWEEN_GAPS) == 0 {
            let long = random.below(GAPS_BETWEEN_LONG_ONES) == 0;
            let most = if long { GAP_JOBS_MAX.1 } else { GAP_JOBS_MAX.0 };
            self.tick += 1 + random.below(most) as u64;
        }
        self.release = self.lane.release(self.tick);
        if self.tick >= self.leave_at {
            self.leave_at = self.tick + 1 + random.below(STAY_JOBS_MAX) as u64;
            self.state = State::ALL[random.below(State::ALL.len())];
            self.entered = self.release;
        }
        if self.entered == self.release || random.below(STAY_JOBS_MAX) == 0 {
            self.mode = draw_mode(self.state, random);
        }
    }

    /// Moves the joints to where they are at this job.
    pub(crate) fn move_joints(&mut self) {
        let t_s = self.release.as_secs_f64();
        for (joint, oscillation) in self.oscillations.iter().enumerate() {
            let (sine, cosine) = libm::sincos(oscillation.rate_rad_s * t_s + oscillation.phase_rad);
            self.q_rad[joint] = oscillation.centre_rad + oscillation.amplitude_rad * sine;
            self.qd_rad_s[joint] = oscillation.amplitude_rad * oscillation.rate_rad_s * cosine;
        }
    }

    /// What the step is told of time.
    pub(crate) fn cycle(&self) -> Cycle {
        Cycle { tick: self.tick, release: self.release, dt: self.lane.period, mode: self.mode }
    }
}

/// A mode in which the machine may be in this state; one time in eight any mode.
fn draw_mode(state: State, random: &mut SplitMix) -> Mode {
    if random.below(8) == 0 {
        return Mode::ALL[random.below(Mode::ALL.len())];
    }
    let usual: &[Mode] = match state {
        State::Start => &[Mode::Off, Mode::Checking, Mode::Ready, Mode::Enabling, Mode::Fault],
        State::IdleUncalibrated | State::IdleCalibrated => &[Mode::Hold],
        _ => &[Mode::Moving, Mode::Moving, Mode::Hold, Mode::Stopping],
    };
    usual[random.below(usual.len())]
}
